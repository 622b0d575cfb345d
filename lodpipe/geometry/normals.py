"""Normals made from the triangles, for meshes that bring none."""

from __future__ import annotations

import numpy as np

from lodpipe.core.mesh import F32, F64, I32
from lodpipe.kernel import surfaces


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
    return surfaces.crease_normals(positions.astype(np.float64, copy=False), faces, angle)


def corner_angles(positions: F64 | F32, faces: I32) -> F64:
    """(F, 3) float64: the angle of each face at each of its corners, in radians."""
    corners = positions[faces].astype(np.float64)
    forward = unit(np.roll(corners, -1, axis=1) - corners)
    back = unit(np.roll(corners, 1, axis=1) - corners)
    angles: F64 = np.arccos(np.clip(np.einsum("fkd,fkd->fk", forward, back), -1.0, 1.0))
    return angles
