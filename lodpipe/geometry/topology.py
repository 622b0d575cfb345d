"""How a mesh hangs together: edges, connected parts, and what is wrong with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.mesh import F64, I32, Mesh

FLAT = 1e-12
"""A triangle whose doubled area is at most this share of its longest edge's square has no area worth the name."""


@dataclass(frozen=True)
class TopologyDefects:
    """Counts for one mesh, over its positions (seams in UVs or normals are not borders)."""

    components: int
    """Parts that share no position."""
    boundary_edges: int
    """Edges of one face."""
    nonmanifold_edges: int
    """Edges of three faces or more."""
    inconsistent_winding: int
    """Edges whose two faces run through them in the same direction: one of the two is inside out."""
    degenerate_faces: int
    """Faces without area."""
    duplicate_faces: int
    """Faces with the same three corners as an earlier one, whichever way round."""
    unused_positions: int
    """Positions that no face uses."""


def topology_defects(mesh: Mesh) -> TopologyDefects:
    """Count the defects of `mesh`'s connectivity."""
    faces = mesh.faces
    used = np.zeros(len(mesh.positions), bool)
    used[faces] = True
    labels = components(faces, len(mesh.positions))
    distinct = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    corners = np.sort(distinct, axis=1)
    sorted_corners = corners[np.lexsort(corners.T)]
    half = np.concatenate([distinct[:, [0, 1]], distinct[:, [1, 2]], distinct[:, [2, 0]]]).astype(np.int64)
    edge = half.min(axis=1) * len(mesh.positions) + half.max(axis=1)
    order = np.argsort(edge, kind="stable")
    forward = (half[:, 0] < half[:, 1])[order]
    _, first, count = np.unique(edge[order], return_index=True, return_counts=True)
    pairs = first[count == 2]
    return TopologyDefects(
        components=len(np.unique(labels[used])),
        boundary_edges=int((count == 1).sum()),
        nonmanifold_edges=int((count > 2).sum()),
        inconsistent_winding=int((forward[pairs] == forward[pairs + 1]).sum()) if len(pairs) else 0,
        degenerate_faces=int(without_area(mesh).sum()),
        duplicate_faces=int((sorted_corners[1:] == sorted_corners[:-1]).all(axis=1).sum()),
        unused_positions=int((~used).sum()),
    )


def components(faces: I32, count: int) -> I32:
    """Connected parts of (F, 3) int32 `faces` over `count` positions: (count,) int32 labels.

    A part's label is the lowest position in it; a position without a face is a part of its own.
    """
    labels = np.arange(count, dtype=np.int32)
    while len(faces):
        lowest = labels[faces].min(axis=1)
        joined = labels.copy()
        np.minimum.at(joined, labels[faces].ravel(), np.repeat(lowest, 3))  # whole parts at once, by their labels
        while True:
            jumped = joined[joined]
            if np.array_equal(jumped, joined):
                break
            joined = jumped
        if np.array_equal(joined, labels):
            break
        labels = joined
    return labels


def without_area(mesh: Mesh) -> NDArray[np.bool_]:
    """(F,) which faces have no area, whatever the mesh's size."""
    corners = [mesh.positions[mesh.faces[:, k]] for k in range(3)]
    a, b = corners[1] - corners[0], corners[2] - corners[0]
    largest = np.maximum(np.abs(a).max(axis=1, initial=0), np.abs(b).max(axis=1, initial=0))[:, None]
    scale = np.where(largest > 0, largest, 1.0)  # so that squares neither overflow nor vanish
    a, b = a / scale, b / scale
    return _flat(np.sqrt((np.cross(a, b) ** 2).sum(axis=1)), a, b)


def flat_faces(uv: F64) -> NDArray[np.bool_]:
    """(F,) which triangles (F, 3, 2) have no area in the plane."""
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    return _flat(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), a, b)


def _flat(doubled_area: F64, a: F64, b: F64) -> NDArray[np.bool_]:
    """Whether triangles with the edges `a` and `b` are flat."""
    longest = np.maximum(np.maximum((a**2).sum(axis=1), (b**2).sum(axis=1)), ((a - b) ** 2).sum(axis=1))
    flat: NDArray[np.bool_] = doubled_area <= FLAT * longest
    return flat
