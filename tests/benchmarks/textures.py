"""Tables of UV repairs and of baked levels: ``python tests/benchmarks/textures.py ASSET… [--judge]``.

The first table has each mesh's repair to a one-to-one layout: the figures of its layout before and after, and how alike
six pictures are. The second compares levels at 10 % and 2 % that keep the source's textures (the stage's defaults) with
baked ones of the same number of triangles (the preset `baked`): PSNR over all pixels of `--views` pictures with normal
maps, and the error of the shading normals. The third is the shared harness' judge on the same and on a peer's levels
with our bake: it knows base colours and the levels' own normals, no normal maps, and counts pixels that are covered.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from lodpipe import io
from lodpipe.core.asset import Asset, Lod, Target
from lodpipe.geometry.bake import groups_of
from lodpipe.geometry.camera import Camera, views
from lodpipe.geometry.charts import charts_of
from lodpipe.geometry.render import buffers, render
from lodpipe.geometry.repair import uv_set
from lodpipe.geometry.surface import Model
from lodpipe.geometry.texture import Textures
from lodpipe.geometry.uv_defects import texture_sizes, uv_defects, uv_figures
from lodpipe.io import pixels_of
from lodpipe.reporting.table import table
from lodpipe.stage import Context
from lodpipe.stages.bake import BakeParams, bake
from lodpipe.stages.decimate import DecimateParams, decimate
from lodpipe.stages.repair_uv import RepairUvParams, repair_uv

RATIOS = (0.1, 0.02)
PEER = "meshopt_update"
#: Name, parameters of `decimate`, and whether it is baked.
CHAINS: tuple[tuple[str, dict[str, Any], bool], ...] = (
    ("shared", {}, False),
    ("shared visual", {"metric": "visual"}, False),
    ("baked", {"metric": "visual", "uvs": "free"}, True),
)
FIGURES = (
    "charts",
    "seam_length",
    "overlap_percent",
    "out_of_range_percent",
    "min_gutter_texels",
    "stretch_l2",
    "density_cv",
)


def repair_rows(path: Path, judge: Judge | None) -> list[list[str]]:
    """One row for each mesh that a repair changed."""
    asset, context = io.load(path), Context()
    repaired = repair_uv(asset, RepairUvParams(one_to_one=True), context)
    recorded = {m.name: m.value for m in context.measurements}
    seen = ["", ""]
    if repaired is not asset:
        seen = [f"{recorded['psnr']:.1f}", ""]
        if judge is not None:
            with tempfile.TemporaryDirectory() as folder:
                files = [_saved(a, Path(folder, name)) for a, name in ((asset, "a.glb"), (repaired, "b.glb"))]
                seen[1] = f"{judge(files[0], files[1:])[0]['tex']['psnr']:.1f}"
    read = {n: uv_set(asset, group) for group in groups_of(asset, asset.meshes, False) for n, _ in group.parts}
    rows = []
    for number, (old, new) in enumerate(zip(asset.meshes, repaired.meshes, strict=True)):
        if old is new or number not in read:
            continue
        a = uv_figures(old, charts_of(old, read[number]), read[number], texture_sizes(asset))
        b = uv_defects(new, texture_sizes(repaired))[0]
        pairs = [f"{getattr(a, name):.3g} → {getattr(b, name):.3g}" for name in FIGURES]
        rows.append([path.stem, old.name, *pairs, *seen])
    return rows


def bake_rows(path: Path, side: int | str, count: int, resolution: int, metric: str) -> list[list[str]]:
    """One row for each level."""
    asset = io.load(path)
    context = Context(lods=tuple(Target(ratio=ratio) for ratio in RATIOS))
    shared = decimate(asset, DecimateParams(), context)
    baked = decimate(asset, DecimateParams(metric=metric, uvs="free"), context)
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


def judged_rows(path: Path, side: int, judge: Judge, folder: Path) -> list[list[str]]:
    """One row for each level: the judge's PSNR of the source's textures on our levels, of baked levels, and of a
    peer's levels with our atlas and bake. All from the model as the peers see it: base colour alone."""
    ratios = [f"{ratio:g}" for ratio in RATIOS]
    judge.call("make", path, folder, PEER, *ratios)
    source = io.load(folder / "source.glb")
    chains: dict[str, Asset] = {}
    for name, params, baked in CHAINS:
        context = Context(lods=tuple(Target(ratio=ratio) for ratio in RATIOS))
        made = decimate(source, DecimateParams(**params), context)
        chains[name] = bake(made, BakeParams(size=side), context) if baked else made
    chains[f"{PEER} + bake"] = bake(_peer_levels(source, folder, ratios), BakeParams(size=side), Context())
    rows = []
    for number, ratio in enumerate(ratios, 1):
        levels = [(a, folder / f"{number}-{row}.glb") for row, a in enumerate(chains.values())]
        files = [_saved(a.at(a.lods[number]), file) for a, file in levels]
        figures = [found["tex"]["psnr"] for found in judge(folder / "source.glb", files)]
        counts = "/".join(str(a.lods[number].triangles) for a in chains.values())
        shared, _, best, peer = figures
        cells = [f"{value:.2f}" for value in figures]
        rows.append([path.stem, ratio, counts, *cells, f"{best - shared:+.2f}", f"{best - peer:+.2f}"])
    return rows


