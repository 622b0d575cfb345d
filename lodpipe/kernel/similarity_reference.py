"""The similarity decimator once more in plain NumPy: slow, readable, float64, the oracle of the native code.

Liao 2004, "Mesh simplification with geometry and material preserving" (sections of it are named); Cohen, Olano &
Manocha 1998, "Appearance-preserving simplification"; Lindstrom & Turk 2000, "Image-driven simplification".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np

from lodpipe.core.mesh import F32, F64, I32
from lodpipe.kernel.ray_reference import (
    Surface,
    barycentric,
    colours,
    common,
    hemisphere,
    intersect,
    is_flat,
    scan_lines,
    within,
)
from lodpipe.kernel.similarity import Appearance, SimilarityOptions

REACH = 1.25
"""Distances of the region's farthest vertex from its centre within which the original counts."""
SLIVER = 1e-3
"""2 · area / longest edge², below which a face is a sliver."""
REFUSED = np.inf

Hits = Callable[[F64, F64, F64, F64], tuple[F64, I32, F64]]
"""Rays against the original: origins, directions (N, 3), least and most t (N,) → t, face (−1: none), weights (N, 3)."""


@dataclass
class Plan:
    """What gone → kept would do; `wedges` maps rows of wedges to their new rows and values."""

    gone: int
    kept: int
    place: F64
    before: list[int]
    after: list[int]
    whole: bool = False
    wedges: dict[int, tuple[int, F64]] = field(default_factory=dict)


