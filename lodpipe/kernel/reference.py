"""The kernel once more in plain NumPy: slow, readable, float64, the oracle that the native code is compared with.

GH97   Garland & Heckbert 1997, "Surface simplification using quadric error metrics"
GH98   Garland & Heckbert 1998, "Simplifying surfaces with color and texture using quadric error metrics"
H99    Hoppe 1999, "New quadric metric for simplifying meshes with appearance attributes"
G99    Garland 1999, "Quadric-based polygonal surface simplification" (thesis; area weights)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.mesh import F32, F64, I32
from lodpipe.kernel import EdgeCosts, QuadricOptions

DAMPING = 3e-6
"""Share of the trace that pulls the optimum to the edge's middle where nothing else holds it."""
SHORT_EDGE = 1e-9
"""Share of the trace × squared length that is added to every cost: among equals the shorter edge goes first."""
REACH = 2.0
"""The optimum lies within so many edge lengths of the edge's middle, or is not believed."""
SLIVER = 1e-3
"""2 · area / longest edge², below which a face is a sliver."""


@dataclass(frozen=True)
class Quadric:
    """E(x) = xᵀ A x + 2 b·x + c in any number of dimensions; A symmetric."""

    A: F64
    b: F64
    c: float

    @staticmethod
    def zero(dimensions: int = 3) -> Quadric:
        return Quadric(np.zeros((dimensions, dimensions)), np.zeros(dimensions), 0.0)

    @staticmethod
    def of_plane(normal: F64, offset: float, weight: float = 1.0) -> Quadric:
        """weight · (normal·x + offset)²: K_p of GH97, section 5; the normal need not have unit length."""
        return Quadric(weight * np.outer(normal, normal), weight * offset * normal, weight * offset**2)

    def __add__(self, other: Quadric) -> Quadric:
        return Quadric(self.A + other.A, self.b + other.b, self.c + other.c)

    def __mul__(self, factor: float) -> Quadric:
        return Quadric(factor * self.A, factor * self.b, factor * self.c)

    def at(self, x: F64) -> float:
        return float(x @ self.A @ x + 2 * self.b @ x + self.c)

    @property
    def trace(self) -> float:
        return float(np.trace(self.A))


# ------------------------------------------------------------------------------------------------ quadrics of a face


def gradients(corners: F64, values: F64) -> tuple[F64, F64]:
    """Each of K attributes as the linear function g·x + d over a triangle, g in its plane (H99, section 3).

    corners (3, 3), values (3, K) at the corners; returns g (K, 3) and d (K,). Zero for a triangle without area.
    """
    e1, e2 = corners[1] - corners[0], corners[2] - corners[0]
    normal = np.cross(e1, e2)
    if not normal @ normal > 0:
        return np.zeros((values.shape[1], 3)), np.zeros(values.shape[1])
    g1, g2 = np.cross(e2, normal) / (normal @ normal), np.cross(normal, e1) / (normal @ normal)
    g = np.outer(values[1] - values[0], g1) + np.outer(values[2] - values[0], g2)
    return g, values[0] - g @ corners[0]


def attribute_quadric(corners: F64, values: F64) -> Quadric:
    """H99 over (x, s) in R^(3+K): squared distance of x to the plane + Σ (g·x + d − s)². Unweighted."""
    normal = _normal(corners)
    width = values.shape[1]
    total = Quadric.of_plane(np.concatenate([normal, np.zeros(width)]), float(-normal @ corners[0]))
    for k, (g, d) in enumerate(zip(*gradients(corners, values), strict=True)):
        total += Quadric.of_plane(np.concatenate([g, -np.eye(width)[k]]), float(d))
    return total


def attribute_quadric_gh98(corners: F64, values: F64) -> Quadric:
    """GH98, section 3: squared distance in R^(3+K) to the plane through the corners, A = I − e₁e₁ᵀ − e₂e₂ᵀ. Unweighted.

    It measures at right angles in R^(3+K) where `attribute_quadric` measures along x and s apart, so it is never the
    larger; it needs all of A, where H99's rows for s are diagonal, and knows of one s at a vertex only.
    """
    p, q, r = np.hstack([corners, values])
    e1 = (q - p) / np.linalg.norm(q - p)
    e2 = r - p - (e1 @ (r - p)) * e1
    e2 /= np.linalg.norm(e2)
    A = np.eye(len(p)) - np.outer(e1, e1) - np.outer(e2, e2)
    return Quadric(A, (p @ e1) * e1 + (p @ e2) * e2 - p, float(p @ p - (p @ e1) ** 2 - (p @ e2) ** 2))


