"""The meshes of an asset that are simplified, as one, in world space; and levels of it as meshes again."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from lodpipe import kernel
from lodpipe.core.asset import Asset, Lod, Target
from lodpipe.core.errors import Cancelled
from lodpipe.core.mesh import F32, F64, I32, Mesh
from lodpipe.core.skeleton import Importance, PartShare
from lodpipe.geometry.distance import distance_between
from lodpipe.geometry.extreme import Guide, extreme_levels
from lodpipe.geometry.flatten import Bool, Soup, flatten, largest_placement
from lodpipe.geometry.parts import hold_shares
from lodpipe.geometry.poses import motion
from lodpipe.geometry.progressive import rebuild
from lodpipe.geometry.rig import carry, is_rig
from lodpipe.geometry.switch import SCREEN_HEIGHT
from lodpipe.geometry.visible import coarsest
from lodpipe.kernel import QuadricOptions
from lodpipe.kernel.similarity import SimilarityOptions
from lodpipe.kernel.tables import unique_rows

MOTION = "motion"
"""How the poses move a vertex, among the attributes while a rigged mesh is simplified (`lodpipe.geometry.poses`)."""
ERROR_SAMPLES = 20_000  # of a measurement while a level is searched for its error


Unseen = Callable[[Asset, float], float]
"""The height in pixels up to which an asset can stand in for the source unseen, looked for up to a height."""

Refine = Callable[[kernel.Level], kernel.Level]
"""What is done to a level after the collapses."""


@dataclass(frozen=True)
class AttributeWeights:
    """What attributes are worth against distance, when they steer (`QuadricOptions.attribute_cost`).

    A weight of 1 prices a texture that slips by a length like a surface that is off by that length; a normal or colour
    that is off by 1 like a surface that is off by the mean edge length of the level asked for. The motion of rigged
    meshes steers always: a weight of 1 prices a vertex that is off by a length, on average over the poses, like one
    that is off by it at rest.
    """

    uv: float = 0.1
    normal: float = 0.05
    color: float = 0.1
    motion: float = 0.4


HIDDEN = 0.05
"""What is never seen from outside counts so much in the visual metric."""


def without_doubles(mesh: Mesh) -> Mesh:
    """The mesh without wedges that repeat another of their position and primitive.

    Some exporters give every corner of every triangle a vertex of its own: an edge between equal ones is no seam.
    """
    rows = len(next(iter(mesh.attributes.values()), ()))
    if rows <= len(mesh.positions):
        return mesh
    place, owner = np.zeros(rows, np.int32), np.zeros(rows, np.int32)
    place[mesh.wedges] = mesh.faces
    owner[mesh.wedges] = mesh.face_primitive[:, None]
    asked = np.flatnonzero((np.bincount(place) > 1)[place])  # the others are alone at their position
    parts = [np.stack([place, owner], axis=1), *mesh.attributes.values()]
    keys = [part[asked] + part.dtype.type(0) for part in parts]  # −0 is 0
    first, row = unique_rows(np.concatenate([key.view(np.uint32) for key in keys], axis=1))
    if len(first) == len(asked):
        return mesh
    stands = np.arange(rows)
    stands[asked] = asked[first][row]
    kept, number = np.unique(stands, return_inverse=True)
    wedges = number.astype(np.int32)[mesh.wedges]
    return replace(mesh, wedges=wedges, attributes={n: v[kept] for n, v in mesh.attributes.items()})


@dataclass(frozen=True, eq=False)
class Joined:
    """The meshes that may be simplified, as one, in world space."""

    used: list[int]  # rows of asset.meshes
    matrices: list[F64]  # (4, 4) for each
    positions: F64
    faces: I32
    wedges: I32
    primitive: I32  # (F,) distinct over all meshes
    importance: F32 | None
    names: list[str]  # of the attributes
    widths: list[int]
    values: F32  # (W, K), unscaled
    vertex_start: list[int]
    wedge_start: list[int]
    face_start: list[int]
    pinned: Bool | None = None  # (V,) vertices that stay

    @staticmethod
    def of(asset: Asset) -> Joined:
        used = [i for i, m in enumerate(asset.meshes) if not m.keep_reason and len(m.faces)]
        places: dict[int, list[F64]] = {}
        for index, matrix in asset.instances():
            places.setdefault(index, []).append(matrix)
        matrices = [largest_placement(places.get(i, [])) for i in used]
        meshes = {i: _with_motion(asset, i, matrix) for i, matrix in zip(used, matrices, strict=True)}
        names = list(dict.fromkeys(name for mesh in meshes.values() for name in mesh.attributes))
        widths = [max(_width(mesh, name) for mesh in meshes.values()) for name in names]
        positions, faces, wedges, values, importance, primitive = [], [], [], [], [], []
        vertices = corners = primitives = 0
        vertex_start, wedge_start, face_start = [0], [0], [0]
        for i, matrix in zip(used, matrices, strict=True):
            mesh = meshes[i]
            positions.append(_placed(mesh, matrix))
            faces.append(mesh.faces + np.int32(vertices) if vertices else mesh.faces)
            own, rows = _wedges(mesh)
            wedges.append(own + np.int32(corners) if corners else own)
            values.append(_attribute_table(mesh, names, widths, rows))
            placed = np.full(len(mesh.positions), max(len(places.get(i, [])), 1), np.float32)
            importance.append(placed * asset.importance.weight[i] if asset.importance else placed)
            primitive.append(mesh.face_primitive + np.int32(primitives))
            primitives += len(mesh.primitives)
            vertices += len(mesh.positions)
            corners += rows
            vertex_start.append(vertices)
            wedge_start.append(corners)
            face_start.append(face_start[-1] + len(mesh.faces))
        weight = np.concatenate(importance) if importance else np.empty(0, np.float32)
        return Joined(
            used,
            matrices,
            _join(positions, 3, np.float64),
            _join(faces, 3, np.int32),
            _join(wedges, 3, np.int32),
            np.concatenate([np.empty(0, np.int32), *primitive]),
            weight if weight.size and (weight != 1).any() else None,
            names,
            widths,
            _join(values, sum(widths), np.float32),
            vertex_start,
            wedge_start,
            face_start,
            _pinned(asset, used),
        )

    @property
    def moves(self) -> bool:
        """Whether a mesh is rigged."""
        return MOTION in self.names

    @property
    def chart_column(self) -> int | None:
        """Where TEXCOORD_0 begins."""
        if "TEXCOORD_0" not in self.names:
            return None
        return sum(self.widths[: self.names.index("TEXCOORD_0")])

    def columns(self, options: QuadricOptions, weights: AttributeWeights, finest: int) -> tuple[F32, list[float]]:
        """The attribute table as the kernel takes it, and what a unit of each column is worth."""
        if not options.attribute_cost or not len(self.faces):
            steering = [weights.motion if name == MOTION else 0.0 for name in self.names]
            return self.values, np.repeat(steering, self.widths).tolist()
        corners = self.positions[self.faces]
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        edge = float(np.sqrt(areas.sum() / 2 / finest))
        out: list[float] = []
        start = 0
        for name, width in zip(self.names, self.widths, strict=True):
            table = self.values[:, start : start + width]
            start += width
            worth = 0.0
            if name == MOTION:
                worth = weights.motion
            elif name == "NORMAL":
                worth = weights.normal * edge
            elif name == "COLOR_0":
                worth = weights.color * edge
            elif name.startswith("TEXCOORD_"):
                uv = table[self.wedges].astype(np.float64)
                a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
                flat = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
                has = flat > 0  # other meshes may have no UVs
                worth = weights.uv * float(np.sqrt(areas[has].sum() / flat[has].sum())) if has.any() else 0.0
            out += [worth] * width
        return self.values, out

    @cached_property
    def real_seams(self) -> F32 | None:
        """(F, 3) float32: 0 for the edge k → k + 1 between two facets that differ in nothing but their directions, else
        1; None: 1 throughout.

        A facet is a triangle with the same normal at its corners. Where two meet, the shape has an edge, which its
        planes hold; on a flat-shaded mesh all edges are such, and as seams they would hold every vertex where it is.
        """
        turned = ("NORMAL", "TANGENT", MOTION)
        if "NORMAL" not in self.names or len(self.values) <= len(self.positions):
            return None
        at = sum(self.widths[: self.names.index("NORMAL")])
        normals = self.values[:, at : at + 3][self.wedges]
        facet = (np.abs(normals[:, 1:] - normals[:, :1]) < 0.01).all(axis=(1, 2))
        if not facet.any():
            return None
        place, owner = (np.zeros(len(self.values), np.int32) for _ in range(2))
        place[self.wedges] = self.faces
        owner[self.wedges] = self.primitive[:, None]
        keep = np.repeat([name not in turned for name in self.names], self.widths)
        bits = np.ascontiguousarray(self.values[:, keep] + np.float32(0)).view(np.uint32)
        first, row = unique_rows(np.concatenate([np.stack([place, owner], axis=1).view(np.uint32), bits], axis=1))
        if len(first) == len(row):
            return None
        ends = row[self.wedges]
        pairs = np.sort(np.stack([ends, np.roll(ends, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
        _, edge = unique_rows(pairs.view(np.uint32))
        count = np.bincount(edge)
        smooth = np.bincount(edge, np.repeat(~facet, 3))  # faces round an edge that are no facets
        held: F32 = ((count == 1) | (smooth > 0))[edge].reshape(ends.shape).astype(np.float32)
        return held if not held.all() else None

    def from_soup(self, asset: Asset, soup: Soup, rows: F32) -> F32:
        """Rows for the joined faces, from rows for the soup's: of the first placement of each mesh; 0 for none."""
        out = np.zeros((len(self.faces), *rows.shape[1:]), np.float32)
        first = {id(part.mesh): part for part in reversed(soup.parts)}
        for number, index in enumerate(self.used):
            part = first.get(id(asset.meshes[index]))
            if part is None:
                continue
            own = rows[part.first_face : part.first_face + len(part.mesh.faces)]
            if part.mirrored:  # corners 2, 1, 0: the edges 0 → 1, 1 → 2, 2 → 0 are those from 1, 0, 2
                own = own[:, [1, 0, 2]]
            out[self.face_start[number] : self.face_start[number + 1]] = own
        return out

    def seen(self, shares: list[F32]) -> Joined:
        """The same with vertices weighted by the share of them that is seen from outside."""
        share = np.concatenate([shares[i] for i in self.used]) if self.used else np.empty(0, np.float32)
        weight = (HIDDEN + (1 - HIDDEN) * share).astype(np.float32)
        return replace(self, importance=weight if self.importance is None else weight * self.importance)

    def at_vertices(self, edges: F32) -> F32:
        """(V,) the largest of the rows (F, 3) of the edges k → k + 1 that end at each vertex."""
        out = np.zeros(len(self.positions), np.float32)
        rows = np.flatnonzero(edges.any(axis=1))
        np.maximum.at(out, self.faces[rows], edges[rows])
        np.maximum.at(out, np.roll(self.faces[rows], -1, axis=1), edges[rows])
        return out

    def fit(self, level: kernel.Level, held: F32 | None, threads: int, cancelled: Callable[[], bool]) -> kernel.Level:
        """The level with positions and values that fit the source best; `held` as `kernel.fit` takes it."""
        count = len(level.faces)
        if not count:
            return level
        fitted = kernel.fit(
            self.positions,
            self.faces,
            self.wedges,
            self.values,
            level,
            samples=max(24 * count, 2000),
            chart_column=self.chart_column,
            importance=self.importance,
            held=held,
            threads=threads,
            go_on=lambda: not cancelled(),
        )
        if self.pinned is not None:
            rows = np.flatnonzero(self.pinned)
            places = fitted.positions.copy()
            places[level.vertex_to[rows]] = self.positions[rows]
            fitted = replace(fitted, positions=places)
        return fitted

    def with_shares(
        self,
        shares: Sequence[PartShare],
        levels: Sequence[kernel.Level],
        run: Callable[[F32 | None, list[int]], kernel.Decimation],
    ) -> list[kernel.Level]:
        """The levels with parts that keep their shares (see `lodpipe.geometry.parts`)."""
        masks = [np.concatenate([s.faces[i] for i in self.used]) for s in shares]
        factors = np.ones(len(self.positions), np.float32) if self.importance is None else self.importance
        return hold_shares(self.faces, levels, [(s.keep, m) for s, m in zip(shares, masks, strict=True)], factors, run)

    def recognisable(
        self,
        importance: Importance,
        plain: Sequence[kernel.Level],
        options: QuadricOptions | SimilarityOptions,
        threads: int,
    ) -> dict[int, kernel.Level]:
        """Those of the levels that the skeleton makes better (see `lodpipe.geometry.extreme`), by target."""
        quadric = options if isinstance(options, QuadricOptions) else QuadricOptions(keep_last=options.keep_last)
        quadric = replace(
            quadric,
            attribute_cost=False,
            record=False,
            follow=self.moves,
            keep_topology=True,
            may_relax=False,
            chart_column=self.chart_column,
        )

        def run(factors: F64, locked: Any, targets: list[int]) -> Sequence[kernel.Level]:
            own = factors if self.importance is None else factors * self.importance
            return kernel.decimate(
                self.positions,
                self.faces,
                targets,
                quadric,
                wedges=self.wedges,
                values=self.values,
                column_weights=[0.0] * self.values.shape[1],
                importance=own.astype(np.float32),
                locked=locked if self.pinned is None else self.pinned if locked is None else locked | self.pinned,
                threads=threads,
            ).levels

        first = dict(zip(self.used, self.vertex_start, strict=False))
        tips = [
            first[mesh] + row
            for mesh, row in zip(importance.reserved_mesh.tolist(), importance.reserved[:, 0].tolist(), strict=True)
            if mesh in first
        ]
        extreme = np.concatenate([importance.extreme[index] for index in self.used]).astype(np.float64)
        guide = Guide(extreme, np.array(tips, np.int64), importance.strength)
        return extreme_levels(self.positions, self.faces, plain, guide, run)

    def lod(self, asset: Asset, level: kernel.Level, goal: Target, reason: str) -> Lod:
        meshes = list(asset.meshes)
        owner = np.searchsorted(self.face_start, level.face_source, side="right") - 1
        order = np.argsort(owner, kind="stable") if len(self.used) > 1 else np.arange(len(owner))
        bounds = np.searchsorted(owner[order], np.arange(len(self.used) + 1))
        for number, index in enumerate(self.used):
            rows = order[bounds[number] : bounds[number + 1]]
            meshes[index] = self._mesh(asset.meshes[index], number, level, rows)
        span = self.positions.max(axis=0) - self.positions.min(axis=0) if len(self.positions) else np.ones(3)
        estimate = 100 * level.error / max(float(np.linalg.norm(span)), 1e-300)
        return Lod(meshes=tuple(meshes), target=goal, stop_reason=reason, estimate=estimate, relaxed=level.relaxed)

    def _mesh(self, source: Mesh, number: int, level: kernel.Level, mine: Any) -> Mesh:
        """The part of the level (rows `mine` of its faces) that came from one mesh, in that mesh's own space."""
        origin = level.face_source[mine] - self.face_start[number]
        vertices: Any
        faces: Any
        rows: Any
        wedges: Any
        if len(self.used) == 1:  # the level's own numbers have no gaps
            vertices, faces = np.arange(len(level.positions)), level.faces
            rows, wedges = np.arange(len(level.values)), level.wedges
        else:
            vertices, faces = np.unique(level.faces[mine], return_inverse=True)
            rows, wedges = np.unique(level.wedges[mine], return_inverse=True)
        matrix = self.matrices[number]
        old = level.vertex_source[vertices] - self.vertex_start[number]
        # where parts were joined (`pair_distance`), a vertex that did not move may be one of another mesh
        moved = (old < 0) | (old >= len(source.positions)) | (level.vertex_source[vertices] < 0)
        positions = np.empty((len(vertices), 3))
        positions[~moved] = source.positions[old[~moved]]
        if moved.any():
            back = np.linalg.inv(matrix[:3, :3])
            positions[moved] = (level.positions[vertices[moved]] - matrix[:3, 3]) @ back.T
        changed = level.wedge_source[rows] < 0
        rig = self._rig(source, number, level, positions, np.where(moved, -1, old), vertices, rows, faces, wedges)
        attributes: dict[str, F32] = {}
        start = 0
        for name, width in zip(self.names, self.widths, strict=True):
            if name in source.attributes:
                table = level.values[rows, start : start + source.attributes[name].shape[1]]
                attributes[name] = _valid(name, table, changed, source.attributes[name])
            start += width
        attributes = {name: attributes[name] if name in attributes else rig[name] for name in source.attributes}
        return Mesh(
            positions=positions,
            faces=faces.reshape(-1, 3).astype(np.int32),
            wedges=wedges.reshape(-1, 3).astype(np.int32) if attributes else faces.reshape(-1, 3).astype(np.int32),
            attributes=attributes,
            face_primitive=source.face_primitive[origin],
            primitives=source.primitives,
            name=source.name,
        )

    def _rig(
        self,
        source: Mesh,
        number: int,
        level: kernel.Level,
        positions: F64,
        old: I32,
        vertices: Any,
        rows: Any,
        faces: Any,
        wedges: Any,
    ) -> dict[str, F32]:
        """The joints, weights and targets of the part of a level that came from one mesh."""
        if not any(is_rig(name) for name in source.attributes):
            return {}
        vertex_of = np.empty(len(rows), np.int32)
        vertex_of[wedges.ravel()] = faces.ravel()
        first = self.vertex_start[number]
        vertex_to = _local(level.vertex_to[first : first + len(source.positions)], vertices)
        count = len(next(iter(source.attributes.values())))
        first = self.wedge_start[number]
        wedge_to = _local(level.wedge_to[first : first + count], rows)
        wedge_old = np.where(old[vertex_of] < 0, -1, level.wedge_source[rows] - first).astype(np.int32)
        return carry(source, positions, old.astype(np.int32), vertex_to, vertex_of, wedge_old, wedge_to)

    def search_error(
        self,
        asset: Asset,
        goal: Target,
        result: kernel.Decimation,
        refine: Refine,
        cancelled: Callable[[], bool],
    ) -> Lod:
        """The coarsest level whose measured distance to the source is within the goal, by bisection of the record."""
        assert goal.error is not None
        reference = flatten(asset)
        high, low = len(self.faces), 0
        best: Lod | None = None
        while high - low > max(1, high // 100):
            if cancelled():
                raise Cancelled("cancelled")
            middle = (high + low) // 2
            lod = self.rebuilt(asset, goal, result, middle, "error", refine)
            soup = flatten(asset, lod.meshes)
            within = len(soup.faces) > 0 and distance_between(reference, soup, ERROR_SAMPLES).max <= goal.error
            if within:
                high, best = min(middle, lod.triangles), lod
            else:
                low = middle
        return best or Lod(meshes=asset.meshes, target=goal, stop_reason="error")

    def search_pixels(
        self,
        asset: Asset,
        goals: Sequence[Target],
        result: kernel.Decimation,
        unseen: Unseen,
        refine: Refine,
        cancelled: Callable[[], bool],
    ) -> dict[Target, Lod]:
        """For each goal the coarsest level of the record that shows no more pixels of difference than it allows."""
        known = {len(self.faces): math.inf}
        made: dict[Target, Lod] = {}
        for goal in goals:
            assert goal.pixels is not None and goal.screen is not None
            height = goal.screen * SCREEN_HEIGHT / goal.pixels

            def found(number: int, height: float = height, goal: Target = goal) -> float:
                if cancelled():
                    raise Cancelled("cancelled")
                return unseen(asset.at(self.rebuilt(asset, goal, result, number, "pixels", refine)), height)

            number = coarsest(found, height, known)
            if number == len(self.faces):
                made[goal] = Lod(meshes=asset.meshes, target=goal, stop_reason="pixels")
            else:
                made[goal] = self.rebuilt(asset, goal, result, number, "pixels", refine)
        return made

    def rebuilt(
        self, asset: Asset, goal: Target, result: kernel.Decimation, triangles: int, reason: str, refine: Refine
    ) -> Lod:
        """The level of at most so many triangles, from the record, refined."""
        assert result.record is not None  # decimate_asset asked for it
        level = rebuild(self.positions, self.faces, self.wedges, self.values, result.record, triangles)
        return self.lod(asset, refine(level), goal, reason)


def _pinned(asset: Asset, used: list[int]) -> Bool | None:
    if asset.importance is None or not asset.importance.pinned or not used:
        return None
    return np.concatenate([asset.importance.pinned[index] for index in used])


def _placed(mesh: Mesh, matrix: F64) -> F64:
    return mesh.positions if np.array_equal(matrix, np.eye(4)) else mesh.positions @ matrix[:3, :3].T + matrix[:3, 3]


def _with_motion(asset: Asset, row: int, matrix: F64) -> Mesh:
    """The mesh with MOTION, at least one column of it, in place of its rig's attributes."""
    mesh = asset.meshes[row]
    if not any(is_rig(name) for name in mesh.attributes):
        return mesh
    moved = motion(asset, row, _placed(mesh, matrix))
    table = np.zeros((len(next(iter(mesh.attributes.values()))), max(moved.shape[1], 1)), np.float32)
    if moved.shape[1]:
        table[mesh.wedges] = moved[mesh.faces]
    return replace(mesh, attributes={n: v for n, v in mesh.attributes.items() if not is_rig(n)} | {MOTION: table})


def _local(target: I32, chosen: I32) -> I32:
    """Rows of a level as rows of `chosen`, which ascends; −1 for those that are not in it."""
    if not len(target) or not len(chosen):
        return np.full(len(target), -1, np.int32)
    row = np.minimum(np.searchsorted(chosen, target), len(chosen) - 1)
    return np.where(chosen[row] == target, row, -1).astype(np.int32)


def _width(mesh: Mesh, name: str) -> int:
    return mesh.attributes[name].shape[1] if name in mesh.attributes else 0


def _wedges(mesh: Mesh) -> tuple[I32, int]:
    """Wedge rows and their number; a mesh without attributes gets one wedge for each position and primitive."""
    for table in mesh.attributes.values():
        return mesh.wedges, len(table)
    if len(mesh.primitives) == 1:
        return mesh.faces, len(mesh.positions)
    count = len(mesh.positions)
    keys = mesh.faces.astype(np.int64) + mesh.face_primitive[:, None].astype(np.int64) * count
    _, rows = np.unique(keys, return_inverse=True)
    return rows.reshape(-1, 3).astype(np.int32), int(rows.max(initial=-1)) + 1


def _attribute_table(mesh: Mesh, names: list[str], widths: list[int], rows: int) -> F32:
    if list(mesh.attributes) == names and len(names) == 1:
        return mesh.attributes[names[0]]
    table = np.zeros((rows, sum(widths)), np.float32)
    start = 0
    for name, width in zip(names, widths, strict=True):
        if name in mesh.attributes:
            values = mesh.attributes[name]
            table[:, start : start + values.shape[1]] = values
        start += width
    return table


def _join(tables: list[Any], columns: int, dtype: Any) -> Any:
    if len(tables) == 1:
        return np.ascontiguousarray(tables[0], dtype)
    if not tables:
        return np.empty((0, columns), dtype)
    return np.ascontiguousarray(np.concatenate(tables), dtype)


def _valid(name: str, values: F32, changed: Any, source: F32) -> F32:
    """New values as the attribute must be: unit normals and tangents, colours within 0…1, a user's own (`_NAME`) within
    the range that they had: new values are extrapolated where a vertex moves off the surface."""
    out = values.copy()
    if name in ("NORMAL", "TANGENT"):
        axes = out[changed, :3]
        length = np.linalg.norm(axes, axis=1, keepdims=True)
        out[changed, :3] = np.where(length > 1e-12, axes / np.maximum(length, 1e-12), [0, 0, 1])
        if name == "TANGENT":
            out[changed, 3] = np.where(out[changed, 3] < 0, -1, 1)
    elif name.startswith("COLOR_"):
        out[changed] = np.clip(out[changed], 0, 1)
    elif name.startswith("_") and len(source):
        out[changed] = np.clip(out[changed], source.min(axis=0), source.max(axis=0))
    return out
