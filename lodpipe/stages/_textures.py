"""What `bake` and `repair_uv` share: images decoded before, encoded after, and levels with materials of their own."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from lodpipe import io
from lodpipe.core.asset import Asset, Lod
from lodpipe.core.errors import AssetError, LimitError
from lodpipe.core.material import Image, Material, MaterialSet, renumbered
from lodpipe.geometry.bake import Baked
from lodpipe.geometry.camera import Camera, views
from lodpipe.geometry.render import render
from lodpipe.geometry.slots import Path, is_colour, is_normal, map_name, slots
from lodpipe.geometry.surface import Model, image_index
from lodpipe.geometry.texture import U8, Textures
from lodpipe.io import pixels_of
from lodpipe.stage import Context

Format = Literal["png", "jpeg", "webp", "ktx2"]
VIEWS, SIZE = 6, 384
"""Pictures by which textures are judged."""
CLAMP = 33071
SAMPLER = {"magFilter": 9729, "minFilter": 9987, "wrapS": CLAMP, "wrapT": CLAMP}


@dataclass(frozen=True)
class Encoding:
    """How images are written: their format, JPEG's and WebP's quality, and what their names begin with."""

    format: Format
    quality: int
    prefix: str


def decoded(asset: Asset, context: Context) -> dict[int, U8]:
    """The pixels of every image that a slot reads; what cannot be decoded is warned of."""
    rows = set()
    for material in asset.materials:
        for info in slots(material).values():
            row = image_index(asset.document["textures"][info["index"]])
            if row is not None:
                rows.add(row)
    pixels = {}
    for row in sorted(rows):
        try:
            pixels[row] = io.decode_image(asset.images[row])
        except (AssetError, LimitError) as error:
            context.warn(f"{error}; its place in baked textures holds the factors alone")
    return pixels


def finished(asset: Asset, level: Lod, baked: Baked, encoding: Encoding, context: Context) -> Lod:
    """The level with its images encoded, and with what unbaked meshes still need."""
    materials: list[Material] = []
    images: list[Image] = []
    textures: list[dict[str, Any]] = []
    for made in baked.materials:
        gltf = made.gltf
        indices: dict[Path, int] = {}
        for path, pixels in made.maps.items():
            name = f"{encoding.prefix}_{gltf.get('name') or len(materials)}_{map_name(path)}"
            image = io.encode_image(
                pixels,
                "".join(c if c.isalnum() or c in "_-+." else "_" for c in name),
                encoding.format,
                quality=encoding.quality,
                exact=is_normal(path),
                srgb=is_colour(path),
                warn=context.warn,
            )
            indices[path] = len(textures)
            textures.append({"sampler": 0, "source": len(images)})
            images.append(image)
        for path, other in made.shared.items():
            indices[path] = indices[other]
        materials.append(Material(_with_slots(gltf, indices)))
    own = MaterialSet(tuple(materials), tuple(images), tuple(textures), (SAMPLER,))
    own = _with_kept(asset, own, baked.kept) if baked.kept else own
    return dataclasses.replace(level, meshes=baked.meshes, own=own)


def likeness(source: Asset, others: Sequence[Asset], context: Context) -> list[float]:
    """For each of `others` how alike it and `source` are: PSNR of the mean squared difference over six pictures, in dB;
    99 for none. An asset without levels: its meshes are looked at."""
    first, *models = (
        Model(asset, None, Textures(pixels_of(asset, context.warn)), context.threads) for asset in (source, *others)
    )
    squares = np.zeros((len(models), VIEWS))
    for view, direction in enumerate(views(VIEWS)):
        context.check_cancelled()
        camera = Camera.around(first.centre, first.radius, direction)
        wanted = render(first, camera, SIZE, SIZE, supersample=1).astype(np.float32)
        for row, model in enumerate(models):
            squares[row, view] = np.square(wanted - render(model, camera, SIZE, SIZE, supersample=1)).mean()
    means = squares.mean(axis=1)
    return [min(99.0, float(10 * np.log10(255**2 / mean))) if mean > 0 else 99.0 for mean in means]


def _with_slots(gltf: dict[str, Any], indices: dict[Path, int]) -> dict[str, Any]:
    for path, index in indices.items():
        place = gltf
        for key in path[:-1]:
            place = place.setdefault(key, {})
        place[path[-1]] = {**place.get(path[-1], {}), "index": index}
    return gltf


def _with_kept(asset: Asset, own: MaterialSet, rows: Sequence[int]) -> MaterialSet:
    """`own` and, behind it, the asset's materials `rows` with the textures and images that they name."""
    known = asset.document.get("textures", ())
    named = sorted({info["index"] for row in rows for info in slots(asset.materials[row]).values()})
    sources = sorted({i for i in (image_index(known[t]) for t in named) if i is not None})
    textures = []
    for row in named:
        said = {key: value for key, value in known[row].items() if key not in ("source", "extensions")}
        image = image_index(known[row])
        if image is not None:
            said["source"] = sources.index(image) + len(own.images)
        if "sampler" in said:
            said["sampler"] += len(own.samplers)
        textures.append(said)
    materials = []
    for row in rows:
        gltf = renumbered(dict(asset.materials[row].gltf), {})
        for path, info in slots(asset.materials[row]).items():
            _with_slots(gltf, {path: named.index(info["index"]) + len(own.textures)})
        materials.append(Material(gltf))
    return MaterialSet(
        (*own.materials, *materials),
        (*own.images, *(asset.images[i] for i in sources)),
        (*own.textures, *textures),
        (*own.samplers, *asset.document.get("samplers", ())),
    )