def _normal(corners: F64) -> F64:
    """Unit normal; zeros for a triangle without area."""
    normal: F64 = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    length = float(np.linalg.norm(normal))
    return normal / length if length > 0 else np.zeros(3)


def _area(corners: F64) -> float:
    return float(np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))) / 2


# ---------------------------------------------------------------------------------------------- quadrics of a vertex


def plane_quadrics(
    positions: F64, faces: I32, options: QuadricOptions | None = None, *, wedges: I32 | None = None
) -> list[Quadric]:
    """Of each vertex: the planes of its faces, and those that hold borders, seams and creases.

    positions (V, 3), faces (F, 3), wedges (F, 3) as for `lodpipe.kernel.decimate`; faces with two equal corners are
    left out. A face's plane weighs 1, area / 3 (G99), or area × angle / π. At an edge that is a discontinuity each
    face adds a plane through the edge, perpendicular to the face (GH97, section 6).
    """
    options = options or QuadricOptions()
    wedges = faces if wedges is None else wedges
    live = _solid(faces)
    total = [Quadric.zero() for _ in positions]
    for f in live:
        corners = positions[faces[f]]
        plane = Quadric.of_plane(_normal(corners), float(-_normal(corners) @ corners[0]))
        for k in range(3):
            if _area(corners) > 0:
                total[faces[f, k]] += plane * _weight(corners, k, options)
    for (a, b), around in _edges(faces, live).items():
        weight = _discontinuity(positions, faces, wedges, (a, b), around, options)
        if not weight > 0:
            continue
        along = positions[b] - positions[a]
        size = 1.0 if options.weighting == "uniform" else float(along @ along)
        for f in around:
            across = np.cross(along, _normal(positions[faces[f]]))
            if across @ across > 0:
                across /= np.linalg.norm(across)
                plane = Quadric.of_plane(across, float(-across @ positions[a]), weight * size)
                total[a] += plane
                total[b] += plane
    return total


def _weight(corners: F64, k: int, options: QuadricOptions) -> float:
    if options.weighting == "uniform":
        return 1.0
    if options.weighting == "area":
        return _area(corners) / 3
    e1, e2 = corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]
    cosine = e1 @ e2 / (np.linalg.norm(e1) * np.linalg.norm(e2))
    return _area(corners) * float(np.arccos(np.clip(cosine, -1, 1))) / np.pi


def _discontinuity(
    positions: F64, faces: I32, wedges: I32, edge: tuple[int, int], around: list[int], options: QuadricOptions
) -> float:
    """The weight that holds an edge: an open border, a seam (also between more than two faces), a crease, or none."""
    if len(around) == 1:
        return options.boundary_weight
    if len(around) > 2:
        return options.seam_weight
    f, g = around
    if any(wedges[f][faces[f] == end] != wedges[g][faces[g] == end] for end in edge):
        return options.seam_weight
    turn = float(_normal(positions[faces[f]]) @ _normal(positions[faces[g]]))
    return options.crease_weight if turn < np.cos(np.radians(options.crease_degrees)) else 0.0


def _solid(faces: I32) -> list[int]:
    return [f for f, corners in enumerate(faces) if len(set(corners.tolist())) == 3]


def _edges(faces: I32, live: Sequence[int]) -> dict[tuple[int, int], list[int]]:
    """Edge (lower, higher vertex) -> its faces."""
    found: dict[tuple[int, int], list[int]] = {}
    for f in live:
        for a, b in combinations(sorted(faces[f].tolist()), 2):
            found.setdefault((a, b), []).append(f)
    return found


# ------------------------------------------------------------------------------------------------------ contraction


