"""Very small meshes by search: collapses and moves of vertices chosen by what they do to the silhouettes.

Quadrics say nothing of what is lost when a limb has two triangles left. At ten to fifty triangles every collapse can
be tried, and its effect on the silhouette from all round be measured instead (Lindstrom & Turk 2000 drive decimation
by images; here by silhouettes alone, and by the branches that survive).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lodpipe.core.mesh import F64, I32
from lodpipe.kernel import Level
from lodpipe.kernel.surfaces import Silhouettes

TRIED = 160
"""Collapses that are tried for each that is made: those of the shortest edges."""
STEPS = (0.08, 0.04, 0.02, 0.01)
"""How far vertices are moved, in radii of the model."""
ROUNDS = 3
"""Rounds for each step's length, at most."""


@dataclass(frozen=True, eq=False)
class Goal:
    """What is wanted of a small mesh: the source's silhouettes, and a vertex within `near` of each of `tips` (R, 3)."""

    seen: Silhouettes
    tips: F64
    near: float

    def survivors(self, points: F64) -> int:
        """Tips that have one of `points` (V, 3) near."""
        return int(self._near(points).any(axis=0).sum())

    def score(self, points: F64, faces: I32, worth: float) -> float:
        """Overlap of a mesh without unused points, plus `worth` for each tip that survives."""
        return self.seen.overlap(points, faces) + worth * self.survivors(points)

    def scores_moved(self, points: F64, faces: I32, vertex: I32, places: F64, worth: float) -> F64:
        """(K,) the same for meshes in each of which one `vertex` (K,) is at another of `places` (K, 3)."""
        near = self._near(points)
        left = near.sum(axis=0) - near[vertex] + self._near(places)
        return np.asarray(self.seen.overlaps_moved(points, faces, vertex, places) + worth * (left > 0).sum(axis=1))

    def _near(self, points: F64) -> np.ndarray:
        return np.asarray(np.linalg.norm(points[:, None] - self.tips[None], axis=2) <= self.near)


def carved(level: Level, points: F64, goal: Goal, target: int, worth: float) -> tuple[Level, F64]:
    """The level with at most `target` triangles, by collapses, and its points; `points` (V, 3) as `goal` has them.

    Each time the collapse onto one of an edge's ends is made that leaves the best score, unless an edge would get more
    than two faces, or a part come off. Fewer collapses are made where none is left. Attributes stay those of the
    corners that are kept.
    """
    faces, wedges, source = level.faces, level.wedges, level.face_source
    while len(faces) > target:
        edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
        order = np.argsort(np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1), kind="stable")
        short = edges[order[: TRIED // 2]]
        pairs = np.concatenate([short, short[:, ::-1]])
        used = np.unique(faces)
        row = np.zeros(len(points), np.int32)
        row[used] = np.arange(len(used), dtype=np.int32)
        scores = goal.scores_moved(points[used], row[faces], row[pairs[:, 0]], points[pairs[:, 1]], worth)
        for gone, stays in pairs[np.argsort(-scores, kind="stable")].tolist():
            merged = np.where(faces == gone, np.int32(stays), faces)
            real = (merged[:, 0] != merged[:, 1]) & (merged[:, 1] != merged[:, 2]) & (merged[:, 2] != merged[:, 0])
            if _sound(merged[real], faces):
                wedges = _wedges_after(faces, wedges, gone, stays)[real]
                faces, source = np.ascontiguousarray(merged[real]), source[real]
                break
        else:
            break
    return _level(level, points, faces, wedges, source)


def polished(points: F64, faces: I32, goal: Goal, worth: float) -> F64:
    """The points (V, 3), all of them used, moved to where the score is best, by steps that get shorter."""
    directions = np.concatenate([np.eye(3), -np.eye(3)])
    vertex = np.repeat(np.arange(len(points), dtype=np.int32), 6)
    best = goal.score(points, faces, worth)
    for step in STEPS:
        for _ in range(ROUNDS):
            places = points[vertex] + step * np.tile(directions, (len(points), 1))
            gain = (goal.scores_moved(points, faces, vertex, places, worth) - best).reshape(-1, 6)
            way, most = gain.argmax(axis=1), gain.max(axis=1)
            order = np.argsort(-most, kind="stable")
            order = order[most[order] > 1e-6]
            before = best
            for count in sorted({len(order), (len(order) + 1) // 2, (len(order) + 3) // 4, 1}, reverse=True):
                together = points.copy()  # moves that help alone may not help together
                together[order[:count]] += step * directions[way[order[:count]]]
                score = goal.score(together, faces, worth)
                if score > best:
                    points, best = together, score
                    break
            if best <= before:
                break
    return points


def _sound(faces: I32, before: I32) -> bool:
    """Whether there is something left, in no more parts and with no more crowded edges and double faces than before."""
    return bool(len(faces)) and _defects(faces) <= _defects(before) and _parts(faces) <= _parts(before)


def _defects(faces: I32) -> int:
    """Edges of more than two faces, and faces with the corners of another."""
    double = len(faces) - len(np.unique(np.sort(faces, axis=1), axis=0))
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return double + int((np.unique(edges, axis=0, return_counts=True)[1] > 2).sum())


def _parts(faces: I32) -> int:
    label = np.arange(int(faces.max()) + 1)
    while True:
        low = label[faces].min(axis=1)
        new = label.copy()
        np.minimum.at(new, faces.ravel(), np.repeat(low, 3))
        if np.array_equal(new, label):
            return len(np.unique(label[faces]))
        label = new


def _wedges_after(faces: I32, wedges: I32, gone: int, stays: int) -> I32:
    """The corners' wedges after a collapse: across the edge the partner's, else the first that the vertex has."""
    known: dict[int, int] = {}
    for face, row in zip(faces.tolist(), wedges.tolist(), strict=True):
        if gone in face and stays in face:
            known[row[face.index(gone)]] = row[face.index(stays)]
    at = np.nonzero(faces == stays)
    any_of = int(wedges[at][0]) if len(at[0]) else -1
    out = wedges.copy()
    for where in zip(*np.nonzero(faces == gone), strict=True):
        out[where] = known.get(int(wedges[where]), any_of)
    return out


def _level(level: Level, points: F64, faces: I32, wedges: I32, source: I32) -> tuple[Level, F64]:
    vertices, corners = np.unique(faces, return_inverse=True)
    rows, ends = np.unique(wedges, return_inverse=True)
    smaller = replace(
        level,
        positions=level.positions[vertices],
        vertex_source=level.vertex_source[vertices],
        faces=corners.reshape(-1, 3).astype(np.int32),
        wedges=ends.reshape(-1, 3).astype(np.int32),
        values=level.values[rows],
        wedge_source=level.wedge_source[rows],
        face_source=np.ascontiguousarray(source),
    )
    return smaller, points[vertices]
