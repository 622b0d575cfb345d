"""Tangents for normal maps, for meshes that bring none: made in the manner of MikkTSpace."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.mesh import F32, F64, I32
from lodpipe.geometry.normals import corner_angles, unit


def corner_tangents(
    positions: F64 | F32, faces: I32, wedges: I32, uv: F32, normals: F32, rows: NDArray[np.int64] | None = None
) -> F32:
    """(F, 3, 4) float32: a unit tangent for each corner, and on which side of it the bitangent lies (±1).

    positions (V, 3), faces (F, 3) and wedges (F, 3); uv (F, 3, 2) with v = 0 at the top and normals (F, 3, 3) for each
    corner. As glTF 2.0 (3.7.2.1) asks, after Mikkelsen 2008, "Simulation of wrinkled surfaces revisited": each face's
    direction of growing u, laid into the plane of the corner's normal, weighted by the face's angle there and
    averaged over the faces that share the wedge and the direction in which their UVs run. The bitangent
    is cross(normal, tangent) times the fourth value, and points up in the image. A face without area in UV space takes
    the tangents of its neighbours, or zeros. Faces that are not in `rows` have zeros, and no say.
    """
    result = np.zeros((len(faces), 3, 4), np.float32)
    rows = np.arange(len(faces)) if rows is None else rows
    corners, at = positions[faces[rows]].astype(np.float64), uv[rows].astype(np.float64)
    normal = normals[rows].astype(np.float64)
    e, g = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    d, h = at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]
    area = d[:, 0] * h[:, 1] - h[:, 0] * d[:, 1]
    along: F64 = unit((e * h[:, 1, None] - g * d[:, 1, None]) * np.sign(area)[:, None])
    side = np.where(area > 0, -1.0, 1.0)  # v points down
    flat = unit(along[:, None] - np.einsum("fkd,fd->fk", normal, along)[:, :, None] * normal)
    flat *= corner_angles(positions, faces[rows])[:, :, None]
    owner = (wedges[rows].astype(np.int64) * 2 + (side > 0)[:, None]).ravel()
    count = int(wedges.max(initial=-1)) + 1
    sums: F64 = np.stack([np.bincount(owner, flat[:, :, k].ravel(), minlength=2 * count) for k in range(3)], axis=1)
    result[rows, :, :3] = unit(sums[owner]).reshape(-1, 3, 3)
    result[rows, :, 3] = side[:, None]
    return result
