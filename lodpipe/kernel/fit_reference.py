"""The fit of a level to its source in plain NumPy: slow, readable, the oracle of `kernel.fit`.

Samples go to the nearest face of the whole level, by brute force, and the systems are solved densely. On meshes of one
smooth chart that is what the native code does by walking and by conjugate gradients.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from lodpipe.core.mesh import F32, F64, I32
from lodpipe.kernel import Level

PRIOR = 0.02
TANGENTIAL = 0.05
EXACT = 1e-4


def samples(positions: F64, faces: I32, count: int) -> tuple[Any, F64, F64]:
    """Faces (N,), barycentric weights (N, 3) and the areas (N,) that the samples stand for.

    Fewer than faces: equal shares of the summed area, at places of the R2 sequence (Roberts 2018). More: in each face
    its middle, the three points that integrate squares exactly, or twelve of the sequence, by its share of the area.
    """
    corners = positions[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    total = np.concatenate([[0], np.cumsum(area)])
    wanted = area * count / total[-1]
    if count < len(faces):
        points = np.diff(np.floor(total * count / total[-1] + 0.5)).astype(int)
    else:
        points = np.select([wanted <= 0, wanted < 4, wanted < 48], [0, 1, 3], 12)
    face = np.repeat(np.arange(len(faces)), points)
    i = np.arange(len(face))
    r, s = (0.5 + 0.7548776662466927 * i) % 1, (0.5 + 0.5698402909980532 * i) % 1
    over = r + s > 1
    r, s = np.where(over, 1 - r, r), np.where(over, 1 - s, s)
    weights = np.column_stack([1 - r - s, r, s])
    if count < len(faces):
        return face, weights, np.full(len(face), total[-1] / count)
    number = i - np.repeat(np.cumsum(points) - points, points)
    weights[points[face] == 1] = 1 / 3
    three = points[face] == 3
    weights[three] = np.eye(3)[number[three]] / 2 + 1 / 6
    return face, weights, area[face] / points[face]


def nearest(points: F64, normals: F64, positions: F64, faces: I32) -> tuple[Any, F64]:
    """The nearest of the faces that look the same way, and barycentric weights there; −1 where there is none."""
    best = np.full(len(points), np.inf)
    face, weights = np.full(len(points), -1), np.zeros((len(points), 3))
    for number, (a, b, c) in enumerate(positions[faces]):
        across = np.cross(b - a, c - a)
        inside = _plane_weights(points, a, b, c, across)
        found = [np.where(inside.min(axis=1, keepdims=True) >= 0, inside, np.nan)]
        for k, (p, q) in enumerate(((a, b), (b, c), (c, a))):
            along = np.clip((points - p) @ (q - p) / max(float((q - p) @ (q - p)), 1e-300), 0, 1)
            edge = np.zeros((len(points), 3))
            edge[:, k], edge[:, (k + 1) % 3] = 1 - along, along
            found.append(edge)
        for w in found:
            gap = np.linalg.norm(points - w @ np.array([a, b, c]), axis=1)
            nearer = (gap < best) & (normals @ across > 0)
            best[nearer], face[nearer], weights[nearer] = gap[nearer], number, w[nearer]
    return face, weights


def _plane_weights(points: F64, a: F64, b: F64, c: F64, across: F64) -> F64:
    size = max(float(across @ across), 1e-300)
    v = np.cross(points - a, c - a) @ across / size
    w = np.cross(b - a, points - a) @ across / size
    return np.column_stack([1 - v - w, v, w])


def fit(positions: F64, faces: I32, wedges: I32, values: F32, level: Level, count: int, moves: int) -> Level:
    """As `kernel.fit`, for columns that are not tied and without charts' borders."""
    low, high = positions[faces].min(axis=(0, 1)), positions[faces].max(axis=(0, 1))
    scale, centre = 1 / np.linalg.norm(high - low), (low + high) / 2
    source, at = (positions - centre) * scale, (level.positions - centre) * scale
    face, a, share = samples(source, faces, count)
    points = np.einsum("nk,nkd->nd", a, source[faces[face]])
    corners = source[faces[face]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for _ in range(moves):
        hit, b = nearest(points, normals, at, level.faces)
        matrix, right = np.zeros((len(at) * 3,) * 2), np.zeros(len(at) * 3)
        for n in np.flatnonzero(hit >= 0):
            v = level.faces[hit[n]]
            metric = np.outer(normals[n], normals[n]) + TANGENTIAL * np.eye(3)
            rows = (3 * v[:, None] + np.arange(3)).ravel()
            matrix[np.ix_(rows, rows)] += share[n] * np.kron(np.outer(b[n], b[n]), metric)
            right[rows] += share[n] * np.kron(b[n], metric @ (points[n] - b[n] @ at[v]))
        for v, m in zip(level.faces, _masses(at, level.faces), strict=True):
            rows = (3 * v[:, None] + np.arange(3)).ravel()
            matrix[np.ix_(rows, rows)] += PRIOR * np.kron(m, np.eye(3))
        at = at + np.linalg.solve(matrix, right).reshape(-1, 3)
    hit, b = nearest(points, normals, at, level.faces)
    mass, pull = np.zeros((len(level.values),) * 2), np.zeros(level.values.shape)
    for n in np.flatnonzero(hit >= 0):
        w = level.wedges[hit[n]]
        mass[np.ix_(w, w)] += share[n] * np.outer(b[n], b[n])
        off = a[n] @ values[wedges[face[n]]].astype(float) - b[n] @ level.values[w].astype(float)
        pull[w] += share[n] * np.outer(b[n], off)
    for w, m in zip(level.wedges, _masses(at, level.faces), strict=True):
        mass[np.ix_(w, w)] += PRIOR * m
    fitted = level.values + np.linalg.solve(mass, pull)
    squares = np.zeros((2, *fitted.shape))  # of what is off round each wedge, before and after
    for n in np.flatnonzero(hit >= 0):
        w, wanted = level.wedges[hit[n]], a[n] @ values[wedges[face[n]]].astype(float)
        for square, shown in zip(squares, (level.values, fitted), strict=True):
            square[w] += share[n] * (wanted - b[n] @ shown[w]) ** 2
    pays = (squares[1] < squares[0]) & (squares[0] >= EXACT**2 * share.mean())
    fitted = np.where(pays, fitted, level.values)
    return replace(level, positions=at / scale + centre, values=fitted.astype(np.float32))


def _masses(positions: F64, faces: I32) -> F64:
    """(F, 3, 3): the integral of products of two corners' barycentric weights over each face."""
    corners = positions[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    masses: F64 = area[:, None, None] / 12 * (np.ones((3, 3)) + np.eye(3))
    return masses
