"""A surface made ready for skeletons: welded, scaled to a box of unit diagonal, with its edges and components."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.asset import Asset
from lodpipe.core.mesh import F64, I32
from lodpipe.geometry.flatten import flatten_once

I64 = NDArray[np.int64]
Bool = NDArray[np.bool_]


ROUNDS_PER_VERTEX, MOST_ROUNDS = 3e-4, 30
"""Rounds of smoothing before lengths are measured: they reach about 1 % of the diagonal far on most models."""
ROUGH = 0.7
"""A surface is rough if smoothing makes its edges shorter than this share of what they were."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles of a whole asset in which coincident positions are one vertex.

    points     (V, 3) float64, from 0 and in a box of unit diagonal; world = points · scale + origin
    faces      (F, 3) int32 without faces of two equal corners, and each triangle once
    origin     (3,) float64
    scale      world units of a unit here, > 0
    vertex     for each of the asset's meshes (V,) int32: the row of `points`, −1 for positions that no face uses

    A vertex at which several fans of faces touch is split, so that only edges hold the surface together; the asset's
    vertex then stands for the first of them. Holes are closed by a fan of faces about a further vertex.
    """

    points: F64
    faces: I32
    origin: F64
    scale: float
    vertex: tuple[I32, ...]
    holes: tuple[int, ...] = ()
    """Rows of the vertices that close holes."""

    @staticmethod
    def of(asset: Asset) -> Surface:
        """The surface of `asset.meshes`, each in the largest of its placements."""
        soup = flatten_once(asset)
        low, _ = soup.bounds
        scale = soup.diagonal or 1.0
        used = soup.used
        placed = (soup.positions[used] - low) / scale + 0.0  # + 0.0: no negative zeros
        points, row = _welded(placed)
        rows = np.full(len(soup.positions), -1, np.int32)
        rows[used] = row
        faces = _distinct(rows[soup.faces], len(points))
        kept = np.zeros(len(points) + 1, bool)  # one more for −1
        kept[faces] = True
        rank = np.where(kept, np.cumsum(kept) - 1, -1).astype(np.int32)
        points, faces, rows = points[kept[:-1]], rank[faces], rank[rows]
        counts = np.cumsum([0] + [len(part.mesh.positions) for part in soup.parts])
        vertex = [np.full(len(mesh.positions), -1, np.int32) for mesh in asset.meshes]
        drawn = [index for index, mesh in enumerate(asset.meshes) if len(mesh.faces)]
        for index, start, end in zip(drawn, counts, counts[1:], strict=False):
            vertex[index] = rows[start:end]
        return Surface(points, faces, low, scale, tuple(vertex))._split()._closed()

    @cached_property
    def _halves(self) -> tuple[I64, I32, I64]:
        """Keys of the edges in ascending order, their face, and where each edge begins in the two."""
        f = self.faces.astype(np.int64)
        ends = np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]])
        key = ends.min(axis=1) * max(len(self.points), 1) + ends.max(axis=1)
        order = np.argsort(key, kind="stable")
        key = key[order]
        first = np.flatnonzero(np.diff(key, prepend=-1))
        return key[first], (order % max(len(f), 1)).astype(np.int32), first

    @cached_property
    def edges(self) -> I32:
        """(E, 2) int32."""
        key = self._halves[0]
        return np.stack(np.divmod(key, max(len(self.points), 1)), axis=1).astype(np.int32)

    @cached_property
    def edge_faces(self) -> I64:
        """(E,) how many faces each edge has."""
        return np.diff(self._halves[2], append=3 * len(self.faces))

    @cached_property
    def adjacent(self) -> tuple[I64, I32, I32]:
        """Pairs of faces that share an edge: the edge, and the two faces. k faces at one edge make k − 1 pairs."""
        _, face, first = self._halves
        edge = np.repeat(np.arange(len(first)), self.edge_faces)
        same = np.flatnonzero(edge[1:] == edge[:-1])
        return edge[same], face[same], face[same + 1]

    @cached_property
    def lengths(self) -> F64:
        """(E,) float64 > 0; of a rough surface those of a smoothed one, since noise lengthens every path."""
        plain = self._lengths(self.points)
        rounds = min(int(len(self.points) * ROUNDS_PER_VERTEX), MOST_ROUNDS)
        if rounds:
            smooth = self._lengths(self._smoothed(rounds))
            if smooth.mean() < ROUGH * plain.mean():
                return smooth
        return plain

    def _smoothed(self, rounds: int) -> F64:
        """The points moved half-way to the mean of their neighbours, `rounds` times."""
        from scipy.sparse import csr_array

        points = self.points
        a, b = self.edges.T
        ends = np.concatenate([a, b]), np.concatenate([b, a])
        share = 1.0 / np.maximum(np.bincount(ends[0], minlength=len(points)), 1)
        mean = csr_array((share[ends[0]], ends), shape=(len(points),) * 2)
        for _ in range(rounds):
            points = (points + mean @ points) / 2
        return points

    def _lengths(self, points: F64) -> F64:
        step = points[self.edges[:, 0]] - points[self.edges[:, 1]]
        lengths: F64 = np.maximum(np.sqrt(np.einsum("ij,ij->i", step, step)), 1e-12)
        return lengths

    @cached_property
    def graph(self) -> Any:
        """The edges with their lengths as a symmetric sparse matrix (V, V)."""
        from scipy.sparse import csr_array

        a, b = self.edges.T
        ends = np.concatenate([a, b]), np.concatenate([b, a])
        return csr_array((np.concatenate([self.lengths, self.lengths]), ends), shape=(len(self.points),) * 2)

    @cached_property
    def component(self) -> I32:
        """(V,) int32: connected components, numbered in the order of their first vertex."""
        from scipy.sparse.csgraph import connected_components

        label = connected_components(self.graph, directed=False)[1]
        _, first = np.unique(label, return_index=True)
        rank = np.empty(len(first), np.int32)
        rank[np.argsort(first)] = np.arange(len(first), dtype=np.int32)
        return np.asarray(rank[label], np.int32)

    def normals(self, rows: I64) -> F64:
        """(N, 3) unit normals of some of the vertices, by area; zero where faces cancel out."""
        wanted = np.zeros(len(self.points), bool)
        wanted[rows] = True
        faces = self.faces[wanted[self.faces].any(axis=1)]
        corner = self.points[faces]
        across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]).repeat(3, axis=0)
        count = len(self.points)
        normals = np.stack([np.bincount(faces.ravel(), across[:, k], count)[rows] for k in range(3)], axis=1)
        return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))

    @property
    def component_count(self) -> int:
        """Number of components."""
        return int(self.component.max(initial=-1)) + 1

    @cached_property
    def diagonals(self) -> F64:
        """(C,) diagonal of each component's bounding box, of the whole's."""
        low = np.full((self.component_count, 3), np.inf)
        high = np.full((self.component_count, 3), -np.inf)
        np.minimum.at(low, self.component, self.points)
        np.maximum.at(high, self.component, self.points)
        diagonals: F64 = np.linalg.norm(high - low, axis=1)
        return diagonals

    @cached_property
    def defects(self) -> list[tuple[int, int]]:
        """For each component: holes that were closed, and edges of other than two faces."""
        count = self.component_count
        holes = np.bincount(self.component[list(self.holes)], minlength=count)
        several = np.bincount(self.component[self.edges[self.edge_faces != 2, 0]], minlength=count)
        return [(int(h), int(s)) for h, s in zip(holes, several, strict=True)]

    @cached_property
    def genus(self) -> list[int | None]:
        """Handles of each component, its holes closed; None where it is not a manifold, or one-sided."""
        count = self.component_count
        euler = np.bincount(self.component, minlength=count)
        euler = euler - np.bincount(self.component[self.edges[:, 0]], minlength=count)
        euler = euler + np.bincount(self.component[self.faces[:, 0]], minlength=count)
        return [
            (2 - int(e)) // 2 if not several and e <= 2 and e % 2 == 0 else None
            for e, (_, several) in zip(euler, self.defects, strict=True)
        ]

    def _split(self) -> Surface:
        """With a vertex for each fan of faces, further fans' vertices at the end."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        edge, a, b = self.adjacent
        links = []
        for end in self.edges[edge].T:  # the two faces' corners at either end of the edge are in one fan
            links.append([face * 3 + (self.faces[face] == end[:, None]).argmax(axis=1) for face in (a, b)])
        left, right = np.concatenate(links, axis=1)
        size = 3 * len(self.faces)
        fan = connected_components(coo_array((np.ones(len(left), bool), (left, right)), shape=(size, size)), False)[1]
        _, corner = np.unique(fan, return_index=True)
        if len(corner) == len(self.points):
            return self
        vertex = self.faces.ravel()[corner]  # of each fan
        _, first = np.unique(vertex, return_index=True)
        further = np.setdiff1d(np.arange(len(corner)), first)
        row = vertex.astype(np.int32)
        row[further] = len(self.points) + np.arange(len(further))
        points = np.concatenate([self.points, self.points[vertex[further]]])
        return replace(self, points=points, faces=np.ascontiguousarray(row[fan].reshape(-1, 3)))

    def _closed(self) -> Surface:
        """With each loop of border edges closed by a fan about its centroid."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        border = self.edges[self.edge_faces == 1]
        if not len(border):
            return self
        rows, ends = np.unique(border, return_inverse=True)
        ends = ends.reshape(-1, 2)
        links = coo_array((np.ones(len(ends), bool), (ends[:, 0], ends[:, 1])), shape=(len(rows),) * 2)
        count, loop = connected_components(links, directed=False)
        middle = [np.bincount(loop, self.points[rows, k], count) / np.bincount(loop) for k in range(3)]
        hole = (len(self.points) + loop[ends[:, 0]]).astype(np.int32)
        fans = np.stack([border[:, 1], border[:, 0], hole], axis=1)
        return replace(
            self,
            points=np.concatenate([self.points, np.stack(middle, axis=1)]),
            faces=np.concatenate([self.faces, fans]),
            holes=tuple(range(len(self.points), len(self.points) + count)),
        )

    def unplaced(self, points: F64) -> F64:
        """`points` of this space in world space."""
        return points * self.scale + self.origin


def _welded(points: F64) -> tuple[F64, I32]:
    """`points` without repetitions, in the order of their first occurrence, and the row of each."""
    key = points @ np.array([0.6180339887498949, 0.7548776662466927, 0.8191725133961645])
    _, first, row = np.unique(key, return_index=True, return_inverse=True)
    if not np.array_equal(points[first][row], points):  # two places with one key
        _, first, row = np.unique(points, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(first), np.int32)
    rank[order] = np.arange(len(first), dtype=np.int32)
    return points[first[order]], rank[row.ravel()]


def _distinct(faces: I32, count: int) -> I32:
    """`faces` that have three different corners, the first of each set of corners."""
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    corners = np.sort(faces, axis=1).astype(np.int64)
    low = corners[:, 0] * count + corners[:, 1]
    order = np.lexsort((corners[:, 2], low))
    same = (np.diff(low[order], prepend=-1) == 0) & (np.diff(corners[order, 2], prepend=-1) == 0)
    keep = np.ones(len(faces), bool)
    keep[order[same]] = False
    return np.ascontiguousarray(faces[keep])
