"""Levels of very few triangles: which of several ways keeps a model recognisable is measured, level by level.

P-QEM (NSC report on perception-oriented metrics) weighs and reserves vertices by the skeleton. That pays at extreme
reduction and costs accuracy at moderate reduction, so here each level with few triangles for each branch is made in
several ways — plain, weighted, with terminal vertices held — each also fitted to the source by least squares. The way
is taken that shows the source's silhouette best among those that keep the most branches; plain QEM is one of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.mesh import F64, I32
from lodpipe.geometry.camera import views
from lodpipe.geometry.carve import Goal, carved, polished
from lodpipe.geometry.topology import components
from lodpipe.kernel import Level
from lodpipe.kernel.surfaces import Silhouettes

FULL, NONE = 20.0, 60.0
"""Triangles for each branch (and main body) up to which the skeleton counts fully, and from which not at all."""
MOST_SHARE = 0.1
"""Levels with this share of the source's triangles or more are left plain."""
NEAR = 0.03
"""A branch survives if a vertex is within this share of the diagonal of its terminal vertex."""
GAIN, LOSS = 0.006, 0.015
"""What a way must win in silhouette overlap before surviving branches are compared, and what it may lose if half of
all branches survive by it."""
VIEWS, SIZE, FINE, MARGIN = 20, 64, 3, 1.1
CARVED, WORTHS = 60, (1.0, 0.01)
"""Levels of so many triangles or fewer are searched for, too, twice: what a branch that survives counts in overlap."""
SAMPLES, ROUNDS = 1500, 4
LOOSE = 0.5
"""A held vertex may be moved by this share of NEAR."""

Bool = NDArray[np.bool_]
Run = Callable[[F64, Bool | None, list[int]], Sequence[Level]]


def strength_at(triangles: int, source: int, branches: int) -> float:
    """0…1: how much the skeleton counts at a budget: fades in as the triangles for each branch fall."""
    if triangles >= MOST_SHARE * source or branches < 1:
        return 0.0
    each = triangles / (branches + 1)
    t = float(np.clip((NONE - each) / (NONE - FULL), 0, 1))
    return t * t * (3 - 2 * t)


@dataclass(frozen=True, eq=False)
class Guide:
    """What the skeleton says of the joined surface.

    extreme  (V,) float64 ≥ 1, factors of the quadrics at full strength
    tips     (R,) int64 rows of the vertices, terminal vertices, longest branch first
    strength as in `Importance`
    """

    extreme: F64
    tips: NDArray[np.int64]
    strength: float | None


def extreme_levels(
    positions: F64, faces: I32, plain: Sequence[Level], guide: Guide, run: Run, threads: int = 0
) -> dict[int, Level]:
    """The levels of `plain` that are better made another way, by target.

    `run` decimates the surface with factors (V,) for the quadrics, locks (V,) and targets in descending order.
    """
    tips = guide.tips
    chosen = {}
    for level in plain:
        strength = strength_at(level.target, len(faces), len(tips))
        if guide.strength is not None:
            strength = guide.strength if strength > 0 else 0.0
        if strength > 0 and len(level.faces):
            chosen[level.target] = (level, strength)
    if not chosen:
        return {}
    targets = sorted(chosen, reverse=True)
    weakest = min(strength for _, strength in chosen.values())
    ways: dict[int, list[Level]] = {target: [level] for target, (level, _) in chosen.items()}
    seeds = {t: 2 * (t + len(tips)) + 8 for t in targets if t <= CARVED}
    wanted = sorted({*targets, *seeds.values()}, reverse=True)
    factors = guide.extreme ** max(weakest, 0.25)
    even = np.ones(len(positions))
    made: dict[int, list[Level]] = {count: [] for count in wanted}
    for weights, count in ((factors, len(tips)), (even, len(tips)), (factors, 0)):
        locks = np.zeros(len(positions), bool)
        locks[tips[:count]] = True
        for level in run(weights, locks if count else None, [t for t in wanted if count <= t / 4 + 2]):
            made[level.target].append(level)
    for target in targets:
        ways[target] += made[target]
    judge = _Judge(positions, faces, tips, threads)
    better = {}
    for target in targets:
        seed = made[seeds[target]] if target in seeds else []
        best = judge.best([way for way in ways[target] if len(way.faces)], seed, target)
        if best is not chosen[target][0]:
            better[target] = best
    return better