def minimise(quadric: Quadric, p: F64, q: F64) -> F64:
    """The place of least error for merging p and q (GH97, section 5, with its fall-backs).

    The quadric's minimum, drawn a little to the middle; if that is singular or farther than `REACH` edge lengths from
    the middle, the best point of the segment; if the quadric is flat along it, the middle.
    """
    along, middle = q - p, (p + q) / 2
    x = _damped(quadric, middle)
    if np.linalg.norm(x - middle) <= REACH * np.linalg.norm(along):
        return x
    curve = float(along @ quadric.A @ along)
    if curve <= 1e-12 * quadric.trace * float(along @ along):
        return middle
    slope = float(along @ (quadric.A @ p + quadric.b))
    return np.asarray(p + along * np.clip(-slope / curve, 0, 1), np.float64)


def _damped(quadric: Quadric, toward: F64) -> F64:
    """Where E(x) + damping · |x − toward|² is least; infinity if there is no such place."""
    damping = DAMPING * quadric.trace
    A = quadric.A + damping * np.eye(3)
    if not np.linalg.det(A) > 0:
        return np.full(3, np.inf)
    return np.asarray(np.linalg.solve(A, damping * toward - quadric.b), np.float64)


@dataclass(frozen=True)
class Merge:
    """What becomes of a pair: the cost, the deviation, the vertex that stays, its place, and the values of each group
    of wedges, the one that stays first."""

    cost: float
    error: float
    kept: int
    x: F64
    groups: list[tuple[list[int], F64]]


IMPOSSIBLE = Merge(np.inf, 0.0, -1, np.zeros(3), [])


