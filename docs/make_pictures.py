"""Pictures of models and their levels, side by side: ``python docs/make_pictures.py [-o FOLDER] ASSET…``.

For each asset one sheet: above the source and the levels as they look, below with their triangles' edges. Without an
asset: the picture in README.md (docs/images/lods.png), of the sample animal.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import lodpipe
from lodpipe.core.asset import Asset, Target
from lodpipe.geometry.camera import Camera
from lodpipe.geometry.decimate import decimate_asset
from lodpipe.geometry.render import Style, render
from lodpipe.geometry.sheet import contact_sheet, png_bytes
from lodpipe.geometry.surface import Model
from lodpipe.geometry.texture import Textures
from lodpipe.io import pixels_of

ROOT = Path(__file__).parent.parent
RATIOS = (0.5, 0.25, 0.1, 0.02)
DIRECTION = (0.75, 0.3, 1.0)


def sheet(
    asset: Asset, ratios: Sequence[float] = RATIOS, size: int = 480, direction: Sequence[float] = DIRECTION
) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """The source and a level for each of `ratios` from one direction; the second row has wires."""
    levels = decimate_asset(asset, [Target(ratio=ratio) for ratio in ratios])
    images = Textures(pixels_of(asset, lambda text: print(text, file=sys.stderr)))
    models = [Model(asset, level.meshes, images) for level in levels]
    camera = Camera.around(models[0].centre, max(model.radius for model in models), direction)
    wires = Style(mode="clay", wireframe=1)
    pictures = [render(model, camera, size, size, supersample=3) for model in models]
    pictures += [render(model, camera, size, size, wires, supersample=3) for model in models]
    labels = [f"{level.triangles:,} triangles" for level in levels]
    labels += ["source", *(f"{100 * ratio:g} %" for ratio in ratios)]
    return contact_sheet(pictures, labels, columns=len(levels))


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the sheets."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("assets", nargs="*", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/pictures"))
    parser.add_argument("--size", type=int, default=480, help="width of one picture in pixels")
    parser.add_argument("--view", type=float, nargs=3, default=DIRECTION, metavar=("X", "Y", "Z"), help="seen from")
    options = parser.parse_args(arguments)
    jobs = [(path, options.output / f"{path.stem}.png", options.size, RATIOS) for path in options.assets]
    if not jobs:
        jobs = [(ROOT / "sample_assets" / "animal.glb", ROOT / "docs" / "images" / "lods.png", 250, RATIOS)]
    for path, target, size, ratios in jobs:
        picture = sheet(lodpipe.load(path), ratios, size, options.view)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(png_bytes(picture))
        print(target)


if __name__ == "__main__":
    main()
