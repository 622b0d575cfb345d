"""Stage `repair_uv`: UVs that a bake, or a comparison by UVs, can stand on."""

from __future__ import annotations

import dataclasses
from typing import Literal

from pydantic import Field

from lodpipe.core.asset import Asset, Lod
from lodpipe.core.errors import InvalidMesh
from lodpipe.core.mesh import F64
from lodpipe.geometry.bake import BakeOptions, Group, bake_level, groups_of
from lodpipe.geometry.bake_source import SourceMesh
from lodpipe.geometry.charts import charts_of
from lodpipe.geometry.repair import Plan, RepairOptions, new_layout, plan, uv_set, with_worst_anew, worsened
from lodpipe.geometry.slots import SlotTextures
from lodpipe.geometry.uv_defects import texture_sizes, uv_defects, uv_figures
from lodpipe.stage import Context, Params, stage
from lodpipe.stages._textures import Encoding, Format, decoded, finished, likeness

FAULTS = ("overlap_percent", "out_of_range_percent", "zero_area_faces", "missing_faces")
"""Figures of which a repair that makes them worse is not taken; of the others it is told."""
ROUNDS = 3
"""How often a layout is made anew with more faces to unfold."""


class RepairUvParams(Params):
    """Parameters of `repair_uv`."""

    when: Literal["needed", "always", "never"] = "needed"
    """`needed` leaves materials whose UVs are good as they are, to the byte; `always` packs all of them anew."""
    one_to_one: bool = False
    """Ask for texels of its own for every face, as bakes and comparisons by UVs do: overlaps, mirrored halves and
    tiling then count as broken too. Without it only missing UVs do."""
    merge_materials: bool = False
    """Put materials that differ only in what a texture can hold into one atlas, those of several meshes too."""
    padding: float = Field(4.0, ge=1, le=64)
    """Least distance between two charts, in texels."""
    size: int | None = Field(None, ge=16, le=16384)
    """Width and height of new textures; left out: the least power of two in which no texel is lost."""
    max_size: int = Field(4096, ge=16, le=16384)
    """No new texture is larger, unless `size` says so; its texels may then be larger than the old ones."""
    format: Format = "png"
    """Of new images."""
    quality: int = Field(95, ge=1, le=100)
    """Of JPEG and WebP."""
    least_psnr: float = Field(40.0, ge=0)
    """A repair that looks less like the source than that, in dB over six pictures, is not taken."""
    seconds: float = Field(60.0, gt=0)
    """Time for xatlas to unfold the faces of a mesh that need it."""


@stage("repair_uv")
def repair_uv(asset: Asset, params: RepairUvParams, context: Context) -> Asset:
    """Mend the source's UVs where they are broken, and move its textures along without loss."""
    if params.when == "never":
        return asset
    if len(asset.lods) > 1:
        context.warn("repair_uv mends the source; it belongs before the stage that makes levels, and did nothing")
        return asset
    options = RepairOptions(
        one_to_one=params.one_to_one,
        padding=params.padding,
        size=params.size,
        largest=params.max_size,
        always=params.when == "always",
        seconds=params.seconds,
    )
    groups = groups_of(asset, asset.meshes, merge=params.merge_materials)
    plans = [p for p in plan(asset, groups, options) if p.reasons or len(p.group.materials) > 1]
    context.record("repaired_materials", len(plans))
    if not plans:
        return asset
    for mesh in asset.meshes:
        if mesh.keep_reason:
            context.warn(f"mesh '{mesh.name}' keeps its UVs: {mesh.keep_reason}")
    while plans:
        repaired = _repaired(asset, plans, options, params, context)
        worse = _worse(asset, repaired, plans, params, context)
        refused = {number for number, told in worse.items() if any(name in told for name in FAULTS)}
        for number, told in worse.items():
            what = "keeps its UVs: a repair would make worse" if number in refused else "is worse after the repair:"
            context.warn(f"mesh '{asset.meshes[number].name}' {what} {told}")
        if not refused:
            break
        plans = [p for p in plans if not any(number in refused for number, _ in p.group.parts)]
    else:
        return asset
    psnr = likeness(asset, [repaired], context)[0]
    context.record("psnr", psnr, "dB")
    if psnr < params.least_psnr:
        context.warn(
            f"the repair was not taken: it looks too different ({psnr:.1f} dB, where at least {params.least_psnr:g} "
            "are asked for)"
        )
        return asset
    return repaired


def _repaired(
    asset: Asset, plans: list[Plan], options: RepairOptions, params: RepairUvParams, context: Context
) -> Asset:
    layouts = []
    groups: list[Group] = []
    for planned in plans:
        names = [asset.materials[row].name or f"materials[{row}]" for row in planned.group.materials if row >= 0]
        name = ", ".join(names) or "default material"
        try:
            planned, (uv, side, scale, problem) = _laid_out(asset, planned, options, context)
        except InvalidMesh as error:
            context.warn(f"{name}: not repaired: {error}")
            continue
        context.log.info("%s: repaired: %s", name, ", ".join(planned.reasons))
        context.record(f"{name}.size", side, "texels")
        if scale < 0.999:
            context.warn(f"{name}: {side} × {side} texels hold its charts at {100 * scale:.0f} % of their size")
        if problem:
            context.warn(f"{name}: {problem}; those charts are laid out by direction")
        planned.group.side = side
        groups.append(planned.group)
        layouts.append(uv)
    if not groups:
        return asset
    sources = {number: SourceMesh(asset.meshes[number], context.threads) for g in groups for number, _ in g.parts}
    level = Lod(asset.meshes)
    bake = BakeOptions(padding=params.padding, threads=context.threads, samples=1, same_surface=True)
    baked = bake_level(
        asset,
        level,
        groups,
        sources,
        SlotTextures(asset, decoded(asset, context)),
        0.0,
        bake,
        layouts=layouts,
        progress=lambda share: context.progress(share, 1.0),
        cancelled=context.cancelled,
    )
    encoding = Encoding(params.format, params.quality, asset.name)
    made = finished(asset, level, baked, encoding, context)
    whole = asset.at(made)
    return dataclasses.replace(whole, lods=(Lod(whole.meshes),))


def _laid_out(
    asset: Asset, planned: Plan, options: RepairOptions, context: Context
) -> tuple[Plan, tuple[F64, int, float, str]]:
    """A layout that is stretched no more than the old one: faces that are to blame are unfolded anew, too."""
    made = new_layout(asset, planned, options, context.cancelled)
    for _ in range(ROUNDS):
        again = with_worst_anew(asset, planned, made[0])
        if again is None:
            break
        planned, made = again, new_layout(asset, again, options, context.cancelled)
    return planned, made


def _worse(before: Asset, after: Asset, plans: list[Plan], params: RepairUvParams, context: Context) -> dict[int, str]:
    """Mesh -> what has become worse; how many more charts and how much longer seams there are goes into the report."""
    told = {}
    sizes = [texture_sizes(asset) for asset in (before, after)]
    read = {number: uv_set(before, planned.group) for planned in plans for number, _ in planned.group.parts}
    for number, name in read.items():
        old, new = before.meshes[number], after.meshes[number]
        if old is new:
            continue
        a = uv_figures(old, charts_of(old, name), name, sizes[0])
        b = uv_defects(new, sizes[1])[0]
        context.record(f"{old.name}.charts", b.charts - a.charts)
        context.record(f"{old.name}.seams", b.seam_length - a.seam_length, "diagonals")
        if worse := worsened(a, b, params.padding):
            told[number] = ", ".join(worse)
    return told
