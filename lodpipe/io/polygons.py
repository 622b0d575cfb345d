"""Polygons into triangles."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.mesh import F64
from lodpipe.io.clean import Warn, count_faces

#: Ear clipping takes time in the square of the corners; a concave polygon beyond this is cut as if it were convex.
MAX_EARS = 2000


def usable(counts: NDArray[Any], corners: NDArray[Any], rows: int, place: str, warn: Warn) -> NDArray[np.bool_]:
    """Which polygons have at least three corners, all within `rows`; the others are counted in a warning.

    counts   (P,) corners of each polygon
    corners  (sum of counts,) the vertex of each corner
    """
    good = counts >= 3
    short = int((~good).sum())
    if short:
        warn(f"{place}: {count_faces(short)} with fewer than three corners left out")
    outside = (corners < 0) | (corners >= rows)
    if outside.any():
        polygon = np.repeat(np.arange(len(counts)), counts)
        bad = np.zeros(len(counts), bool)
        bad[polygon[outside]] = True
        bad &= good
        good &= ~bad
        if bad.any():
            warn(f"{place}: {count_faces(int(bad.sum()))} with an index out of range left out")
    return good


def triangulate(counts: NDArray[Any], points: F64, place: str, warn: Warn) -> tuple[NDArray[Any], NDArray[Any]]:
    """Triangles of polygons: (F, 3) rows of `points`, and (F,) the polygon of each, ascending.

    counts  (P,) corners of each polygon, ≥ 3
    points  (sum of counts, 3) the position of each corner, polygon after polygon

    Convex polygons become fans; from seven corners on every other corner is cut off, again and again, so that none has
    very many triangles. A concave quadrilateral is cut at its reflex corner, other concave ones have their ears
    clipped.
    """
    begin = np.cumsum(counts) - counts
    if (counts == 3).all():
        return np.arange(len(points)).reshape(-1, 3), np.arange(len(counts))
    faces, owners = [], []
    for size in np.unique(counts):
        chosen = np.flatnonzero(counts == size)
        corner = begin[chosen, None] + np.arange(size)
        if size == 3:
            local = corner[:, None, :]
        else:
            with np.errstate(invalid="ignore", over="ignore"):
                local = _cut(corner, points, place, warn)
        faces.append(local.reshape(-1, 3))
        owners.append(np.repeat(chosen, size - 2))
    owner = np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return np.concatenate(faces)[order], owner[order]


def _cut(corner: NDArray[Any], points: F64, place: str, warn: Warn) -> NDArray[Any]:
    """Triangles (P, N − 2, 3) of P polygons of N corners each, `corner` (P, N)."""
    size = corner.shape[1]
    result = corner[:, _convex(size)]
    shape = points[corner] - points[corner[:, :1]]
    extent = np.abs(shape).max(axis=(1, 2), initial=0.0)
    shape /= np.where(extent > 0, extent, 1.0)[:, None, None]
    after = np.roll(shape, -1, axis=1)
    normal = np.cross(shape, after).sum(axis=1)  # Newell: twice the vector area
    turn = np.einsum("pnk,pk->pn", np.cross(shape - np.roll(shape, 1, axis=1), after - shape), normal)
    reflex = turn < -1e-12
    if size == 4:
        odd = reflex[:, 1] | reflex[:, 3]
        result[odd] = corner[odd][:, np.array([[1, 2, 3], [1, 3, 0]])]
        return result
    for polygon in np.flatnonzero(reflex.any(axis=1)).tolist():
        if size > MAX_EARS:
            warn(f"{place}: a concave face of {size:,} corners is cut as if it were convex")
            continue
        result[polygon] = corner[polygon][_ears(_flatten(shape[polygon], normal[polygon]))]
    return result


def _convex(size: int) -> NDArray[Any]:
    """Triangles (N − 2, 3) of a convex polygon of N corners."""
    ring = np.arange(size)
    rows = []
    while len(ring) > 6:
        cut = ring[1:-1:2] if len(ring) % 2 else ring[1::2]
        before = ring[: 2 * len(cut) : 2]
        rows.append(np.stack([before, cut, np.roll(ring, -2)[: 2 * len(cut) : 2]], axis=1))
        ring = np.setdiff1d(ring, cut)
    last = len(ring)
    rows.append(ring[np.stack([np.zeros(last - 2, int), np.arange(1, last - 1), np.arange(2, last)], axis=1)])
    return np.concatenate(rows)


def _flatten(shape: F64, normal: F64) -> F64:
    """The polygon (N, 3) seen along its normal, counter-clockwise, (N, 2)."""
    axis = int(np.abs(normal).argmax())
    u, v = (axis + 1) % 3, (axis + 2) % 3
    return shape[:, [u, v]] if normal[axis] > 0 else shape[:, [v, u]]


def _ears(flat: F64) -> NDArray[Any]:
    """Ear clipping of a simple polygon (N, 2), counter-clockwise -> (N − 2, 3) rows of it.

    Where no ear is left (the polygon crosses itself) the next corner is cut off all the same.
    """
    left = list(range(len(flat)))
    triangles = []
    at = 0
    misses = 0
    while len(left) > 3:
        n = len(left)
        a, b, c = left[(at - 1) % n], left[at % n], left[(at + 1) % n]
        if misses > n or _is_ear(flat, a, b, c, left):
            triangles.append((a, b, c))
            del left[at % n]
            at = max(at % n - 1, 0)
            misses = 0
        else:
            at = (at + 1) % n
            misses += 1
    triangles.append((left[0], left[1], left[2]))
    return np.array(triangles)


def _is_ear(flat: F64, a: int, b: int, c: int, left: list[int]) -> bool:
    if _side(flat[a], flat[b], flat[c]) <= 0:
        return False
    others = flat[[i for i in left if i not in (a, b, c)]]
    inside = (
        (_side(flat[a], flat[b], others) >= 0)
        & (_side(flat[b], flat[c], others) >= 0)
        & (_side(flat[c], flat[a], others) >= 0)
    )
    return not bool(inside.any())


def _side(a: F64, b: F64, p: F64) -> Any:
    """Twice the signed area of the triangle a, b, p (p may be many): positive where p lies left of a → b."""
    return (b[0] - a[0]) * (p[..., 1] - a[1]) - (b[1] - a[1]) * (p[..., 0] - a[0])