def _peer_levels(source: Asset, folder: Path, ratios: list[str]) -> Asset:
    """The source with a peer's levels in place of its own."""
    names = [material.name for material in source.materials]
    levels = [Lod(source.meshes)]
    for ratio in ratios:
        given = io.load(folder / f"{PEER}-{ratio}.glb")
        (mesh,) = given.meshes
        primitives = tuple(
            dataclasses.replace(p, material=names.index(given.materials[p.material].name)) for p in mesh.primitives
        )
        levels.append(Lod((dataclasses.replace(mesh, primitives=primitives),)))
    return dataclasses.replace(source, lods=tuple(levels))


def _saved(asset: Asset, path: Path) -> Path:
    io.save(asset, path)
    return path


class Judge:
    """The shared harness' judge, in an environment of its own."""

    def __init__(self, count: int, resolution: int) -> None:
        self.count, self.resolution = count, resolution

    def call(self, *arguments: object) -> str:
        """What judged.py prints; its complaints go through."""
        command = [sys.executable, str(Path(__file__).with_name("judged.py")), *map(str, arguments)]
        return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout

    def __call__(self, original: Path, files: list[Path]) -> list[dict[str, Any]]:
        """Its figures of each file."""
        found = self.call("look", original, self.count, self.resolution, *files)
        return json.loads(found.strip().splitlines()[-1])


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
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("assets", nargs="+", type=Path)
    parser.add_argument("--size", type=int, default=1024, help="side of baked textures")
    parser.add_argument("--views", type=int, default=8)
    parser.add_argument("--res", type=int, default=512)
    parser.add_argument("--metric", choices=("quadric", "visual"), default="visual", help="of the baked levels")
    parser.add_argument("--judge", action="store_true", help="ask the shared harness' judge, too")
    parser.add_argument("--only", choices=("repair", "bake", "judged"))
    options = parser.parse_args()
    judge = Judge(options.views, options.res) if options.judge or options.only == "judged" else None
    if options.only in (None, "repair"):
        head = ["asset", "mesh", *(f">{name.removesuffix('_percent')}" for name in FIGURES), ">PSNR", ">judge's"]
        print("\n".join(table(head, [row for path in options.assets for row in repair_rows(path, judge)])), "\n")
    if options.only in (None, "bake"):
        head = ["asset", ">shared", ">baked", ">texels", ">shared dB", ">baked dB", ">gain", ">shared °", ">baked °"]
        size = options.size, options.views, options.res, options.metric
        print("\n".join(table([*head, ">missed %"], [r for p in options.assets for r in bake_rows(p, *size)])), "\n")
    if judge is not None and options.only in (None, "judged"):
        rows = []
        for path in options.assets:
            with tempfile.TemporaryDirectory() as folder:
                rows += judged_rows(path, options.size, judge, Path(folder))
        head = ["asset", ">ratio", ">triangles", *(f">{name}" for name, _, _ in CHAINS), f">{PEER} + bake"]
        print("\n".join(table([*head, ">over shared", ">over peer"], rows)))


if __name__ == "__main__":
    main()
