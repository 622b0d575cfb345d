"""Normals made from the triangles, for meshes that bring none."""

from __future__ import annotations

import numpy as np

from lodpipe.core.mesh import F32, F64, I32


def unit(vectors: F64) -> F64:
    """`vectors` (…, 3) at unit length; zero where they have none."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0, length, 1.0)


def face_normals(positions: F64 | F32, faces: I32) -> F64:
    """Unit normal (F, 3) float64 of each face, zero for a face without area."""
    a, b, c = (positions[faces[:, k]].astype(np.float64) for k in range(3))
    return unit(np.cross(b - a, c - a))


def crease_normals(positions: F64 | F32, faces: I32, angle: float = 60.0) -> F32:
    """(F, 3, 3) float32: a unit normal for each corner of each face; it may be zero where a face has no area.

    A corner's normal is the mean of the faces around its vertex that are turned from its own face by at most `angle`
    degrees, each weighted by its angle at the vertex (Thürmer & Wüthrich 1998), so that smooth parts are smooth
    and edges sharp.
    """
    flat = face_normals(positions, faces)
    weight = corner_angles(positions, faces)
    owner = faces.ravel()
    around = np.empty((len(positions), 3))
    for axis in range(3):
        shares = weight * flat[:, axis, None]
        around[:, axis] = np.bincount(owner, shares.ravel(), minlength=len(positions))
    mean = unit(around)
    normals = mean[faces]
    # a vertex whose faces are all within half the angle of their mean has no two faces that are farther apart
    spread = np.einsum("fkd,fd->fk", normals, flat) < np.cos(np.radians(angle / 2))
    creased = np.zeros(len(positions), bool)
    creased[faces[spread]] = True
    rows = np.flatnonzero(creased[owner]).astype(np.int32)
    if len(rows):
        normals.reshape(-1, 3)[rows] = _means_within(flat, weight.ravel(), owner, rows, np.cos(np.radians(angle)))
    return normals.astype(np.float32)


def _means_within(flat: F64, weight: F64, owner: I32, rows: I32, least: float) -> F64:
    """The normals of the corners `rows` (N,), ascending: each from the corners at its vertex whose faces' normals
    have a cosine of `least` or more with its own."""
    rows = rows[np.argsort(owner[rows], kind="stable")]
    _, first, count = np.unique(owner[rows], return_index=True, return_counts=True)
    degree = np.repeat(count, count)
    own = np.repeat(np.arange(len(rows)), degree)
    # the partner of the i-th pair of a corner is the i-th corner of its vertex
    start = np.repeat(np.repeat(first, count), degree)
    partner = start + np.arange(len(own)) - np.repeat(np.cumsum(degree) - degree, degree)
    mine, other = flat[rows[own] // 3], flat[rows[partner] // 3]
    near = np.einsum("nd,nd->n", mine, other) >= least - 1e-9
    share = np.where(near, weight[rows[partner]], 0.0)
    sums = np.empty((len(rows), 3))
    for axis in range(3):
        sums[:, axis] = np.bincount(own, share * other[:, axis], minlength=len(rows))
    return unit(sums)[np.argsort(rows)]  # back in ascending order of corners


def corner_angles(positions: F64 | F32, faces: I32) -> F64:
    """(F, 3) float64: the angle of each face at each of its corners, in radians."""
    corners = positions[faces].astype(np.float64)
    forward = unit(np.roll(corners, -1, axis=1) - corners)
    back = unit(np.roll(corners, 1, axis=1) - corners)
    angles: F64 = np.arccos(np.clip(np.einsum("fkd,fkd->fk", forward, back), -1.0, 1.0))
    return angles
