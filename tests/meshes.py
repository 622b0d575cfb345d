"""Tiny named meshes that tests draw on, as (positions (V, 3) float64, faces (F, 3) int32)."""

from __future__ import annotations

import numpy as np


def grid(n: int = 1, height: float = 0.0):
    """The unit square in z = `height`, n × n cells of two triangles, seen from above."""
    step = np.linspace(0.0, 1.0, n + 1)
    x, y = np.meshgrid(step, step, indexing="ij")
    at = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (v.ravel() for v in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, height)], axis=1), faces.astype(np.int32)


def box(size: float = 1.0):
    """A cube about the origin, 8 corners and 12 triangles."""
    corners = np.array([[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)]) * size
    quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    faces = [[q[0], q[i], q[i + 1]] for q in quads for i in (1, 2)]
    return corners, np.array(faces, np.int32)


def sphere(divisions: int = 3, radius: float = 1.0):
    """An octahedron, each triangle divided in four `divisions` times, pushed out onto the sphere."""
    points = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    for _ in range(divisions):
        ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        edges, row = np.unique(ends, axis=0, return_inverse=True)
        ab, bc, ca = (row.reshape(3, -1) + len(points)).reshape(3, -1)
        points = np.concatenate([points, points[edges].mean(axis=1)])
        a, b, c = faces.T
        faces = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
        points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points * radius, faces.astype(np.int32)
