"""Shapes as distance functions, and closed meshes of them.

A field maps points (N, 3) to values (N,), negative inside.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Field = Callable[[F64], F64]


def ellipsoid(centre: Sequence[float], radii: Sequence[float]) -> Field:
    """About the distance to an ellipsoid along the axes."""
    c, r = np.array(centre), np.array(radii)

    def field(p: F64) -> F64:
        scaled = np.linalg.norm((p - c) / r, axis=1)
        steep = np.linalg.norm((p - c) / r**2, axis=1)
        value: F64 = scaled * (scaled - 1) / np.maximum(steep, 1e-9)
        return value

    return field


def capsule(a: Sequence[float], b: Sequence[float], radius: float, end_radius: float | None = None) -> Field:
    """The distance to a rod from `a` to `b`, which may grow thinner or thicker towards `b`."""
    start, along = np.array(a), np.array(b) - np.array(a)
    change = 0.0 if end_radius is None else end_radius - radius

    def field(p: F64) -> F64:
        t = np.clip((p - start) @ along / (along @ along), 0, 1)
        value: F64 = np.linalg.norm(p - start - t[:, None] * along, axis=1) - radius - change * t
        return value

    return field


def cylinder(centre: Sequence[float], axis: int, half: float, radius: float, rounding: float) -> Field:
    """The distance to a rounded cylinder along coordinate `axis`."""
    c = np.array(centre)
    others = [k for k in range(3) if k != axis]

    def field(p: F64) -> F64:
        outward = np.linalg.norm((p - c)[:, others], axis=1) - radius + rounding
        along = np.abs((p - c)[:, axis]) - half + rounding
        beyond = np.hypot(np.maximum(outward, 0), np.maximum(along, 0))
        value: F64 = np.minimum(np.maximum(outward, along), 0) + beyond - rounding
        return value

    return field


def turned(field: Field, centre: Sequence[float], degrees: Sequence[float]) -> Field:
    """`field` turned about `centre` by angles about x, then y, then z."""
    c = np.array(centre)
    rotation = np.eye(3)
    for axis, angle in enumerate(np.radians(degrees)):
        step = np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        step[i, i] = step[j, j] = np.cos(angle)
        step[j, i], step[i, j] = np.sin(angle), -np.sin(angle)
        rotation = step @ rotation
    return lambda p: field((p - c) @ rotation + c)


def union(fields: Sequence[Field], blend: float) -> Field:
    """All of `fields`, their joints rounded within the distance `blend` (polynomial smooth minimum)."""

    def field(p: F64) -> F64:
        value = fields[0](p)
        for other in fields[1:]:
            second = other(p)
            h = np.maximum(blend - np.abs(value - second), 0) / blend
            value = np.minimum(value, second) - h * h * blend / 4
        return value

    return field


def without(field: Field, cut: Field, blend: float) -> Field:
    """`field` less `cut`, the edge rounded within `blend`."""
    rest = union([lambda p: -field(p), cut], blend)
    return lambda p: -rest(p)


def polygonise(field: Field, planes: Sequence[F64], relax: int = 6) -> tuple[F64, NDArray[np.int32]]:
    """A mesh (positions (V, 3), faces (F, 3)) of the surface, by surface nets on a grid with the given planes.

    One vertex for each cell that the surface passes (Gibson 1998), one quad for each grid edge that it crosses; then
    `relax` rounds of smoothing, each followed by a step back onto the surface. The planes of each axis may be spaced
    unevenly: the finer, the smaller the triangles. Closed if the surface stays inside the grid.
    """
    shape = tuple(len(axis) for axis in planes)
    nodes = np.stack(np.meshgrid(*planes, indexing="ij"), axis=-1)
    value = field(nodes.reshape(-1, 3)).reshape(shape)
    cell, points = _cell_vertices(nodes, value)
    quads = np.concatenate([_quads(value, cell, axis) for axis in range(3)])
    edges = np.unique(np.sort(np.concatenate([quads[:, [k, (k + 1) % 4]] for k in range(4)]), axis=1), axis=0)
    degree = np.bincount(edges.ravel(), minlength=len(points))[:, None]
    for _ in range(relax):
        mean = np.zeros_like(points)
        for here, there in (edges.T, edges[:, ::-1].T):
            np.add.at(mean, here, points[there])
        points = project(field, points + 0.5 * (mean / degree - points), rounds=1)
    points = project(field, points)
    return points, _triangles(points, quads).astype(np.int32)


def project(field: Field, points: F64, rounds: int = 3) -> F64:
    """`points` moved onto the surface along the field's gradient (Newton's method)."""
    step = 1e-5
    for _ in range(rounds):
        slope = np.stack([(field(points + s) - field(points - s)) / (2 * step) for s in np.eye(3) * step], axis=1)
        steep = np.maximum((slope * slope).sum(axis=1), 1e-6)
        points = points - np.clip(field(points) / steep, -0.02, 0.02)[:, None] * slope
    return points


def _cell_vertices(nodes: F64, value: F64) -> tuple[I64, F64]:
    """The number of each cell's vertex (−1: none), and the vertices: the mean of where the cell's edges are crossed."""
    cells = tuple(n - 1 for n in value.shape)
    total, count = np.zeros((*cells, 3)), np.zeros(cells)

    def corner(array: F64, offset: Sequence[int]) -> F64:
        return array[tuple(slice(o, o + n) for o, n in zip(offset, cells, strict=True))]

    for axis in range(3):
        for shift in np.ndindex(2, 2):
            low = [*shift[:axis], 0, *shift[axis:]]
            high = [*shift[:axis], 1, *shift[axis:]]
            a, b = corner(value, low), corner(value, high)
            crossed = (a < 0) != (b < 0)
            t = np.where(crossed, a / np.where(crossed, a - b, 1), 0)[..., None]
            place = corner(nodes, low) * (1 - t) + corner(nodes, high) * t
            total += np.where(crossed[..., None], place, 0)
            count += crossed
    used = count > 0
    number = np.full(cells, -1)
    number[used] = np.arange(used.sum())
    return number, total[used] / count[used][:, None]


def _quads(value: F64, cell: I64, axis: int) -> I64:
    """The four cells around each crossed grid edge along `axis`, counter-clockwise from outside."""
    v, c = (np.moveaxis(array, axis, 0) for array in (value, cell))
    a, b = v[:-1, 1:-1, 1:-1], v[1:, 1:-1, 1:-1]
    at = np.nonzero((a < 0) != (b < 0))
    i, j, k = at
    ring = np.stack([c[i, j, k], c[i, j + 1, k], c[i, j + 1, k + 1], c[i, j, k + 1]], axis=1)
    # the two other axes, in ascending order, are right-handed about x and z, left-handed about y
    forward = (a[at] < 0) == (axis != 1)
    return np.where(forward[:, None], ring, ring[:, ::-1])


def _triangles(points: F64, quads: I64) -> I64:
    """Each quad cut along its shorter diagonal."""
    p = points[quads]
    first = np.linalg.norm(p[:, 0] - p[:, 2], axis=1) <= np.linalg.norm(p[:, 1] - p[:, 3], axis=1)
    q = np.where(first[:, None], quads, np.roll(quads, -1, axis=1))
    return np.concatenate([q[:, [0, 1, 2]], q[:, [0, 2, 3]]])