@dataclass(frozen=True, eq=False)
class _Try:
    level: Level
    points: F64
    """(V, 3) the level's positions as the judge has them."""
    overlap: float
    survivors: int


def _rank(entry: _Try) -> tuple[int, float]:
    return entry.survivors, entry.overlap


class _Judge:
    """The source's silhouettes and samples, in a ball of radius 1 about its middle."""

    def __init__(self, positions: F64, faces: I32, tips: NDArray[np.int64], threads: int) -> None:
        from lodpipe.o3d import RayScene

        used = np.unique(faces)
        low, high = positions[used].min(axis=0), positions[used].max(axis=0)
        self.centre = (low + high) / 2
        self.scale = float(np.linalg.norm(high - low)) / 2 or 1.0
        points = self.placed(positions)
        self.tips = points[tips]
        self.scene = RayScene(points.astype(np.float32), faces)
        self.samples = _spread(points, faces, SAMPLES, 0)[2]
        directions = views(VIEWS) @ np.linalg.qr(np.array([[1, 2, 3], [4, 5, 7], [8, 1, 2.0]]))[0]
        right = np.cross(directions, np.eye(3)[np.abs(directions).argmin(axis=1)])
        right /= np.linalg.norm(right, axis=1, keepdims=True)
        axes = np.stack([right, np.cross(directions, right)], axis=1) / MARGIN
        self.goal = Goal(Silhouettes(points, faces, axes, SIZE, threads), self.tips, 2 * NEAR)
        self.fine = Silhouettes(points, faces, axes, FINE * SIZE, threads)
        self.pieces = _pieces(faces)

    def placed(self, positions: F64) -> F64:
        return np.asarray((positions - self.centre) / self.scale)

    def overlap(self, points: F64, faces: I32) -> float:
        """Mean intersection over union of the silhouettes."""
        return self.fine.overlap(points, faces)

    def best(self, ways: Sequence[Level], seeds: Sequence[Level], target: int) -> Level:
        """The best of the ways, of what fitting makes of them, and of what a search makes of the larger `seeds`.

        The first way is what others must beat.
        """
        first = self.placed(ways[0].positions)
        plain = _Try(ways[0], first, self.overlap(first, ways[0].faces), self.goal.survivors(first))
        found = [plain]
        most = max(target, len(ways[0].faces))
        for way in ways:
            if len(way.faces) > most or (way is not ways[0] and _pieces(way.faces) > self.pieces):
                continue  # a tip that has lost its limb is no limb
            points = self.placed(way.positions)
            fitted = self._fitted(points, way.faces)
            for moved in [fitted, (points + fitted) / 2] if way is ways[0] else [points, fitted, (points + fitted) / 2]:
                found.append(self._judged(way, moved))
        for seed in seeds[:1]:
            for worth in WORTHS:
                level, points = carved(seed, self.placed(seed.positions), self.goal, target, worth)
                if len(level.faces) <= most:
                    found.append(self._judged(level, points))
        for entry in {
            id(e): e for e in (self._chosen(found), max(found, key=lambda e: e.overlap), max(found, key=_rank))
        }.values():
            moved = polished(entry.points, entry.level.faces, self.goal, WORTHS[0])
            found.append(self._judged(entry.level, moved))
        chosen = self._chosen(found)
        return ways[0] if chosen is plain else self._moved(chosen.level, chosen.points)

    def _judged(self, level: Level, points: F64) -> _Try:
        return _Try(level, points, self.overlap(points, level.faces), self.goal.survivors(points))

    def _chosen(self, found: Sequence[_Try]) -> _Try:
        plain = found[0]
        good = [e for e in found if e.overlap >= plain.overlap + GAIN]
        good = good or [e for e in found if e.overlap >= plain.overlap and e.survivors >= plain.survivors]
        chosen = max(good, key=_rank)
        even = max((e for e in found if e.overlap >= plain.overlap - LOSS), key=_rank)
        return even if even.survivors >= chosen.survivors + max(1, (len(self.tips) + 1) // 2) else chosen

    def _moved(self, level: Level, points: F64) -> Level:
        return replace(
            level,
            positions=np.asarray(points * self.scale + self.centre),
            vertex_source=np.full(len(points), -1, np.int32),
        )

    def _fitted(self, points: F64, faces: I32) -> F64:
        """Vertices where the squared distances, both ways, to samples and their closest points are least.

        A vertex near a terminal vertex stays near it.
        """
        from lodpipe.o3d import RayScene

        count = len(points)
        start = points
        held = []
        for tip in self.tips:
            away = np.linalg.norm(points - tip, axis=1)
            if away.min() <= 2 * NEAR:
                held.append((int(away.argmin()), tip))
        for turn in range(ROUNDS):
            system, right = np.zeros((count, count)), np.zeros((count, 3))
            scene = RayScene(points.astype(np.float32), faces)
            closest, face = scene.closest(self.samples.astype(np.float32))
            weights = _barycentric(points[faces[face]], closest.astype(np.float64))
            _add(system, right, faces[face], weights, self.samples)
            spots, shares, place = _spread(points, faces, SAMPLES, turn + 1)
            closest, _ = self.scene.closest(place.astype(np.float32))
            _add(system, right, faces[spots], shares, closest.astype(np.float64))
            pull = 0.02 / count
            system[np.arange(count), np.arange(count)] += pull
            right += pull * points
            points = np.asarray(np.linalg.solve(system, right), np.float64)
            for vertex, tip in held:
                step = points[vertex] - tip
                far = float(np.linalg.norm(step))
                if far > 2 * NEAR * LOOSE:
                    points[vertex] = tip + step * (2 * NEAR * LOOSE / far)
        return points if np.isfinite(points).all() and np.abs(points).max() < 2 else start


def _pieces(faces: I32) -> int:
    """Connected components."""
    used, corners = np.unique(faces, return_inverse=True)
    return len(np.unique(components(corners.reshape(-1, 3).astype(np.int32), len(used))))


def _add(system: F64, right: F64, corners: I32, weights: F64, targets: F64) -> None:
    """Adds the mean of |Σ w·x − target|² over the rows to the normal equations."""
    share = 1.0 / len(targets)
    count = len(system)
    for i in range(3):
        for k in range(3):
            right[:, k] += np.bincount(corners[:, i], share * weights[:, i] * targets[:, k], count)
        for j in range(3):
            cell = corners[:, i].astype(np.int64) * count + corners[:, j]
            system += np.bincount(cell, share * weights[:, i] * weights[:, j], count * count).reshape(count, count)


def _spread(points: F64, faces: I32, count: int, seed: int) -> tuple[NDArray[np.int64], F64, F64]:
    """Faces, barycentric weights and places of `count` samples spread by area."""
    corner = points[faces]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) + 1e-15
    rng = np.random.default_rng(seed)
    at = (np.arange(count) + rng.random(count)) / count
    face = np.minimum(np.searchsorted(np.cumsum(area) / area.sum(), at), len(faces) - 1)
    u, v = rng.random((2, count))
    over = u + v > 1
    u, v = np.where(over, 1 - u, u), np.where(over, 1 - v, v)
    weights = np.stack([1 - u - v, u, v], axis=1)
    return face, weights, np.einsum("nk,nkd->nd", weights, corner[face])


def _barycentric(corners: F64, places: F64) -> F64:
    """(N, 3) weights of points that lie on triangles (N, 3, 3)."""
    a, b, c = (corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], places - corners[:, 0])
    aa, ab, bb = (np.einsum("ij,ij->i", x, y) for x, y in ((a, a), (a, b), (b, b)))
    ca, cb = np.einsum("ij,ij->i", c, a), np.einsum("ij,ij->i", c, b)
    area = np.maximum(aa * bb - ab * ab, 1e-18)
    v, w = (bb * ca - ab * cb) / area, (aa * cb - ab * ca) / area
    weights = np.clip(np.stack([1 - v - w, v, w], axis=1), 0, 1)
    return np.asarray(weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-12))