class State:
    """A mesh in a box of unit diagonal about the origin, while it is being simplified.

    H99's quadric of a vertex is `q` for the rows of x (Σ w g gᵀ included), and for each of its wedges `weight` Σ w, `g`
    Σ w g and `d` Σ w d over the wedge's faces: the rows of s, as many as there are wedges.
    """

    def __init__(
        self,
        positions: F64,
        faces: I32,
        options: QuadricOptions | None = None,
        *,
        wedges: I32 | None = None,
        values: F32 | None = None,
        column_weights: Sequence[float] = (),
        importance: F32 | None = None,
        locked: NDArray[np.bool_] | None = None,
    ) -> None:
        self.options = options or QuadricOptions()
        self.faces, self.wedges = faces.copy(), (faces if wedges is None else wedges).copy()
        self.alive = np.isin(np.arange(len(faces)), _solid(faces))
        used = positions[np.unique(faces[self.live])] if self.live else np.zeros((1, 3))
        low, high = used.min(axis=0), used.max(axis=0)
        self.center, self.diagonal = (low + high) / 2, float(np.linalg.norm(high - low)) or 1.0
        self.p = (positions - self.center) / self.diagonal
        self.errors = np.zeros(len(positions))
        self.locked = np.zeros(len(positions), bool) if locked is None else locked.copy()
        self.q = plane_quadrics(self.p, faces, self.options, wedges=self.wedges)

        worth = self.options.attribute_cost * np.asarray(column_weights, float) / self.diagonal
        self.steering, self.scale = np.flatnonzero(worth > 0), np.where(worth > 0, worth, 1.0)
        count = int(self.wedges.max(initial=-1)) + 1 if values is None else len(values)
        self.values: F64 = np.zeros((count, 0)) if values is None else values.astype(float) * self.scale
        self.weight, self.g, self.d = np.zeros(count), np.zeros((*self.values.shape, 3)), np.zeros(self.values.shape)
        for f in self.live:
            corners, rows = self.p[faces[f]], self.wedges[f]
            w, (g, d) = _area(corners) / 3, gradients(corners, self.values[rows])
            self.weight[rows] += w
            self.g[rows] += w * g
            self.d[rows] += w * d
            for v in faces[f]:
                self.q[v] = sum((Quadric.of_plane(g[k], float(d[k]), w) for k in self.steering), self.q[v])
        if importance is not None:
            self.q = [q * float(factor) for q, factor in zip(self.q, importance, strict=True)]
            of_wedge = np.ones(count)
            of_wedge[self.wedges[self.live]] = importance[faces[self.live]]
            self.weight, self.g, self.d = (
                a * of_wedge.reshape(-1, *[1] * (a.ndim - 1)) for a in (self.weight, self.g, self.d)
            )

        reach = self.options.pair_distance / self.diagonal
        pairs = combinations(np.unique(faces[self.live]).tolist(), 2) if reach else ()
        edges = self.edges()  # the others of the valid pairs: GH97, section 4
        self.near = [p for p in pairs if p not in edges and np.linalg.norm(self.p[p[0]] - self.p[p[1]]) < reach]

    @property
    def live(self) -> list[int]:
        return np.flatnonzero(self.alive).tolist()

    def edges(self) -> dict[tuple[int, int], list[int]]:
        return _edges(self.faces, self.live)

    def at(self, *vertices: int) -> list[int]:
        """Faces that have all of the vertices as corners."""
        have = [(self.faces == v).any(axis=1) for v in vertices]
        return np.flatnonzero(np.all([self.alive, *have], axis=0)).tolist()

    def ring(self, v: int) -> set[int]:
        """Neighbours of v along edges."""
        return set(self.faces[self.at(v)].ravel().tolist()) - {v}

    def wedge(self, face: int, v: int) -> int:
        return int(self.wedges[face][self.faces[face] == v][0])

    def groups(self, v: int, u: int) -> list[list[int]]:
        """Wedges of v and u by what becomes one: those that a face on the edge joins. Wedges of v come first."""
        rows = dict.fromkeys([self.wedge(f, v) for f in self.at(v)] + [self.wedge(f, u) for f in self.at(u)])
        group = {w: {w} for w in rows}
        for f in self.at(v, u):
            joined = group[self.wedge(f, v)] | group[self.wedge(f, u)]
            group.update(dict.fromkeys(joined, joined))
        sets = {frozenset(g): None for g in group.values()}
        return [[w for w in rows if w in g] for g in sets]

    def merge(self, v: int, u: int) -> Merge:
        """What contracting (v, u) costs, and where to."""
        if self.locked[v] and self.locked[u]:
            return IMPOSSIBLE
        if self.options.placement == "endpoint" or self.locked[v] or self.locked[u]:
            ends = [self._onto(a, b) for a, b in ((v, u), (u, v)) if not self.locked[b]]
            return min(ends, key=lambda m: m.cost)
        groups = self.groups(v, u) if self.values.shape[1] else []
        total = least = self.q[v] + self.q[u]
        for rows in groups:  # with each attribute at its best value for x: the Schur complement of the rows of s
            for k in self.steering if self.weight[rows].sum() > 0 else ():
                g, d = self.g[rows, k].sum(axis=0), float(self.d[rows, k].sum())
                least += Quadric.of_plane(g, d, -1 / float(self.weight[rows].sum()))
        p, q = self.p[v], self.p[u]
        x = (p + q) / 2 if self.options.placement == "midpoint" else minimise(least, p, q)
        best = [(rows, self._best(rows, x)) for rows in groups]
        return self._finish(least.at(x), total.trace, (v, u), x, best)

    def _best(self, rows: list[int], x: F64) -> F64:
        weight = float(self.weight[rows].sum())
        if not weight > 0:
            return np.asarray(self.values[rows[0]], float)
        return np.asarray((self.g[rows].sum(axis=0) @ x + self.d[rows].sum(axis=0)) / weight, float)

    def _onto(self, stays: int, gone: int) -> Merge:
        """A half-edge collapse: place and values of `stays`. Each wedge needs just one counterpart there."""
        total, x, best = self.q[stays] + self.q[gone], self.p[stays], []
        cost = total.at(x)
        counterparts = {self.wedge(f, stays) for f in self.at(stays)}
        for rows in self.groups(stays, gone) if self.values.shape[1] else ():
            if len(counterparts & set(rows)) != 1:
                return IMPOSSIBLE
            s, weight = self.values[rows[0]], float(self.weight[rows].sum())
            for k in self.steering:
                cost += s[k] * (weight * s[k] - 2 * float(self.g[rows, k].sum(axis=0) @ x + self.d[rows, k].sum()))
            best.append((rows, s))
        return self._finish(cost, total.trace, (stays, gone), x, best)

    def _finish(
        self, cost: float, trace: float, pair: tuple[int, int], x: F64, groups: list[tuple[list[int], F64]]
    ) -> Merge:
        cost, along = max(cost, 0.0), self.p[pair[1]] - self.p[pair[0]]
        error = float(np.sqrt(cost / trace)) if trace > 0 else 0.0
        return Merge(cost + SHORT_EDGE * trace * float(along @ along), error, pair[0], x, groups)

    def refusal(self, v: int, u: int, merge: Merge) -> str:
        """Which guard forbids the contraction; empty if none does."""
        if self.options.keep_topology and not self._keeps_topology(v, u):
            return "topology"
        if not merge.cost < np.inf:
            return "locked" if self.locked[v] and self.locked[u] else "seams"
        if self.options.max_error is not None and merge.error * self.diagonal > self.options.max_error:
            return "error"
        return "flip" if self._turns(v, u, merge.x) else ""

    def _keeps_topology(self, v: int, u: int) -> bool:
        """The link condition (Dey, Edelsbrunner, Guha & Nekhayev 1999), and no two borders pinched together."""
        on_edge = self.at(v, u)
        opposite = set(self.faces[on_edge].ravel().tolist()) - {v, u}
        if (self.ring(v) & self.ring(u)) != opposite:
            return False
        on_border = [any(len(self.at(end, w)) == 1 for w in self.ring(end)) for end in (v, u)]
        return len(on_edge) == 1 or not all(on_border)

    def _turns(self, v: int, u: int, x: F64) -> bool:
        """Whether a face that stays would turn over, or become a sliver that it was not (GH97, section 6)."""
        for end in (v, u):
            for f in set(self.at(end)) - set(self.at(v, u)):
                before = self.p[self.faces[f]]
                after = np.where((self.faces[f] == end)[:, None], x, before)
                if _quality(after) < min(SLIVER, _quality(before) / 2):
                    return True
                cosine = float(_normal(before) @ _normal(after))
                if _area(before) > 0 and cosine < np.cos(np.radians(self.options.flip_degrees)):
                    return True
        return False

    def contract(self, pair: tuple[int, int], merge: Merge) -> None:
        """Put the two ends of a pair together."""
        v, u = pair if merge.kept == pair[0] else pair[::-1]
        for rows, s in merge.groups:
            kept, gone = rows[0], rows[1:]
            for table in (self.weight, self.g, self.d):
                table[kept] += table[gone].sum(axis=0)
            self.values[kept] = s
            self.wedges[np.isin(self.wedges, gone)] = kept
        self.alive[self.at(v, u)] = False
        self.faces[self.faces == u] = v
        moved = {(min(a, b), max(a, b)) for a, b in ([v if end == u else end for end in p] for p in self.near)}
        self.near = sorted(p for p in moved if p[0] != p[1])
        self.q[v] += self.q[u]
        self.p[v] = merge.x
        self.locked[v] |= self.locked[u]
        self.errors[v] = max(self.errors[v], self.errors[u], merge.error)


