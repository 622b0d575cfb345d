"""What the stage `report` puts aside for report.html: previews in 3-D, pictures, layers of colour."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lodpipe.core.asset import Asset, Target
from lodpipe.core.errors import Cancelled, LodpipeError
from lodpipe.core.material import Image
from lodpipe.core.page import Layer, Page, Scale
from lodpipe.geometry import lineup
from lodpipe.geometry.decimate import decimate_asset
from lodpipe.geometry.flatten import flatten
from lodpipe.geometry.heat import RAMP, distance_to, nearest_vertices, place, ramp, value_at
from lodpipe.geometry.palette import label_colours
from lodpipe.geometry.render import as_bytes
from lodpipe.geometry.surface import Model
from lodpipe.geometry.texture import U8, Textures, to_linear
from lodpipe.io import pixels_of
from lodpipe.io.preview import Previews, shrunk
from lodpipe.kernel import QuadricOptions
from lodpipe.stage import Context

MAX_TRIANGLES = 150_000
"""Levels with more are shown by a stand-in."""
MAX_BYTES = 9_000_000
"""All previews together, compressed; with what their form as text adds, the page stays below 15 MB."""
NONE = np.array([[128, 132, 138]], np.uint8)
"""The colour of what has no segment."""


class Images:
    """The images of an asset and of the levels that have their own: textures for rendering, small ones for previews.

    Each is decoded once as far as memory allows: pixels are not kept, but what is made of them. `warn` is told of
    those that cannot be decoded.
    """

    def __init__(self, size: int, warn: Callable[[str], None]) -> None:
        self._size, self._warn = size, warn
        self._textures: dict[tuple[Image, ...], Textures] = {}
        self._small: dict[Image, Image] = {}

    def textures(self, asset: Asset) -> Textures:
        """The textures that `asset` uses, made when asked for."""
        if asset.images not in self._textures:
            self._textures[asset.images] = Textures(lambda index: self._decoded(asset, index))
        return self._textures[asset.images]

    def small(self, asset: Asset) -> Asset:
        """`asset` with images fit for a preview; one that cannot be decoded has no data."""
        for index, image in enumerate(asset.images):
            if image not in self._small:
                self._decoded(asset, index)
        return replace(asset, images=tuple(self._small[image] for image in asset.images))

    def _decoded(self, asset: Asset, index: int) -> U8 | None:
        image = asset.images[index]
        pixels = pixels_of(asset, self._warn)(index)
        if image not in self._small:
            self._small[image] = replace(image, data=b"") if pixels is None else shrunk(image, pixels, self._size)
        return pixels


def collect(asset: Asset, images: Images, context: Context, *, views: int, with_models: bool) -> Page:
    """Material for the page of `asset`, whose levels have been measured, with pictures from `views` directions."""
    page = Page()
    levels = {n: asset.at(level) for n, level in enumerate(asset.lods)}
    levels = {n: level for n, level in levels.items() if any(len(level.meshes[i].faces) for i, _ in level.instances())}
    if 0 not in levels:
        page.notes.append("There is nothing to see: the source has no triangles in its scene.")
        return page
    models = {}
    for number, level in levels.items():
        context.check_cancelled()
        models[number] = Model(level, None, images.textures(level), context.threads)
    lineup.take(page, asset, models, views, context.threads, context.check_cancelled)
    if with_models:
        _add_models(page, asset, levels, models[0], images, context)
    return page


def _add_models(
    page: Page, asset: Asset, levels: dict[int, Asset], source: Model, images: Images, context: Context
) -> None:
    previews = Previews(source.centre, source.radius)
    try:
        shown = _shown(levels, page, context)
        for number, level in sorted(shown.items(), reverse=True):
            page.models[number] = previews.add(f"LOD{number}", images.small(level))
        page.layers += _error(asset, levels, shown[0], previews, context)
        page.layers += _shape_layers(asset, shown, previews, context)
        page.files = previews.files
    except Cancelled:
        raise
    except LodpipeError as error:  # a page without models is better than none: the files themselves are `export`'s
        page.models, page.layers, page.files = {}, [], {}
        page.notes.append(f"No 3-D view: {error.cause}.")
        return
    _bound(page)


def _shown(levels: dict[int, Asset], page: Page, context: Context) -> dict[int, Asset]:
    """What stands for each level: itself, or a coarser form of the source where it is too large for a page."""
    shown = dict(levels)
    large = [number for number, level in levels.items() if level.triangles > MAX_TRIANGLES]
    if large:
        quick = QuadricOptions(attribute_cost=False, round_share=0.5)
        target = Target(triangles=MAX_TRIANGLES)
        _, small = decimate_asset(levels[0], [target], quick, threads=context.threads, cancelled=context.cancelled)
        for number in large:
            if small.triangles < levels[number].triangles:
                shown[number] = levels[0].at(small)
                page.stand_ins[number] = small.triangles
    return shown


def _error(asset: Asset, levels: dict[int, Asset], shape: Asset, previews: Previews, context: Context) -> list[Layer]:
    """Colours on the source's surface: how far each level is from it."""
    source, surface = flatten(asset), flatten(shape)
    distances = {
        number: distance_to(source, flatten(level), surface.positions, context.threads)
        for number, level in levels.items()
        if number
    }
    if not distances:
        return []
    top = float(max(np.quantile(values, 0.995) for values in distances.values()))
    models = {
        number: previews.add_coloured(
            f"error_LOD{number}", surface.positions, surface.faces, _linear(ramp(place(values, top)))
        )
        for number, values in sorted(distances.items())
    }
    ticks = tuple((at, f"{value_at(at, top):.2g} %") for at in (0.0, 1 / 3, 2 / 3, 1.0))
    about = "Distance from each point of the source to the level, in % of the bounding box's diagonal."
    return [Layer("error", "Error", about, Scale(RAMP, ticks), models)]


