"""Stage `bake`: new UVs and textures for the levels, made from the source."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Literal

from pydantic import Field

from lodpipe import io
from lodpipe.core.asset import Asset, Lod
from lodpipe.core.errors import AssetError
from lodpipe.core.material import Image, Material, MaterialSet, renumbered
from lodpipe.core.mesh import Mesh
from lodpipe.geometry.bake import Baked, BakeOptions, Group, bake_level, groups_of
from lodpipe.geometry.bake_size import auto_side
from lodpipe.geometry.bake_source import SourceMesh
from lodpipe.geometry.flatten import flatten
from lodpipe.geometry.slots import Path, SlotTextures, is_colour, is_normal, map_name, slots
from lodpipe.geometry.switch import settle_switches
from lodpipe.geometry.texture import U8
from lodpipe.stage import Context, Params, stage

Side = Annotated[int, Field(ge=16, le=16384)]
CLAMP = 33071
SAMPLER = {"magFilter": 9729, "minFilter": 9987, "wrapS": CLAMP, "wrapT": CLAMP}


class BakeParams(Params):
    """Parameters of `bake`."""

    maps: tuple[str, ...] | Literal["all"] = "all"
    """base_color, normal, metallic_roughness, occlusion, emissive, or the name of an extension's slot; `all`: what the
    materials have, and normals of the source's geometry."""
    size: Side | tuple[Side, ...] | Literal["auto"] = "auto"
    """Width and height of the textures: one number, one for each level below the source (the last for all further
    ones), or `auto`: a texel for each pixel at the largest size on screen at which the level is used."""
    padding: float | None = Field(None, ge=1, le=256)
    """Least distance between two charts in texels; left out: a 42nd of the texture's side, so that charts stay apart
    down to an eighth of it."""
    merge_materials: bool = False
    """Put materials that differ only in what a texture can hold into one, so that they are one draw call."""
    format: Literal["png", "jpeg", "webp", "ktx2"] = "png"
    """Of the images; normal maps stay lossless. KTX2 needs toktx or basisu on the machine."""
    quality: int = Field(90, ge=1, le=100)
    """Of JPEG and WebP."""
    reach: float | None = Field(None, gt=0, le=100)
    """How far from a level its source is looked for, in % of the bounding box's diagonal; left out: twice the level's
    error."""
    seconds: float = Field(60.0, gt=0)
    """Time for xatlas to unfold a texture's charts; after it they are laid out in a simpler way."""


@stage("bake")
def bake(asset: Asset, params: BakeParams, context: Context) -> Asset:
    """Give each level below the source UVs and textures of its own, with what the source looks like."""
    if len(asset.lods) < 2:
        return asset
    asset = settle_switches(asset)
    textures = SlotTextures(asset, decoded(asset, context))
    sources: dict[int, SourceMesh] = {}
    for mesh in asset.meshes:
        if mesh.keep_reason:
            context.warn(f"mesh '{mesh.name}' keeps its textures: {mesh.keep_reason}")
    diagonal = flatten(asset).diagonal
    levels = [asset.lods[0]]
    for number, level in enumerate(asset.lods[1:], 1):
        context.check_cancelled()
        groups = groups_of(asset, level.meshes, params.merge_materials)
        for group in groups:
            group.side = _side(params.size, number, asset, level, group)
            for index, _ in group.parts:
                if index not in sources:
                    sources[index] = SourceMesh(asset.meshes[index], context.threads)
        options = BakeOptions(
            maps=None if params.maps == "all" else tuple(params.maps),
            padding=params.padding,
            merge=params.merge_materials,
            seconds=params.seconds,
            threads=context.threads,
        )
        baked = bake_level(
            asset,
            level,
            groups,
            sources,
            textures,
            _reach(params.reach, level, diagonal),
            options,
            progress=_progress(context, number - 1, len(asset.lods) - 1),
            cancelled=context.cancelled,
        )
        for problem in baked.problems:
            context.warn(f"level {number}: {problem}; those charts are laid out by direction")
        missed = 100 * baked.missed / max(baked.texels, 1)
        context.record(f"lod{number}.texels", baked.texels)
        context.record(f"lod{number}.missed", missed, "%")
        context.record(f"lod{number}.size", max((group.side for group in groups), default=0), "texels")
        levels.append(_level(asset, level, baked, number, params, context))
        context.progress(number, len(asset.lods) - 1)
    return dataclasses.replace(asset, lods=tuple(levels))


