"""The kernel once more in plain NumPy: slow, readable, float64, the oracle that the native code is compared with.

The papers are named in `lodpipe.kernel.quadrics`.
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
from lodpipe.kernel.quadrics import (
    Quadric,
    area_of,
    edges_of,
    gradients,
    minimise,
    normal_of,
    plane_quadrics,
    quality_of,
    solid_faces,
)

SHORT_EDGE = 1e-9
"""Share of the trace × squared length that is added to every cost: among equals the shorter edge goes first."""
SLIVER = 1e-3
"""2 · area / longest edge², below which a face is a sliver."""


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
        seam_scale: F32 | None = None,
        locked: NDArray[np.bool_] | None = None,
    ) -> None:
        self.options = options or QuadricOptions()
        self.faces, self.wedges = faces.copy(), (faces if wedges is None else wedges).copy()
        self.alive = np.isin(np.arange(len(faces)), solid_faces(faces))
        used = positions[np.unique(faces[self.live])] if self.live else np.zeros((1, 3))
        low, high = used.min(axis=0), used.max(axis=0)
        self.center, self.diagonal = (low + high) / 2, float(np.linalg.norm(high - low)) or 1.0
        self.p = (positions - self.center) / self.diagonal
        self.errors = np.zeros(len(positions))
        self.locked = np.zeros(len(positions), bool) if locked is None else locked.copy()
        self.q = plane_quadrics(self.p, faces, self.options, wedges=self.wedges, seam_scale=seam_scale)

        worth = self.options.attribute_cost * np.asarray(column_weights, float) / self.diagonal
        self.steering, self.scale = np.flatnonzero(worth > 0), np.where(worth > 0, worth, 1.0)
        count = int(self.wedges.max(initial=-1)) + 1 if values is None else len(values)
        self.values: F64 = np.zeros((count, 0)) if values is None else values.astype(float) * self.scale
        self.weight, self.g, self.d = np.zeros(count), np.zeros((*self.values.shape, 3)), np.zeros(self.values.shape)
        for f in self.live:
            corners, rows = self.p[faces[f]], self.wedges[f]
            w, (g, d) = area_of(corners) / 3, gradients(corners, self.values[rows])
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
        return edges_of(self.faces, self.live)

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
                if quality_of(after) < min(SLIVER, quality_of(before) / 2):
                    return True
                cosine = float(normal_of(before) @ normal_of(after))
                if area_of(before) > 0 and cosine < np.cos(np.radians(self.options.flip_degrees)):
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
