"""Pictures of repaired UVs and baked levels: ``python docs/make_bakes.py [-o FOLDER] [--ratio R] ASSET…``.

A sheet for each asset: the source, the source with repaired UVs, a level with the source's textures and the baked level
of as many triangles; below, the same with all textures at mip 3, where thin gutters would show; then the UV layouts.
Without an asset: the pictures in docs/baking.md, of the sample animal.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import lodpipe
from lodpipe.core.asset import Asset, Target
from lodpipe.geometry.camera import Camera
from lodpipe.geometry.render import render
from lodpipe.geometry.sheet import contact_sheet, png_bytes
from lodpipe.geometry.surface import Model
from lodpipe.geometry.texture import U8, Textures
from lodpipe.geometry.uv_picture import uv_picture
from lodpipe.io import pixels_of
from lodpipe.stage import Context
from lodpipe.stages.bake import BakeParams, bake
from lodpipe.stages.decimate import DecimateParams, decimate
from lodpipe.stages.repair_uv import RepairUvParams, repair_uv

ROOT = Path(__file__).parent.parent
DIRECTION = (0.75, 0.3, 1.0)
MIP = 3


def sheet(asset: Asset, ratio: float = 0.05, size: int = 480, texels: int = 512) -> U8:
    """The sheet of one asset."""
    context = Context(lods=(Target(ratio=ratio),))
    repaired = repair_uv(asset, RepairUvParams.model_validate({"one_to_one": True}), context)
    shared = decimate(asset, DecimateParams.model_validate({}), context)
    made = decimate(asset, DecimateParams.model_validate({"metric": "visual", "uvs": "free"}), context)
    baked = bake(made, BakeParams.model_validate({"size": texels}), context)
    for told in context.warnings:
        print(told, file=sys.stderr)
    shown = [replace(a, lods=()) for a in (asset, repaired, shared.at(shared.lods[1]), baked.at(baked.lods[1]))]
    titles = ["source", "repaired UVs" if repaired is not asset else "UVs that need no repair"]
    titles += [
        f"{level.lods[1].triangles:,} triangles, {what}" for level, what in ((shared, "shared"), (baked, "baked"))
    ]
    pictures, labels = [], []
    for mip in (0, MIP):
        pixels = [_reduced(pixels_of(a), mip) for a in shown]
        models = [Model(a, None, Textures(get)) for a, get in zip(shown, pixels, strict=True)]
        camera = Camera.around(models[0].centre, models[0].radius, DIRECTION)
        pictures += [render(model, camera, size, size, supersample=3) for model in models]
        labels += [f"{title}, mip {mip}" for title in titles]
    largest = max(range(len(asset.meshes)), key=lambda number: len(asset.meshes[number].faces))
    pictures += [uv_picture(a.meshes[largest], size=size) for a in shown]
    labels += ["UVs of its largest mesh"] * len(shown)
    return contact_sheet(pictures, labels, columns=len(shown))


def _reduced(get: Callable[[int], U8 | None], mip: int) -> Callable[[int], U8 | None]:
    """Images with nothing finer than a mip level: means over squares, as wide as the level's texels."""

    def pixels(image: int) -> U8 | None:
        found = get(image)
        step = 2**mip
        if found is None or step == 1 or min(found.shape[:2]) < 2 * step:
            return found
        height, width = (size // step for size in found.shape[:2])
        squares = found[: height * step, : width * step].reshape(height, step, width, step, -1)
        reduced: U8 = np.rint(squares.mean(axis=(1, 3))).astype(np.uint8)
        return reduced

    return pixels


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the sheets."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("assets", nargs="*", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/bakes"))
    parser.add_argument("--ratio", type=float, default=0.05)
    parser.add_argument("--size", type=int, default=480, help="width of one picture in pixels")
    parser.add_argument("--texels", type=int, default=512, help="side of baked textures")
    options = parser.parse_args(arguments)
    jobs = [(path, options.output / f"{path.stem}.png", options.size) for path in options.assets]
    if not jobs:
        jobs = [(ROOT / "sample_assets" / "animal.glb", ROOT / "docs" / "images" / "baked.png", 250)]
    for path, target, size in jobs:
        picture = sheet(lodpipe.load(path), options.ratio, size, options.texels)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(png_bytes(picture))
        print(target)


if __name__ == "__main__":
    main()