class State:
    """A mesh in a box of unit diagonal about the origin, while it is being simplified."""

    def __init__(
        self,
        positions: F64,
        faces: I32,
        appearance: Appearance,
        options: SimilarityOptions | None = None,
        *,
        wedges: I32 | None = None,
        values: F32 | None = None,
        column_weights: Sequence[float] = (),
        original_hits: Hits | None = None,
    ) -> None:
        self.options, self.appearance = options or SimilarityOptions(), appearance
        solid = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        self.faces, self.wedges = faces[solid].copy(), (faces if wedges is None else wedges)[solid].copy()
        count = int(self.wedges.max(initial=-1)) + 1
        self.values = np.zeros((count, 0)) if values is None else values.astype(float)
        self.look = np.asarray(appearance.face_look)[solid]
        used = positions[np.unique(self.faces)]
        low, high = used.min(axis=0), used.max(axis=0)
        self.center, self.diagonal = (low + high) / 2, float(np.linalg.norm(high - low)) or 1.0
        self.p = (positions - self.center) / self.diagonal
        self.alive = np.ones(len(self.faces), bool)
        areas = np.linalg.norm(self._area_vectors(range(len(self.faces))), axis=1)
        self.step = self.options.spacing * np.sqrt(2 * areas.mean())
        self.first = self.surface(range(len(self.faces)))
        self.first_hits = original_hits
        self.sets = [{f} for f in range(len(self.faces))]
        self.boxes = [(np.zeros(3), np.zeros(3)) for _ in self.faces]
        self.pictures = self._pictures(self.first) if self.options.metric == "image" else None
        self.uv_scale = 0.0
        if appearance.uv_column is not None and len(column_weights):
            self.uv_scale = column_weights[appearance.uv_column] / self.diagonal
        self.quadrics = self._wedge_quadrics()
        self.hold = self._holding_quadrics()

    # ------------------------------------------------------------------ the mesh

    def ring(self, v: int) -> list[int]:
        """Live faces that have v as a corner."""
        return np.flatnonzero(self.alive & (self.faces == v).any(axis=1)).tolist()

    def _area_vectors(self, faces: Any) -> F64:
        a, b, c = (self.p[self.faces[list(faces), k]] for k in range(3))
        return np.cross(b - a, c - a) / 2

    def neighbours(self, v: int) -> dict[int, int]:
        """Neighbours of v, each with the number of faces that it shares with v."""
        corners = self.faces[self.ring(v)].ravel()
        others, count = np.unique(corners[corners != v], return_counts=True)
        return dict(zip(others.tolist(), count.tolist(), strict=True))

    def _corner(self, face: int, k: int, plan: Plan | None) -> tuple[F64, F64]:
        """Place and values of a corner as it is, or as the plan would have it."""
        v, w = int(self.faces[face, k]), int(self.wedges[face, k])
        if plan is None or v not in (plan.gone, plan.kept):
            return self.p[v], self.values[w]
        return plan.place, plan.wedges[w][1] if w in plan.wedges else self.values[w]

    def surface(self, faces: Any, plan: Plan | None = None) -> Surface:
        """The faces with what is at their corners."""
        corners, at = [], []
        for f in faces:
            look = self.appearance.looks[self.look[f]]
            three = [self._corner(f, k, plan) for k in range(3)]
            x = np.array([place for place, _ in three])
            flat = np.cross(x[1] - x[0], x[2] - x[0])
            rows = []
            for _, values in three:
                row = np.array([*flat, 0, 0, 1, 1], float)
                if self.appearance.shade_column is not None:
                    shade = values[self.appearance.shade_column : self.appearance.shade_column + 5]
                    if shade[:3].any():
                        row[:3] = shade[:3]
                    row[5:] = shade[3:]
                if look.uv_column is not None:
                    u, v = values[look.uv_column : look.uv_column + 2]
                    row[3:5] = np.reshape(look.matrix, (2, 3)) @ [u, v, 1]
                rows.append(row)
            corners.append(x)
            at.append(rows)
        count = len(corners)
        return Surface(np.reshape(corners, (count, 3, 3)), np.reshape(at, (count, 3, 7)), self.look[list(faces)])

    # ------------------------------------------------------------------ plans and guards

    def plan(self, gone: int, kept: int) -> Plan | None:
        """The collapse, or None where a guard refuses it."""
        full = self.options.collapse == "full"
        around = self.ring(gone)
        component = self._component(gone)
        if len(component) <= 4:
            joined = any(gone in self.faces[f] and kept in self.faces[f] for f in component)
            return Plan(gone, kept, self.p[kept], component, [], whole=True) if joined else None
        removed = [f for f in around if kept in self.faces[f]]
        before = around + [f for f in self.ring(kept) if f not in around] * full
        plan = Plan(gone, kept, self.p[kept], before, [f for f in before if f not in removed])
        if not removed or not self._keeps_topology(plan, removed) or not self._carry(plan, removed):
            return None
        return None if self._turns(plan) else plan

    def _component(self, v: int) -> list[int]:
        faces = set(self.ring(v))
        while len(faces) <= 4:
            wider = {f for g in faces for u in self.faces[g] for f in self.ring(int(u))}
            if wider == faces:
                break
            faces = wider
        return sorted(faces)

    def _keeps_topology(self, plan: Plan, removed: list[int]) -> bool:
        mine, there = self.neighbours(plan.gone), self.neighbours(plan.kept)
        opposite = [int(v) for f in removed for v in self.faces[f] if v not in (plan.gone, plan.kept)]
        for v in set(mine) & set(there):
            if mine[v] + there[v] - 2 * opposite.count(v) > max(2, mine[v], there[v]):
                return False
            if self.options.keep_topology and v not in opposite:
                return False
        open_ends = 1 in mine.values() and 1 in there.values()
        return not self.options.keep_topology or len(removed) == 1 or not open_ends

    def _carry(self, plan: Plan, removed: list[int]) -> bool:
        """Fills plan.wedges, and the place of a full-edge collapse. False if a seam would tear."""

        def of(faces: list[int], v: int) -> list[int]:
            return [int(self.wedges[f][self.faces[f] == v][0]) for f in faces]

        kept = list(dict.fromkeys(of(self.ring(plan.kept), plan.kept)))
        rows = list(dict.fromkeys(kept + of(self.ring(plan.gone), plan.gone)))
        group = {w: {w} for w in rows}
        for f in removed:
            joined = group[of([f], plan.gone)[0]] | group[of([f], plan.kept)[0]]
            group.update(dict.fromkeys(joined, joined))
        groups = [[w for w in rows if w in g] for g in {frozenset(g): None for g in group.values()}]
        if self.options.collapse == "full":
            self._place(plan, groups, kept)
            return True
        for members in groups:
            own = [w for w in members if w in kept]
            if len(own) > 1 or (not own and not self.options.cross_seams):
                return False
            for w in members:
                if w not in own:
                    plan.wedges[w] = (own[0], self.values[own[0]]) if own else (w, self._extended(plan, w))
        return True

    def _extended(self, plan: Plan, wedge: int) -> F64:
        """UVs as the linear functions over the wedge's faces have them at the place of `kept`, the mean by area."""
        columns = {look.uv_column for look in self.appearance.looks} | {self.appearance.uv_column}
        values: F64 = self.values[wedge].copy()
        total = 0.0
        sums: F64 = np.zeros_like(values)
        for f in plan.after:
            at = np.flatnonzero(self.faces[f] == plan.gone)
            if not len(at) or self.wedges[f, at[0]] != wedge:
                continue
            x = self.p[self.faces[f]] - self.p[plan.kept]
            normal = np.cross(x[1] - x[0], x[2] - x[0])
            square = float(normal @ normal)
            if not square > 0:
                continue
            share = np.array([np.cross(x[(j + 1) % 3], x[(j + 2) % 3]) @ normal / square for j in range(3)])
            share = np.clip(share, -8, 8)
            if abs(share.sum()) > 0.1:
                total += np.sqrt(square)
                sums += np.sqrt(square) * (share / share.sum()) @ self.values[self.wedges[f]]
        for column in columns:
            if total > 0 and column is not None:
                values[column : column + 2] = sums[column : column + 2] / total
        return values

    def _turns(self, plan: Plan) -> bool:
        least = np.cos(np.radians(self.options.flip_degrees)) if self.options.flip_degrees < 90 else 0.0
        for f in plan.after:
            old = self.p[self.faces[f]]
            new = np.array([self._corner(f, k, plan)[0] for k in range(3)])
            longest, longest_before = (max(((np.roll(x, -1, 0) - x) ** 2).sum(axis=1)) for x in (new, old))
            n, m = (np.cross(x[1] - x[0], x[2] - x[0]) for x in (old, new))
            before, after = np.linalg.norm(n), np.linalg.norm(m)
            if not before > 1e-12 * longest_before:
                continue
            if not n @ m > least * before * after:
                return True
            if after < SLIVER * longest and after * longest_before < 0.5 * before * longest:
                return True
        return False

    # ------------------------------------------------------------------ placement: Garland & Heckbert 1998

    def _point(self, face: int, k: int) -> F64:
        uv = np.zeros(2)
        if self.uv_scale > 0:
            column = self.appearance.uv_column or 0
            uv = self.uv_scale * self.values[self.wedges[face, k], column : column + 2]
        return np.concatenate([self.p[self.faces[face, k]], uv])

    def _wedge_quadrics(self) -> dict[int, tuple[F64, F64]]:
        """(A, b) in R⁵ of each wedge."""
        out = {w: (np.zeros((5, 5)), np.zeros(5)) for w in range(len(self.values))}
        areas = np.linalg.norm(self._area_vectors(range(len(self.faces))), axis=1)
        for f, area in enumerate(areas):
            p, q, r = (self._point(f, k) for k in range(3))
            if not (q != p).any():
                continue
            e1 = (q - p) / np.linalg.norm(q - p)
            rest = r - p - (e1 @ (r - p)) * e1
            if not np.linalg.norm(rest) > 0:
                continue
            e2 = rest / np.linalg.norm(rest)
            A = np.eye(5) - np.outer(e1, e1) - np.outer(e2, e2)
            b = (p @ e1) * e1 + (p @ e2) * e2 - p
            for w in self.wedges[f]:
                out[int(w)] = (out[int(w)][0] + A * area / 3, out[int(w)][1] + b * area / 3)
        return out

    def _holding_quadrics(self) -> dict[int, tuple[F64, F64]]:
        """(A, b) in R³ of the planes that hold open borders (0.5) and seams (0.03), × squared edge length."""
        out = {v: (np.zeros((3, 3)), np.zeros(3)) for v in range(len(self.p))}
        edges: dict[tuple[int, int], list[int]] = {}
        for f, face in enumerate(self.faces.tolist()):
            for k in range(3):
                edges.setdefault((min(face[k], face[k - 1]), max(face[k], face[k - 1])), []).append(f)
        for (v, u), faces in edges.items():
            pairs = {tuple(int(self.wedges[f][self.faces[f] == x][0]) for x in (v, u)) for f in faces}
            if len(faces) == 2 and len(pairs) == 1:
                continue
            along = self.p[u] - self.p[v]
            weight = (0.5 if len(faces) == 1 else 0.03) * along @ along
            for f in faces:
                across = np.cross(self._area_vectors([f])[0], along)
                if not across.any():
                    continue
                n = across / np.linalg.norm(across)
                for x in (v, u):
                    out[x] = (out[x][0] + weight * np.outer(n, n), out[x][1] - weight * (n @ self.p[v]) * n)
        return out

    def _place(self, plan: Plan, groups: list[list[int]], kept: list[int]) -> None:
        """Minimises the sum of the groups' quadrics over one place and a UV for each, all unknowns at once."""
        p, q = self.p[plan.gone], self.p[plan.kept]
        size = 3 + 2 * len(groups)
        A, b = np.zeros((size, size)), np.zeros(size)
        for v in (plan.gone, plan.kept):
            A[:3, :3] += self.hold[v][0]
            b[:3] += self.hold[v][1]
        for g, members in enumerate(groups):
            at = [0, 1, 2, 3 + 2 * g, 4 + 2 * g]
            for w in members:
                A[np.ix_(at, at)] += self.quadrics[w][0]
                b[at] += self.quadrics[w][1]
        x: F64 = np.linalg.solve(A, -b).astype(float)
        edge = p - q
        if np.linalg.norm(x[:3] - (p + q) / 2) > 2 * np.linalg.norm(edge):  # too far: the best of ends and middle
            options = [self._at(A, b, end) for end in ((p + q) / 2, p, q)]
            x = min(options, key=lambda x: x @ A @ x + 2 * b @ x)
        plan.place = x[:3]
        along = float(np.clip((plan.place - q) @ edge / (edge @ edge), 0, 1))
        for g, members in enumerate(groups):
            ends = [[w for w in members if w not in kept], [w for w in members if w in kept]]
            shares = (along, 1 - along) if all(ends) else (1.0, 1.0)
            values = np.zeros(self.values.shape[1])
            for rows, share in zip(ends, shares, strict=True):
                values += share * self.values[rows].sum(axis=0) / max(len(rows), 1)
            if self.uv_scale > 0 and self.appearance.uv_column is not None:
                column = self.appearance.uv_column
                values[column : column + 2] = x[3 + 2 * g : 5 + 2 * g] / self.uv_scale
            plan.wedges.update(dict.fromkeys(members, (members[0], values)))

    @staticmethod
    def _at(A: F64, b: F64, place: F64) -> F64:
        """All unknowns, the UVs best for the place given."""
        uv = np.linalg.solve(A[3:, 3:], -(b[3:] + A[3:, :3] @ place))
        return np.concatenate([place, uv])

    # ------------------------------------------------------------------ costs

    def cost(self, plan: Plan) -> float:
        """What the plan costs by the options' metric."""
        if self.options.metric == "texture_deviation":
            return self._deviation(plan)
        if self.options.metric == "image":
            return self._image(plan)
        return self._rays(plan)

    def _rays(self, plan: Plan) -> float:
        """Local_Cost (3.4) or Global_Cost (3.5): the sum over viewpoints and rays."""
        vertices = np.unique(self.faces[plan.before])
        center = self.p[vertices].mean(axis=0)
        radius = float(np.linalg.norm(self.p[vertices] - center, axis=1).max())
        vectors = self._area_vectors(plan.before)
        normal, area = vectors.sum(axis=0), float(np.linalg.norm(vectors, axis=1).sum())
        size = float(np.linalg.norm(normal))
        axis = normal / size if size > 1e-12 * area else np.array([0.0, 0, 1])
        samples = np.concatenate([scan_lines(self.p[self.faces[f]], self.step) for f in plan.before])
        before, after = self.surface(plan.before), self.surface(plan.after, plan)
        local = self.options.reference == "previous"
        if local:
            reference = before
        elif self.options.correspondence == "uv":
            rows = sorted(set().union(*(self.sets[f] for f in plan.before)))
            reference = Surface(self.first.corners[rows], self.first.at[rows], self.first.look[rows])
        else:
            reference = self.first
        total = 0.0
        for n, direction in enumerate(hemisphere(self.options.views, axis)):
            origin = center + 2 * radius * direction
            rays = samples - origin
            none, endless = np.zeros(len(rays)), np.full(len(rays), np.inf)
            low, high = (none, endless) if local else within(origin - center, rays, REACH * radius)
            if local or self.first_hits is None or self.options.correspondence == "uv":
                _, hit, weights = intersect(origin, rays, reference.corners, low, high)
            else:
                _, hit, weights = self.first_hits(np.broadcast_to(origin, rays.shape), rays, low, high)
            _, hit_after, weights_after = intersect(origin, rays, after.corners, none, endless)
            one = colours(reference, self.appearance, hit, weights, rays)
            two = colours(after, self.appearance, hit_after, weights_after, rays)
            difference = np.abs(one - two)
            if self.options.penalty == "view":
                top = 1 - (n + 0.5) / self.options.views
                difference[(hit < 0) != (hit_after < 0)] = 0.5 + 0.5 * top
            total += float(difference.sum())
        return total

    def _uv(self, face: int, plan: Plan | None, column: int | None) -> F64:
        column = self.appearance.uv_column if column is None else column
        if column is None:
            return np.zeros((3, 2))
        return np.array([self._corner(face, k, plan)[1][column : column + 2] for k in range(3)])

    def _deviation(self, plan: Plan) -> float:
        """The farthest corner of the boxes that the new faces would have (Cohen et al. 1998, section 6)."""
        if not plan.after:
            corners = self.p[np.unique(self.faces[plan.before])]
            return float(np.linalg.norm(corners - self.p[plan.gone], axis=1).max())
        boxes = [self._box(plan, f) for f in plan.after]
        far = [float(np.linalg.norm(np.maximum(-low, high))) for low, high in boxes]
        return max(*far, self._uncovered(plan))

    def _uncovered(self, plan: Plan) -> float:
        """How far away the vertex that goes was, if the new faces do not cover its UVs any more; else 0."""
        for g in plan.before:
            at = np.flatnonzero(self.faces[g] == plan.gone)
            if not len(at):
                continue
            uv = self._uv(g, None, None)[at[0]]
            same = [self._uv(f, plan, None) for f in plan.after if self.look[f] == self.look[g]]
            if not any(not is_flat(t) and barycentric(uv, t).min() > -1e-4 for t in same):
                return float(np.linalg.norm(self.p[plan.gone] - plan.place))
        return 0.0

    def _box(self, plan: Plan, face: int) -> tuple[F64, F64]:
        now = self._uv(face, plan, None)
        ways = []
        for g in plan.before:
            if self.look[g] != self.look[face]:
                continue
            old = self._uv(g, None, None)
            for uv in common(now, old):
                x = barycentric(uv, old) @ self.p[self.faces[g]]
                y = barycentric(uv, now) @ np.array([self._corner(face, k, plan)[0] for k in range(3)])
                ways += [x - y + self.boxes[g][0], x - y + self.boxes[g][1]]
        if not ways:
            way = self.p[plan.gone] - plan.place
            low, high = self.boxes[face]
            ways = [low, high, low + way, high + way]
        return np.min(ways, axis=0), np.max(ways, axis=0)

    def _image(self, plan: Plan) -> float:
        """By how much the sum of squared differences to the first pictures would grow."""
        rest = [f for f in np.flatnonzero(self.alive).tolist() if f not in plan.before]
        now, then = self.surface([*rest, *plan.before]), self.surface(rest)
        new = self.surface(plan.after, plan)
        then = Surface(*(np.concatenate([getattr(then, n), getattr(new, n)]) for n in ("corners", "at", "look")))
        assert self.pictures is not None
        was, is_ = (((self._pictures(s) - self.pictures) ** 2).sum() for s in (now, then))
        return float(is_ - was)

    def _pictures(self, surface: Surface) -> F64:
        """(20, size²): the luminance of the pictures from the corners of a dodecahedron."""
        used = self.p[np.unique(self.faces)] if not hasattr(self, "radius") else None
        if used is not None:
            self.radius = float(np.linalg.norm(used, axis=1).max())
        phi = (1 + 5**0.5) / 2
        corners = [(i, j, k) for i, j, k in product((-1.0, 1.0), repeat=3)]
        for i, j in product((-1.0, 1.0), repeat=2):
            corners += [(0, i / phi, j * phi), (i / phi, j * phi, 0), (i * phi, 0, j / phi)]
        size = self.options.image_size
        across = ((np.arange(size) + 0.5) / size * 2 - 1) / np.sqrt(3)
        scaled = Surface(surface.corners / self.radius, surface.at, surface.look)
        pictures = []
        for corner in corners:
            origin = 2 * np.array(corner) / np.sqrt(3)
            back = origin / np.linalg.norm(origin)
            right = np.cross([1, 0, 0] if abs(back[0]) < 0.6 else [0, 1, 0], back)
            right /= np.linalg.norm(right)
            up = np.cross(back, right)
            rays = (across[:, None, None] * up + across[None, :, None] * right - back).reshape(-1, 3)
            everything = np.zeros(len(rays)), np.full(len(rays), np.inf)
            _, hit, weights = intersect(origin, rays, scaled.corners, *everything)
            pictures.append(colours(scaled, self.appearance, hit, weights, rays))
        return np.array(pictures)

    # ------------------------------------------------------------------ the loop (section 3.1)

    def apply(self, plan: Plan) -> None:
        """Carries the plan out."""
        sets, boxes = {}, {}
        for f in plan.after:
            column = self.appearance.looks[self.look[f]].uv_column
            now = self._uv(f, plan, column)
            over = [
                g for g in plan.before
                if self.look[g] == self.look[f] and len(common(now, self._uv(g, None, column)))
            ]  # fmt: skip
            sets[f] = set().union(*(self.sets[g] for g in over or plan.before))
            if self.options.metric == "texture_deviation" and self.options.reference == "original":
                boxes[f] = self._box(plan, f)
        for f, joined in sets.items():
            self.sets[f] = joined
        for f, box in boxes.items():
            self.boxes[f] = box
        for f in plan.before:
            self.alive[f] = f in plan.after
        for w, (target, values) in plan.wedges.items():
            self.values[target] = values
            if w != target:
                mine, there = self.quadrics[w], self.quadrics[target]
                self.quadrics[target] = (mine[0] + there[0], mine[1] + there[1])
        for f in plan.after:
            for k in range(3):
                w, v = int(self.wedges[f, k]), int(self.faces[f, k])
                if v in (plan.gone, plan.kept):
                    self.wedges[f, k] = plan.wedges[w][0] if w in plan.wedges else w
                    self.faces[f, k] = plan.kept
        if not plan.whole:
            mine, there = self.hold[plan.gone], self.hold[plan.kept]
            self.hold[plan.kept] = (mine[0] + there[0], mine[1] + there[1])
            self.p[plan.kept] = plan.place

    def candidates(self) -> list[tuple[int, int]]:
        """Half-edges (from, to), or edges with the lower end first."""
        full = self.options.collapse == "full"
        pairs = [(v, u) for v in range(len(self.p)) for u in self.neighbours(v)]
        return [(v, u) for v, u in pairs if not full or u > v]


