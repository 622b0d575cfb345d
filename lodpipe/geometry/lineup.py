"""Pictures of all levels of an asset from the same places, and what differs between them."""

from __future__ import annotations

import functools
import io
import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from PIL import Image

from lodpipe.core.asset import Asset
from lodpipe.core.mesh import F32
from lodpipe.core.page import Page, Picture
from lodpipe.geometry.camera import Camera
from lodpipe.geometry.metrics import crop_box, flip_map
from lodpipe.geometry.palette import heat
from lodpipe.geometry.render import Style, as_bytes, render
from lodpipe.geometry.sheet import contact_sheet, png_bytes
from lodpipe.geometry.surface import Model
from lodpipe.geometry.texture import U8

VIEWS = (
    ("front", (0.75, 0.3, 1.0)),
    ("back", (-0.75, 0.3, -1.0)),
    ("left", (-1.0, 0.1, 0.35)),
    ("right", (1.0, 0.1, -0.35)),
    ("above", (0.2, 1.0, 0.35)),
    ("below", (0.2, -1.0, 0.35)),
)
"""Names and directions, as seen from +z with y up."""
SIZE = 640
"""Pixels of a picture, for a page that shows it at about half of that."""
SHEET = 320
"""Pixels of a picture on the contact sheet, and of the thumbnail."""
QUALITY = 84


def take(
    page: Page,
    asset: Asset,
    models: Mapping[int, Model],
    views: int,
    threads: int = 0,
    between: Callable[[], None] = lambda: None,
) -> None:
    """Put pictures of `models`, by level, from the first `views` of VIEWS into `page`, with a contact sheet.

    Level 0 is the reference of the differences. `between` is called between pictures and may raise.
    """
    radius = max(model.radius for model in models.values())
    for model in models.values():
        model.prepare()
    cameras = [Camera.around(models[0].centre, radius, direction) for _, direction in VIEWS[: max(views, 1)]]
    wired = Style("clay", wireframe=1.0)

    def shoot(job: tuple[int, int]) -> U8:
        view, level = job
        between()
        if view < 0:
            return render(models[level], cameras[0], SHEET, SHEET, wired, background=None)
        return render(models[level], cameras[view], SIZE, SIZE, background=None, supersample=1)

    jobs = [(view, level) for view in (-1, *range(len(cameras))) for level in models]
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        seen = dict(zip(jobs, pool.map(shoot, jobs), strict=True))
        for view, (name, _) in enumerate(VIEWS[:views]):
            page.views.append(name)
            pair = functools.partial(_pair, asset, seen[view, 0], view, name)
            for pictures in pool.map(pair, models, [seen[view, level] for level in models]):
                page.pictures += pictures
    first, wires = ({level: seen[view, level] for level in models} for view in (0, -1))
    page.pictures.append(_sheet(asset, first, wires))
    small = webp(halved(first[0]))
    page.pictures.append(Picture("thumbnail.webp", "thumbnail", asset.name, small, SHEET, SHEET, 0))


def difference(a: U8, b: U8) -> U8:
    """FLIP's map of where two pictures (H, W, 4) of one size differ, on mid-grey, as colours (H, W, 4); see `heat`.

    Seen at half the size, as on a page: 67 pixels a degree.
    """
    shown = (a[..., 3] > 0) | (b[..., 3] > 0)
    off = np.zeros(shown.shape, np.float32)
    if shown.any():
        box = crop_box(shown)
        off[box] = flip_map(*(_over_grey(picture[box]) for picture in (a, b)))
    return np.dstack([as_bytes(heat(off)), np.maximum(a[..., 3], b[..., 3])])


def webp(picture: U8) -> bytes:
    """`picture` (H, W, 3 or 4) as a WebP file's content; the same bytes for the same picture."""
    target = io.BytesIO()
    Image.fromarray(picture).save(target, "WEBP", quality=QUALITY, method=2)
    return target.getvalue()


def halved(picture: U8) -> U8:
    """(H, W, 4) with half as many rows and columns, averaged with premultiplied alpha."""
    image = Image.fromarray(picture).convert("RGBa").reduce(2).convert("RGBA")
    return np.array(image)


def _pair(asset: Asset, source: U8, view: int, name: str, level: int, shot: U8) -> list[Picture]:
    title = f"{asset.name}, level {level}, {name}"
    found = [Picture(f"LOD{level}_{name}.webp", "shaded", title, webp(shot), SIZE, SIZE, level, view)]
    if level:
        off = difference(halved(source), halved(shot))
        file = f"LOD{level}_{name}_difference.webp"
        title = f"Where level {level} of {asset.name} looks different from the source, {name}"
        found.append(Picture(file, "difference", title, webp(off), off.shape[1], off.shape[0], level, view))
    return found


def _sheet(asset: Asset, shaded: Mapping[int, U8], wires: Mapping[int, U8]) -> Picture:
    base = max(asset.lods[0].triangles, 1)
    labels = [f"LOD{level}: {asset.lods[level].triangles:,} triangles" for level in shaded]
    shares = ["source" if not n else f"{100 * asset.lods[n].triangles / base:.3g} %" for n in shaded]
    images = [*(halved(picture) for picture in shaded.values()), *wires.values()]
    sheet = contact_sheet(images, [*labels, *shares], columns=len(shaded))
    alt = f"{asset.name}: {', '.join(labels)}"
    return Picture("levels.png", "sheet", alt, png_bytes(sheet), sheet.shape[1], sheet.shape[0])


def _over_grey(picture: U8) -> F32:
    """sRGB (H, W, 3) in 0…1 of a picture (H, W, 4) on mid-grey."""
    values = picture.astype(np.float32) / np.float32(255)
    flat: F32 = values[..., :3] * values[..., 3:] + np.float32(0.5) * (1 - values[..., 3:])
    return flat
