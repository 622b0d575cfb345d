"""Write the sample models: ``python sample_assets/make.py [FOLDER]``, this script's own folder if none is given.

The same bytes each time. README.md tells what each model is good for.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from animal import animal_mesh, colour
from atlas import Atlas, paint, unwrap
from build import Part, asset, label
from lodpipe.core.asset import Asset
from lodpipe.io import save
from shapes import buoy, cubes, mug, ring, starfish, terrain


def animal() -> Asset:
    """A pig-like animal with a one-to-one atlas, striped, its larger charts numbered."""
    positions, faces = animal_mesh()
    atlas = unwrap(positions, faces)
    texture = paint(atlas, positions, faces, colour)
    middles = np.array([_middle(atlas, chart) for chart in range(12)]) * atlas.size
    texture = label(texture, middles, [str(i + 1) for i in range(len(middles))], 22)
    return asset("animal", positions, [Part(faces, atlas.uv, texture, "skin")], crease=60)


def _middle(atlas: Atlas, chart: int) -> tuple[float, float]:
    """The centre of the chart's face that is nearest to the mean of all its faces: inside, whatever the shape."""
    centres = atlas.uv[atlas.chart == chart].mean(axis=1)
    u, v = centres[np.linalg.norm(centres - centres.mean(axis=0), axis=1).argmin()]
    return float(u), float(v)


SAMPLES = (animal, mug, starfish, cubes, terrain, buoy, ring)


def main(folder: Path) -> None:
    """Write each sample as FOLDER/NAME.glb."""
    folder.mkdir(parents=True, exist_ok=True)
    for make in SAMPLES:
        made = make()
        for path in save(made, folder / f"{made.name}.glb"):
            print(f"{path}: {made.triangles:,} triangles")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
