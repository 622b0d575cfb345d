"""What tests measure on meshes: small functions of arrays, independent of the code under test."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components


def edges(faces):
    """The distinct edges (E, 2), lower end first, and how many faces have each."""
    ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return np.unique(ends, axis=0, return_counts=True)


def euler(faces) -> int:
    """Vertices − edges + faces, of what the faces use."""
    return len(np.unique(faces)) - len(edges(faces)[0]) + len(faces)


def open_edges(faces) -> int:
    return int((edges(faces)[1] == 1).sum())


def components(faces) -> int:
    """Parts that share no vertex."""
    if not len(faces):
        return 0
    used, rows = np.unique(faces, return_inverse=True)
    a, b, c = rows.reshape(-1, 3).T
    ends = np.concatenate([a, b]), np.concatenate([b, c])
    graph = coo_matrix((np.ones(len(ends[0])), ends), (len(used), len(used)))
    return int(connected_components(graph, directed=False)[0])


def welded(positions, faces):
    """Faces in which corners at the very same place have the same number."""
    return np.unique(positions, axis=0, return_inverse=True)[1].reshape(-1)[faces]


def areas(positions, faces):
    a, b, c = (positions[faces[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def volume(positions, faces) -> float:
    a, b, c = (positions[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def spread(positions, faces, count: int = 20_000, seed: int = 0):
    """`count` random points on the surface, evenly by area."""
    rng = np.random.default_rng(seed)
    area = areas(positions, faces)
    corners = positions[faces[rng.choice(len(faces), count, p=area / area.sum())]]
    r, s = np.sqrt(rng.random((2, count, 1)))
    s = s**2
    return (1 - r) * corners[:, 0] + r * (1 - s) * corners[:, 1] + r * s * corners[:, 2]
