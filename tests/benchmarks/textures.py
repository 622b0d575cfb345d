"""Tables of UV repairs and of baked levels: ``python tests/benchmarks/textures.py ASSET…``.

The first table has each material's repair to a one-to-one layout: charts, overlap, gutter and stretch before and after,
and how alike six pictures are. The second compares levels at 10 % and 2 % that keep the source's textures with baked
ones of the same number of triangles: PSNR over the pixels of `--views` pictures, and the error of the shading normals.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from lodpipe import io
from lodpipe.core.asset import Asset, Target
from lodpipe.geometry.camera import Camera, views
from lodpipe.geometry.render import buffers, render
from lodpipe.geometry.surface import Model
from lodpipe.geometry.texture import Textures
from lodpipe.geometry.uv_defects import texture_sizes, uv_defects
from lodpipe.io import pixels_of
from lodpipe.reporting.table import table
from lodpipe.stage import Context
from lodpipe.stages.bake import BakeParams, bake
from lodpipe.stages.decimate import DecimateParams, decimate
from lodpipe.stages.repair_uv import RepairUvParams, repair_uv

RATIOS = (0.1, 0.02)


def repair_rows(path: Path) -> list[list[str]]:
    """One row for each mesh that a repair changed."""
    asset, context = io.load(path), Context()
    repaired = repair_uv(asset, RepairUvParams(one_to_one=True), context)
    recorded = {m.name: m.value for m in context.measurements}
    rows = []
    for old, new in zip(asset.meshes, repaired.meshes, strict=True):
        a, b = uv_defects(old, texture_sizes(asset))[0], uv_defects(new, texture_sizes(repaired))[0]
        if a == b and repaired is not asset:
            continue
        pairs = [
            f"{getattr(a, name):.3g} → {getattr(b, name):.3g}"
            for name in ("charts", "overlap_percent", "out_of_range_percent", "min_gutter_texels", "stretch_l2")
        ]
        verdict = "kept" if repaired is asset else f"{recorded['psnr']:.1f}"
        rows.append([path.stem, old.name, *pairs, verdict])
    return rows


def bake_rows(path: Path, side: int | str, count: int, resolution: int, uvs: str) -> list[list[str]]:
    """One row for each level."""
    asset = io.load(path)
    context = Context(lods=tuple(Target(ratio=ratio) for ratio in RATIOS))
    shared = decimate(asset, DecimateParams(), context)
    baked = decimate(asset, DecimateParams(uvs=uvs), context) if uvs == "free" else shared
    baked = bake(baked, BakeParams(size=side), context)
    recorded = {m.name: m.value for m in context.measurements}
    source = _model(asset)
    cameras = [Camera.around(source.centre, source.radius, direction, fov=None) for direction in views(count)]
    rows = []
    for number in range(1, len(RATIOS) + 1):
        models = [_model(a.at(a.lods[number])) for a in (shared, baked)]
        likeness = [np.mean([_psnr(source, model, camera, resolution) for camera in cameras]) for model in models]
        angles = [np.mean([_angle(source, model, camera, resolution) for camera in cameras]) for model in models]
        triangles = [a.lods[number].triangles for a in (shared, baked)]
        gain = f"{likeness[1] - likeness[0]:+.2f}"
        figures = [f"{likeness[0]:.2f}", f"{likeness[1]:.2f}", gain, f"{angles[0]:.2f}", f"{angles[1]:.2f}"]
        missed = f"{recorded[f'lod{number}.missed']:.3f}"
        rows.append([path.stem, *map(str, triangles), str(recorded[f"lod{number}.size"]), *figures, missed])
    return rows


def _model(asset: Asset) -> Model:
    return Model(dataclasses.replace(asset, lods=()), None, Textures(pixels_of(asset)))


def _psnr(a: Model, b: Model, camera: Camera, size: int) -> float:
    pictures = [render(model, camera, size, size).astype(np.float32) for model in (a, b)]
    mean = float(np.square(pictures[0] - pictures[1]).mean())
    return float(10 * np.log10(255**2 / max(mean, 1e-9)))


def _angle(a: Model, b: Model, camera: Camera, size: int) -> float:
    """Mean angle in degrees between the shading normals where both are seen."""
    first, second = (buffers(model, camera, size, size) for model in (a, b))
    both = first.hit & second.hit
    cosine = np.einsum("nd,nd->n", first.normals[both], second.normals[both])
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("assets", nargs="+", type=Path)
    parser.add_argument("--size", type=int, default=1024, help="side of baked textures")
    parser.add_argument("--views", type=int, default=8)
    parser.add_argument("--res", type=int, default=512)
    parser.add_argument("--uvs", choices=("kept", "free"), default="free", help="see `decimate`")
    parser.add_argument("--only", choices=("repair", "bake"))
    options = parser.parse_args()
    if options.only != "bake":
        head = ["asset", "mesh", ">charts", ">overlap %", ">outside %", ">gutter", ">stretch", ">PSNR dB"]
        print("\n".join(table(head, [row for path in options.assets for row in repair_rows(path)])), "\n")
    if options.only != "repair":
        head = ["asset", ">shared", ">baked", ">texels", ">shared dB", ">baked dB", ">gain", ">shared °", ">baked °"]
        rows = [r for p in options.assets for r in bake_rows(p, options.size, options.views, options.res, options.uvs)]
        print("\n".join(table([*head, ">missed %"], rows)))


if __name__ == "__main__":
    main()