def edge_costs(positions: F64, faces: I32, options: QuadricOptions | None = None, **arrays: Any) -> EdgeCosts:
    """As `lodpipe.kernel.edge_costs`, which see for the arrays; the pairs come in another order."""
    state = State(positions, faces, options, **arrays)
    pairs = [*state.edges(), *state.near]
    merges = [state.merge(*pair) for pair in pairs]
    places = np.array([m.x for m in merges]).reshape(-1, 3) * state.diagonal + state.center
    return EdgeCosts(np.array(pairs, np.int32).reshape(-1, 2), np.array([m.cost for m in merges], np.float32), places)


def decimate(positions: F64, faces: I32, target: int, options: QuadricOptions | None = None, **arrays: Any) -> State:
    """`lodpipe.kernel.decimate` to one target, always by the cheapest collapse of all that no guard forbids.

    Small components are not taken out and the topology is never given up. Cubic in time: for tiny meshes. Returns the
    last state; its faces are `faces[live]`.
    """
    state = State(positions, faces, options, **arrays)
    known: dict[tuple[int, int], Merge] = {}
    while len(state.live) > target:
        pairs = {*state.edges(), *state.near}
        known = {pair: known[pair] if pair in known else state.merge(*pair) for pair in pairs}
        for pair in sorted(pairs, key=lambda p: (known[p].cost, p)):
            if not state.refusal(*pair, known[pair]):
                state.contract(pair, known[pair])
                known = {p: m for p, m in known.items() if not set(p) & set(pair)}
                break
        else:
            break
    return state


def _quality(corners: F64) -> float:
    """2 · area / longest edge²."""
    longest = max(float(np.sum((corners[i] - corners[i - 1]) ** 2)) for i in range(3))
    return 2 * _area(corners) / longest if longest > 0 else 0.0
