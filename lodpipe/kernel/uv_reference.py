"""The kernel's functions on UV layouts in plain NumPy: slow, readable, and what the tests hold the native ones to."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from lodpipe.core.mesh import F64, I32


def chart_labels(corners: I32) -> I32:
    """See `lodpipe.kernel.layout.chart_labels`."""
    label = np.arange(len(corners))
    sides = [{frozenset((int(a), int(b))) for a, b in zip(t, np.roll(t, -1), strict=True) if a != b} for t in corners]
    for a, b in combinations(range(len(corners)), 2):
        if sides[a] & sides[b]:
            label[label == label[b]] = label[a]
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    return rank[inverse].astype(np.int32)


def common_area(a: F64, b: F64) -> float:
    """The area that two triangles (3, 2) have in common: one cut by the other's three sides."""
    if _orient(*a) == 0 or _orient(*b) == 0:
        return 0.0
    shape = list(_counter_clockwise(a))
    clip = _counter_clockwise(b)
    for p, q in zip(clip, np.roll(clip, -1, axis=0), strict=True):
        side = [_orient(p, q, point) for point in shape]
        cut = []
        for i, point in enumerate(shape):
            j = (i + 1) % len(shape)
            if side[i] >= 0:
                cut.append(point)
            if side[i] * side[j] < 0:
                cut.append(point + (shape[j] - point) * side[i] / (side[i] - side[j]))
        shape = cut
    return sum(_orient(shape[0], shape[i], shape[i + 1]) for i in range(1, len(shape) - 1)) / 2 if shape else 0.0


def gap(a: F64, b: F64) -> float:
    """The distance between two segments (2, 2) in the plane."""
    (p, q), (r, s) = a, b
    if _orient(p, q, r) * _orient(p, q, s) < 0 and _orient(r, s, p) * _orient(r, s, q) < 0:
        return 0.0
    return min(_to_segment(p, q, r)[0], _to_segment(p, q, s)[0], _to_segment(r, s, p)[0], _to_segment(r, s, q)[0])


def texel(uv: F64, edges: I32, centre: F64, reach: float) -> tuple[int, F64]:
    """The face under a texel's centre (2,), or of the nearest of `edges` within `reach`; and barycentric weights."""
    for face, (a, b, c) in enumerate(uv):
        areas = np.array([_orient(centre, b, c), _orient(centre, c, a), _orient(centre, a, b)])
        if areas.sum() != 0 and ((areas >= 0).all() or (areas <= 0).all()):
            return face, areas / areas.sum()
    best, found, weights = np.inf, -1, np.zeros(3)
    for face, side in edges:
        away, along = _to_segment(uv[face, side], uv[face, (side + 1) % 3], centre)
        if away <= reach and away < best:
            best, found, weights = away, int(face), np.zeros(3)
            weights[side], weights[(side + 1) % 3] = 1 - along, along
    return found, weights


def _orient(a: F64, b: F64, c: F64) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _counter_clockwise(triangle: F64) -> F64:
    return triangle if _orient(*triangle) >= 0 else triangle[::-1]


def _to_segment(a: F64, b: F64, point: F64) -> tuple[float, float]:
    """Distance of a point from the segment ab, and how far along the segment the nearest point lies, 0…1."""
    length = float((b - a) @ (b - a))
    along = float(np.clip((point - a) @ (b - a) / length, 0, 1)) if length > 0 else 0.0
    return float(np.linalg.norm(a + (b - a) * along - point)), along
