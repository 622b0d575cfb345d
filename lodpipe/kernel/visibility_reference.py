"""What is seen from outside in plain NumPy, every face against every pixel, the oracle of the kernel."""

from __future__ import annotations

from typing import Any

import numpy as np

from lodpipe.core.mesh import F32, F64, I32

NEAR = 2
PRIOR = 4


def vertex_visibility(positions: F32, faces: I32, hides: Any, views: F64, side: int) -> F64:
    """As `kernel.vertex_visibility`, for each view and its opposite one after the other."""
    met, alone, opened = np.zeros(len(faces)), np.zeros(len(faces)), np.zeros(len(positions))
    for towards in np.concatenate([views, -views]):
        x, y, z = _projected(positions, towards, side)
        shown, nearest = _picture(x[faces], y[faces], z[faces], hides, side)
        met += np.bincount(shown[shown >= 0], minlength=len(faces))
        row, column = (np.clip(np.floor(k + 0.5), 0, side - 1).astype(int) for k in (y, x))
        opened += z >= nearest[row * side + column] - NEAR * 2 / side
        (ax, bx, cx), (ay, by, cy) = x[faces].T, y[faces].T
        alone += np.abs((bx - ax) * (cy - ay) - (by - ay) * (cx - ax)) / 2 / 2  # each side from half of the views
    met[~hides] = alone[~hides]
    seen = np.bincount(faces.ravel(), np.repeat(met, 3), len(positions))
    wanted = np.bincount(faces.ravel(), np.repeat(alone, 3), len(positions))
    prior = np.where(np.bincount(faces.ravel(), np.repeat(hides, 3), len(positions)) > 0, PRIOR, 0)
    share = np.minimum((seen + prior * opened / len(views)) / np.maximum(wanted + prior, 1e-30), 1)
    spread: F64 = share.copy()
    np.maximum.at(spread, faces.ravel(), np.repeat(share[faces].max(axis=1), 3))
    return spread


def _projected(positions: F32, towards: F64, side: int) -> tuple[F64, F64, F64]:
    """Pixels to the right and up, and the distance towards the view."""
    helper = np.eye(3)[np.argmin(np.abs(towards))]
    right = np.cross(towards, helper) / np.linalg.norm(np.cross(towards, helper))
    across, up = ((positions @ axis + 1) * side / 2 - 0.5 for axis in (right, np.cross(towards, right)))
    return across, up, positions @ towards


def _picture(x: F64, y: F64, z: F64, hides: Any, side: int) -> tuple[Any, F64]:
    """Rows of the faces (F, 3 corners) that the pixels show (−1: none), and how far they are towards the view."""
    py, px = (grid.ravel() for grid in np.mgrid[:side, :side])
    nearest, shown = np.full(side * side, -np.inf), np.full(side * side, -1)
    for f in np.flatnonzero(hides):
        area = (x[f, 1] - x[f, 0]) * (y[f, 2] - y[f, 0]) - (y[f, 1] - y[f, 0]) * (x[f, 2] - x[f, 0])
        if area == 0:
            continue
        weights = [
            ((x[f, j] - x[f, i]) * (py - y[f, i]) - (y[f, j] - y[f, i]) * (px - x[f, i])) / area
            for i, j in ((1, 2), (2, 0), (0, 1))
        ]
        depth = sum(w * z[f, k] for k, w in enumerate(weights))
        nearer = (np.min(weights, axis=0) >= 0) & (depth > nearest)
        nearest[nearer], shown[nearer] = depth[nearer], f
    return shown, nearest
