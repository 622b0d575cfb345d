"""Stage `bake`: new UVs and textures for the levels, made from the source."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Annotated, Literal

from pydantic import Field

from lodpipe.core.asset import Asset, Lod, Target
from lodpipe.geometry.bake import BakeOptions, Group, bake_level, groups_of
from lodpipe.geometry.bake_size import auto_side
from lodpipe.geometry.bake_source import SourceMesh
from lodpipe.geometry.decimate import decimate_asset
from lodpipe.geometry.flatten import flatten
from lodpipe.geometry.occlusion import Occlusion
from lodpipe.geometry.slots import SlotTextures
from lodpipe.geometry.switch import settle_switches
from lodpipe.stage import Context, Params, stage
from lodpipe.stages._textures import Encoding, Format, decoded, finished, likeness

Side = Annotated[int, Field(ge=16, le=16384)]


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
    occlusion: Literal["source", "rays"] = "source"
    """`rays`: an occlusion map made from the shape of the source, in place of what its materials have."""
    format: Format = "png"
    """Of the images; normal maps stay lossless. KTX2 needs toktx or basisu on the machine."""
    quality: int = Field(90, ge=1, le=100)
    """Of JPEG and WebP."""
    reach: float | None = Field(None, gt=0, le=100)
    """How far from a level its source is looked for, in % of the bounding box's diagonal; left out: twice the level's
    error."""
    compare: bool = False
    """Also make levels of as many triangles that keep the source's textures, and report how alike six pictures of
    these and of the baked ones are to the source."""
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
    sky = Occlusion(asset, threads=context.threads) if params.occlusion == "rays" else None
    levels = [asset.lods[0]]
    for number, level in enumerate(asset.lods[1:], 1):
        context.check_cancelled()
        groups = groups_of(asset, level.meshes, params.merge_materials)
        for group in groups:
            group.side = _side(params.size, number, asset, level, group)
            for index, _ in group.parts:
                if index not in sources:
                    segments = asset.segments.vertex_segment[index] if asset.segments else None
                    sources[index] = SourceMesh(asset.meshes[index], context.threads, segments)
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
            sky=sky,
            progress=_progress(context, number - 1, len(asset.lods) - 1),
            cancelled=context.cancelled,
        )
        for problem in baked.problems:
            context.warn(f"level {number}: {problem}; those charts are laid out by direction")
        missed = 100 * baked.missed / max(baked.texels, 1)
        context.record(f"lod{number}.texels", baked.texels)
        context.record(f"lod{number}.missed", missed, "%")
        context.record(f"lod{number}.size", max((group.side for group in groups), default=0), "texels")
        encoding = Encoding(params.format, params.quality, f"{asset.name}_LOD{number}")
        levels.append(finished(asset, level, baked, encoding, context))
        context.progress(number, len(asset.lods) - 1)
    baked_asset = dataclasses.replace(asset, lods=tuple(levels))
    if params.compare:
        _compare(baked_asset, context)
    return baked_asset


def _compare(asset: Asset, context: Context) -> None:
    """Record how alike pictures of the source and of each level are, and of a level of as many triangles that keeps
    the source's UVs and textures."""
    source = dataclasses.replace(asset, lods=())
    goals = [Target(triangles=max(level.triangles, 1)) for level in asset.lods[1:]]
    shared = decimate_asset(source, goals, threads=context.threads, cancelled=context.cancelled)
    for number, (level, other) in enumerate(zip(asset.lods[1:], shared[1:], strict=True), 1):
        pair = [dataclasses.replace(asset.at(lod), lods=()) for lod in (other, level)]
        for name, value in zip(("shared", "baked"), likeness(source, pair, context), strict=True):
            context.record(f"lod{number}.psnr_{name}", value, "dB")


def _progress(context: Context, done: int, total: int) -> Callable[[float], None]:
    return lambda share: context.progress(done + share, total)


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
