"""How large a level's textures need to be."""

from __future__ import annotations

import numpy as np

from lodpipe.core.asset import Asset, Lod
from lodpipe.geometry.bake import Group
from lodpipe.geometry.flatten import flatten
from lodpipe.geometry.switch import SCREEN_HEIGHT
from lodpipe.geometry.uv_defects import texture_sizes

FILL = 0.6
"""Share of a texture that its charts take up."""
LARGEST_WITHOUT = 2048
"""For materials without a texture, whose normals alone are baked."""
SMALLEST = 64


def auto_side(asset: Asset, level: Lod, group: Group) -> int:
    """A power of two: the side of a square texture with a texel for each pixel where the level is seen largest.

    That is where it takes over from the finer one (`Lod.switch`): the bounding box's diagonal covers so much of a
    screen of 1080 lines. It is no more than the largest of the source's textures has, and at least 64.
    """
    coverage = level.switch.screen_coverage if level.switch else 1.0
    soup = flatten(asset, level.meshes)
    a, b, c = (soup.positions[soup.faces[:, k]] for k in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    area = float(areas[np.isin(soup.face_material, group.materials)].sum())
    pixels = coverage * SCREEN_HEIGHT / max(soup.diagonal, 1e-300)
    wanted = np.sqrt(max(area, 0.0) / FILL) * pixels
    sizes = texture_sizes(asset)
    largest = max((max(sizes[row]) for row in group.materials if row in sizes), default=LARGEST_WITHOUT)
    largest = 2 ** round(np.log2(max(largest, SMALLEST)))
    return int(np.clip(2 ** np.ceil(np.log2(max(wanted, 1.0)) - 0.25), SMALLEST, largest))
