"""`export`: the levels as files."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from lodpipe import io
from lodpipe.core.asset import Asset, Lod
from lodpipe.core.errors import OutputError
from lodpipe.geometry.switch import coverages, settle_switches
from lodpipe.stage import Context, Params, stage

Format = Literal["glb", "gltf", "obj", "ply", "stl", "off"]


class ExportParams(Params):
    """Parameters of `export`."""

    formats: Annotated[tuple[Format, ...], Field(min_length=1)] = ("glb",)
    """File formats, each level in each of them."""
    combined: bool = False
    """Write all levels into one GLB too (MSFT_lod, with the screen coverages at which to switch)."""


@stage("export")
def export(asset: Asset, params: ExportParams, context: Context) -> Asset:
    """Write each level to ``LOD<n>/<asset>_LOD<n>.<format>``, and all of them to ``<asset>.glb`` if `combined`."""
    if context.output is None:
        raise OutputError("there is no folder to write into", advice="give one, or leave `export` out of the chain")
    asset = settle_switches(asset)
    levels = asset.lods or (Lod(asset.meshes),)
    formats = dict.fromkeys(params.formats)
    total = len(levels) * len(formats) + params.combined
    done = 0
    for number, level in enumerate(levels):
        if level.own is None and _lost_uvs(asset, level):
            context.warn(f"level {number} has no UVs for its textures: `bake` belongs after `decimate: {{uvs: free}}`")
        folder = context.output / f"LOD{number}"
        folder.mkdir(parents=True, exist_ok=True)
        for kind in formats:
            context.check_cancelled()
            path = folder / f"{asset.name}_LOD{number}.{kind}"
            written = io.save(asset.at(level), path, warn=context.warn)
            _note(context, number, written)
            done += 1
            context.progress(done, total)
    if params.combined:
        path = context.output / f"{asset.name}.glb"
        whole = dataclasses.replace(asset, lods=levels).with_one_material_set()
        meshes = [level.meshes for level in whole.lods]
        written = io.save_combined(whole, path, meshes, coverages(levels), warn=context.warn)
        _note(context, -1, written)
        context.progress(total, total)
    return asset


def _lost_uvs(asset: Asset, level: Lod) -> bool:
    """Whether a mesh of the level lacks the UVs that the source's has."""
    pairs = zip(asset.meshes, level.meshes, strict=True)
    return any("TEXCOORD_0" in old.attributes and "TEXCOORD_0" not in new.attributes for old, new in pairs)


def _note(context: Context, number: int, written: list[Path]) -> None:
    """Note files of a level, by their paths inside the output folder."""
    if context.output is None:
        return
    known = context.files.setdefault(number, [])
    known.extend(path for path in (file.relative_to(context.output) for file in written) if path not in known)
