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
from lodpipe.geometry.topology import components
from lodpipe.kernel import Level

FULL, NONE = 20.0, 60.0
"""Triangles for each branch (and main body) up to which the skeleton counts fully, and from which not at all."""
MOST_SHARE = 0.1
"""Levels with this share of the source's triangles or more are left plain."""
NEAR = 0.03
"""A branch survives if a vertex is within this share of the diagonal of its terminal vertex."""
GAIN, LOSS = 0.006, 0.005
"""What a way must win in silhouette overlap before surviving branches are compared, and what it may lose if half of
all branches survive by it."""
VIEWS, SIZE = 20, 72
SAMPLES, ROUNDS = 3000, 6
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


def extreme_levels(positions: F64, faces: I32, plain: Sequence[Level], guide: Guide, run: Run) -> dict[int, Level]:
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
    factors = guide.extreme ** max(weakest, 0.25)
    even = np.ones(len(positions))
    counts = dict.fromkeys([0, len(tips), (len(tips) + 1) // 2, min(3, len(tips))])
    for weights, count in [*((factors, count) for count in counts), (even, len(tips))]:
        room = [t for t in targets if count <= t / 4 + 2]  # half of a closed mesh's vertices
        if room:
            locks = np.zeros(len(positions), bool)
            locks[tips[:count]] = True
            for level in run(weights, locks if count else None, room):
                ways[level.target].append(level)
    judge = _Judge(positions, faces, tips)
    better = {}
    for target in targets:
        best = judge.best([way for way in ways[target] if len(way.faces)], target)
        if best is not chosen[target][0]:
            better[target] = best
    return better


class _Judge:
    """The source's silhouettes and samples, in a ball of radius 1 about its middle."""

    def __init__(self, positions: F64, faces: I32, tips: NDArray[np.int64]) -> None:
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
        up = np.cross(directions, right)
        grid = ((np.arange(SIZE) + 0.5) / SIZE * 2 - 1) * 1.1
        across = grid[None, None, :, None] * right[:, None, None] + grid[None, :, None, None] * up[:, None, None]
        self.origins = (across + 3 * directions[:, None, None]).reshape(-1, 3).astype(np.float32)
        self.along = np.repeat(-directions, SIZE * SIZE, axis=0).astype(np.float32)
        self.seen = self._silhouettes(points, faces)
        self.pieces = _pieces(faces)

    def placed(self, positions: F64) -> F64:
        return np.asarray((positions - self.centre) / self.scale)

    def _silhouettes(self, points: F64, faces: I32) -> Bool:
        from lodpipe.o3d import RayScene

        scene = RayScene(points.astype(np.float32), faces)
        return np.asarray(scene.cast(self.origins, self.along).faces.reshape(VIEWS, -1) >= 0)

    def overlap(self, points: F64, faces: I32) -> float:
        """Mean intersection over union of the silhouettes."""
        seen = self._silhouettes(points, faces)
        both, either = (seen & self.seen).sum(axis=1), (seen | self.seen).sum(axis=1)
        return float((both / np.maximum(either, 1)).mean())

    def survivors(self, points: F64) -> int:
        """Branches that have a vertex near their terminal vertex; NEAR is of the diagonal, which is 2 here."""
        away = np.linalg.norm(self.tips[:, None] - points[None], axis=2).min(axis=1, initial=np.inf)
        return int((away <= 2 * NEAR).sum())

    def best(self, ways: Sequence[Level], target: int) -> Level:
        """The best of the ways and of what fitting makes of them; the first one is what others must beat."""
        first = self.placed(ways[0].positions)
        base = self.overlap(first, ways[0].faces)
        found = [(base, self.survivors(first), ways[0])]
        most = max(target, len(ways[0].faces))
        for way in ways:
            if len(way.faces) > most or (way is not ways[0] and _pieces(way.faces) > self.pieces):
                continue  # a tip that has lost its limb is no limb
            points = self.placed(way.positions)
            fitted = self._fitted(points, way.faces)
            tries = [fitted, (points + fitted) / 2] if way is ways[0] else [points, fitted, (points + fitted) / 2]
            for moved in tries:
                level = way if moved is points else self._moved(way, moved)
                found.append((self.overlap(moved, way.faces), self.survivors(moved), level))

        def rank(entry: tuple[float, int, Level]) -> tuple[int, float]:
            return entry[1], entry[0]

        good = [f for f in found if f[0] >= base + GAIN]
        if not good:
            good = [f for f in found if f[0] >= base and f[1] >= found[0][1]]
        chosen = max(good, key=rank)
        even = max((f for f in found if f[0] >= base - LOSS), key=rank)
        return (even if even[1] >= chosen[1] + max(1, (len(self.tips) + 1) // 2) else chosen)[2]

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