def simplify(state: State, target: int) -> list[tuple[float, int, int]]:
    """(cost, gone, kept) of the collapses down to `target` faces, the queue evaluated lazily.

    A list stands for the queue: [cost, candidate number, dirty]. Ends early where nothing more is possible.
    """
    pairs = [list(pair) for pair in state.candidates()]
    queue: dict[int, tuple[float, bool]] = {}
    last: dict[int, float] = {}
    for i, (gone, kept) in enumerate(pairs):
        plan = state.plan(gone, kept)
        if plan is not None:
            queue[i] = (state.cost(plan), False)
    done: list[tuple[float, int, int]] = []
    dead: set[int] = set()
    full = state.options.collapse == "full"
    while state.alive.sum() > target and queue:
        i = min(queue, key=lambda i: (queue[i][0], i))
        cost, dirty = queue[i]
        last[i] = cost
        plan = state.plan(*pairs[i]) if set(pairs[i]) <= set(state.faces[state.alive].ravel().tolist()) else None
        if plan is None:
            del queue[i]
            continue
        if dirty:
            queue[i] = (state.cost(plan), False)
            continue
        changed = {int(v) for f in plan.before for v in state.faces[f]} - {plan.gone}
        state.apply(plan)
        done.append((cost, plan.gone, plan.kept))
        live = {tuple(pair) for j, pair in enumerate(pairs) if j not in dead and plan.gone not in pair}
        for j, pair in enumerate(pairs):
            if j in dead or plan.gone not in pair:
                continue
            renamed = [plan.kept if v == plan.gone else v for v in pair]
            renamed = sorted(renamed) if full else renamed
            if renamed[0] == renamed[1] or tuple(renamed) in live or plan.whole:
                dead.add(j)
                queue.pop(j, None)
                continue
            pairs[j] = renamed
            live.add((renamed[0], renamed[1]))
        for j, (gone, kept) in enumerate(pairs):
            if j not in dead and (gone in changed or (full and kept in changed)):
                queue[j] = (queue[j][0] if j in queue else last.get(j, 0.0), True)
    return done