def _shape_layers(asset: Asset, shown: dict[int, Asset], previews: Previews, context: Context) -> list[Layer]:
    """Segments and weights, which stages have given to the source's vertices; each level's take the nearest one's."""
    placed = [index for index, _ in asset.instances()]
    found: list[tuple[str, str, str, Scale, U8]] = []
    if asset.segments is not None:
        rows = np.concatenate([asset.segments.vertex_segment[index] for index in placed])
        colours = np.vstack([as_bytes(label_colours(len(asset.segments.names))), NONE])  # −1, no segment, is the last
        scale = Scale(tuple(f"#{bytes(c).hex()}" for c in colours[:-1]), labels=asset.segments.names)
        about = "Main bodies and branches along the skeleton."
        found.append(("segments", "Segments", about, scale, colours[rows]))
    if asset.importance is not None:
        for name, about, each in (
            ("weight", "What each vertex weighs at every budget", asset.importance.weight),
            ("extreme", "What each vertex weighs when few triangles are left", asset.importance.extreme),
        ):
            values = np.log(np.concatenate([each[index] for index in placed]))
            low, high = float(values.min()), float(values.max())
            if high - low > 1e-6:
                ticks = tuple((at, f"{np.exp(low + at * (high - low)):.2g}") for at in (0.0, 0.5, 1.0))
                scale = Scale(RAMP, ticks)
                found.append((name, name.capitalize(), f"{about}.", scale, ramp((values - low) / (high - low))))
    if not found:
        return []
    source = flatten(asset)
    surfaces = {number: flatten(level) for number, level in shown.items()}
    nearest = {n: nearest_vertices(source, surface.positions, context.threads) for n, surface in surfaces.items()}
    return [
        Layer(
            name,
            title,
            about,
            scale,
            {
                number: previews.add_coloured(
                    f"{name}_LOD{number}", surface.positions, surface.faces, _linear(colours[nearest[number]])
                )
                for number, surface in surfaces.items()
            },
        )
        for name, title, about, scale, colours in found
    ]


def _linear(colours: U8) -> U8:
    """sRGB colours as glTF wants them at vertices."""
    linear: U8 = np.rint(to_linear(colours / 255.0) * 255).astype(np.uint8)
    return linear


def _bound(page: Page) -> None:
    """Keep the page small: leave out layers first, then the finest models."""
    if sum(map(len, page.files.values())) <= MAX_BYTES:
        return
    sizes = {name: len(zlib.compress(data, 1)) for name, data in page.files.items()}

    def size() -> int:
        return sum(sizes[name] for name in page.files)

    while size() > MAX_BYTES and page.layers:
        layer = page.layers.pop()
        page.notes.append(f"{layer.title}: not shown in 3-D, the models are too large for a page.")
        _drop(page, set(layer.models.values()))
    for number in sorted(page.models):
        if size() > MAX_BYTES:
            page.notes.append(f"Level {number} is not shown in 3-D: it is too large for a page.")
            _drop(page, {page.models.pop(number)})


def _drop(page: Page, gone: set[str]) -> None:
    """Take models out of the page's files, and what only they name."""
    staying = {name for name in page.files if name.endswith(".gltf")} - gone
    text = b"".join(page.files[name] for name in staying)
    page.files = {name: data for name, data in page.files.items() if name in staying or name.encode() in text}