def _progress(context: Context, done: int, total: int) -> Callable[[float], None]:
    return lambda share: context.progress(done + share, total)


def decoded(asset: Asset, context: Context) -> dict[int, U8]:
    """The pixels of every image that a slot reads; what cannot be decoded is warned of."""
    from lodpipe.geometry.surface import image_index

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
        except AssetError as error:
            context.warn(f"{error}; its place in baked textures holds the factors alone")
    return pixels


def _side(size: int | Sequence[int] | str, number: int, asset: Asset, level: Lod, group: Group) -> int:
    if isinstance(size, int):
        return size
    if isinstance(size, str):
        return auto_side(asset, level, group)
    return size[min(number, len(size)) - 1]


def _reach(given: float | None, level: Lod, diagonal: float) -> float:
    if given is not None:
        return given / 100 * diagonal
    error = level.error.max if level.error is not None else 4 * level.estimate
    return max(2 * error, 0.5) / 100 * diagonal


def _level(asset: Asset, level: Lod, baked: Baked, number: int, params: BakeParams, context: Context) -> Lod:
    """The level with its images encoded, and with what unbaked meshes still need."""
    materials: list[Material] = []
    images: list[Image] = []
    textures: list[dict[str, Any]] = []
    for made in baked.materials:
        gltf = made.gltf
        indices: dict[Path, int] = {}
        for path, pixels in made.maps.items():
            name = f"{asset.name}_LOD{number}_{gltf.get('name') or len(materials)}_{map_name(path)}"
            image = io.encode_image(
                pixels,
                "".join(c if c.isalnum() or c in "_-+." else "_" for c in name),
                params.format,
                quality=params.quality,
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
    return dataclasses.replace(level, **_with_kept(asset, baked.meshes, own))


def _with_slots(gltf: dict[str, Any], indices: dict[Path, int]) -> dict[str, Any]:
    for path, index in indices.items():
        place = gltf
        for key in path[:-1]:
            place = place.setdefault(key, {})
        place[path[-1]] = {**place.get(path[-1], {}), "index": index}
    return gltf


def _with_kept(asset: Asset, meshes: Sequence[Mesh], own: MaterialSet) -> dict[str, Any]:
    """Fields of a level: meshes that were not baked bring the source's materials and textures along."""
    kept = [mesh for mesh in meshes if mesh.keep_reason]
    rows = sorted({p.material for mesh in kept for p in mesh.primitives if p.material is not None})
    if not rows:
        return {"meshes": tuple(meshes), "own": own}
    from lodpipe.geometry.surface import image_index

    all_textures = asset.document.get("textures", ())
    named = sorted({info["index"] for row in rows for info in slots(asset.materials[row]).values()})
    sources = sorted({i for i in (image_index(all_textures[t]) for t in named) if i is not None})
    first = len(own.materials)
    textures = []
    for row in named:
        said = dict(all_textures[row])
        image = image_index(said)
        said = {key: value for key, value in said.items() if key not in ("source", "extensions")}
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
    whole = MaterialSet(
        (*own.materials, *materials),
        (*own.images, *(asset.images[i] for i in sources)),
        (*own.textures, *textures),
        (*own.samplers, *asset.document.get("samplers", ())),
    )
    moved = []
    for mesh in meshes:
        if mesh.keep_reason:
            primitives = tuple(
                p if p.material is None else dataclasses.replace(p, material=first + rows.index(p.material))
                for p in mesh.primitives
            )
            mesh = dataclasses.replace(mesh, primitives=primitives)
        moved.append(mesh)
    return {"meshes": tuple(moved), "own": whole}
