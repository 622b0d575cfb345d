"""The surface that is baked from: where it lies beside a coarser one, and what is seen there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from lodpipe.core.mesh import F32, F64, I32, Mesh
from lodpipe.geometry.bake_segments import CORNERS, SegmentFilter, asked
from lodpipe.geometry.flatten import Bool
from lodpipe.geometry.normals import crease_normals, unit
from lodpipe.geometry.slots import Slot
from lodpipe.geometry.tangents import corner_tangents

if TYPE_CHECKING:
    from lodpipe.o3d import RayScene

FACING = 0.1
"""Least cosine between the normals of two surfaces that are taken for the same."""


@dataclass(frozen=True, eq=False)
class Found:
    """Places on the source: faces (N,) int32 rows of its mesh's faces, weights (N, 3) float32 barycentric, and missed
    (N,) bool: nothing that faces the same way lay within the distance, so that the closest point stands in."""

    faces: I32
    weights: F32
    missed: Bool


class SourceMesh:
    """One mesh of the source in its own space, made ready for look-ups; `segments` (V,) int32 if it has any."""

    def __init__(self, mesh: Mesh, threads: int = 0, segments: I32 | None = None) -> None:
        self.mesh = mesh
        self._filter = None if segments is None or segments.max(initial=-1) < 1 else SegmentFilter(mesh, segments)
        self._threads = threads
        low = mesh.positions[mesh.faces].min(axis=(0, 1))
        high = mesh.positions[mesh.faces].max(axis=(0, 1))
        self.centre = (low + high) / 2
        self.scale = float(np.linalg.norm(high - low)) or 1.0
        self._scenes: dict[bytes, tuple[RayScene, I32]] = {}

    def find(self, points: F64, normals: F64, reach: float, allowed: Bool) -> Found:
        """Where the source lies beside `points` (N, 3) of a surface with unit `normals` (N, 3).

        Rays go out both ways along the normal, up to `reach`; the nearer hit whose face looks the same way counts.
        Without one it is the closest point, under the same conditions; without that, the closest point whatever it is.
        Only faces of `allowed` (F,) are looked at.
        """
        scene, rows = self._scene(allowed)
        start = ((points - self.centre) / self.scale).astype(np.float32)
        towards = normals.astype(np.float32)
        limit = np.float32(reach / self.scale)
        count = len(points)
        faces, weights = np.full(count, -1, np.int32), np.zeros((count, 3), np.float32)
        best = np.full(count, np.inf, np.float32)
        for sign in (1, -1):
            # from just behind the surface, so that one that lies on it is met by one of the two
            hits = scene.cast(start - sign * towards * np.float32(1e-5), sign * towards)
            good = np.flatnonzero((hits.faces >= 0) & (hits.distance <= np.minimum(limit, best)))
            cosine = np.einsum("nd,nd->n", self._face_normals[rows[hits.faces[good]]], towards[good])
            good = good[cosine > FACING]
            faces[good], best[good] = rows[hits.faces[good]], hits.distance[good]
            u, v = hits.uv[good].T
            weights[good] = np.stack([1 - u - v, u, v], axis=1)
        rest = np.flatnonzero(faces < 0)
        missed = np.zeros(count, bool)
        if len(rest):
            near, near_faces = scene.closest(start[rest])
            near_faces = rows[near_faces]
            away = near - start[rest]
            far = np.einsum("nd,nd->n", away, away) > limit * limit
            turned = np.einsum("nd,nd->n", self._face_normals[near_faces], towards[rest]) <= FACING
            faces[rest], missed[rest] = near_faces, far | turned
            weights[rest] = self._barycentric(near_faces, near)
        return Found(faces, weights, missed)

    def segments_of(self, level: Mesh) -> I32:
        """(F,) the segment of each face of a level, −1 for all without segments."""
        if self._filter is None:
            return np.full(len(level.faces), -1, np.int32)
        scene, rows = self._scene(np.ones(len(self.mesh.faces), bool))
        points = ((asked(level) - self.centre) / self.scale).astype(np.float32)
        return self._filter.labels(rows[scene.closest(points)[1]].reshape(-1, len(CORNERS)))

    def allowed(self, material: int, segment: int) -> Bool:
        """(F,) the faces that a level's face of that material and segment may show: all where none may."""
        alike: Bool = self.mesh.face_material == material
        if self._filter is not None and segment >= 0 and (near := alike & self._filter.allowed(segment)).any():
            return near
        return alike if alike.any() else np.ones(len(alike), bool)

    def points(self, found: Found) -> F64:
        """(N, 3) where the places lie."""
        points: F64 = np.einsum("nkd,nk->nd", self.mesh.positions[self.mesh.faces[found.faces]], found.weights)
        return points

    def blended(self, name: str, found: Found) -> F32 | None:
        """(N, K) the attribute at the places, None if the mesh has none of it."""
        values = self.mesh.attributes.get(name)
        return None if values is None else self._blend(values[self.mesh.wedges[found.faces]], found.weights)

    def sample(self, slot: Slot, found: Found, texel: F64) -> F32 | None:
        """Linear RGBA (N, 4) of a slot; `texel` (N,) is the width in space of what is looked at. None without UVs."""
        values = self.mesh.attributes.get(slot.uv_name)
        if values is None:
            return None
        corners = slot.place(values[:, :2].astype(np.float64)[self.mesh.wedges[found.faces]])
        uv = np.einsum("nkd,nk->nd", corners, found.weights)
        density = self._density(slot, corners, found.faces)
        seen = slot.sample(uv, (texel * density).astype(np.float32))
        has = np.array([slot.uv_name in p.attributes for p in self.mesh.primitives])
        if not has.all():
            seen[~has[self.mesh.face_primitive[found.faces]]] = (0.5, 0.5, 1.0, 1.0) if slot.is_normal else 1.0
        return seen

    def normals(self, found: Found, slot: Slot | None, texel: F64) -> F32:
        """(N, 3) float32 unit shading normals, bent by the normal map of `slot` if there is one."""
        smooth = unit(self._blend(self.corner_normals[found.faces], found.weights).astype(np.float64))
        if slot is None:
            return smooth.astype(np.float32)
        seen = self.sample(slot, found, texel)
        if seen is None:
            return smooth.astype(np.float32)
        bent = seen[:, :3].astype(np.float64) * 2 - 1
        bent[:, :2] *= slot.strength
        frame = self._blend(self._tangents(slot.uv_name)[found.faces], found.weights).astype(np.float64)
        tangent = unit(frame[:, :3])
        bitangent = unit(np.cross(smooth, tangent)) * np.where(frame[:, 3:] < 0, -1.0, 1.0)
        result = tangent * bent[:, :1] + bitangent * bent[:, 1:2] + smooth * bent[:, 2:]
        return unit(result).astype(np.float32)

    @cached_property
    def corner_normals(self) -> F32:
        """(F, 3, 3): the file's normals, else made from the faces."""
        given = self.mesh.attributes.get("NORMAL")
        has = np.array(["NORMAL" in p.attributes for p in self.mesh.primitives])[self.mesh.face_primitive]
        if given is not None and has.all():
            return given[self.mesh.wedges]
        made = crease_normals(self.mesh.positions, self.mesh.faces)
        if given is not None and has.any():
            made[has] = given[self.mesh.wedges[has]]
        return made

    @cached_property
    def _face_normals(self) -> F32:
        corners = self.mesh.positions[self.mesh.faces]
        return unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])).astype(np.float32)

    @cached_property
    def _areas(self) -> F64:
        corners = self.mesh.positions[self.mesh.faces]
        areas: F64 = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        return areas

    @cached_property
    def _frames(self) -> dict[str, F32]:
        return {}

    def _tangents(self, uv_name: str) -> F32:
        """(F, 3, 4): the file's tangents, else MikkTSpace of that UV set."""
        if uv_name not in self._frames:
            given = self.mesh.attributes.get("TANGENT")
            if given is not None and uv_name == "TEXCOORD_0":
                self._frames[uv_name] = given[self.mesh.wedges]
            else:
                uv = self.mesh.attributes[uv_name][:, :2][self.mesh.wedges]
                self._frames[uv_name] = corner_tangents(self.mesh.positions, self.mesh.faces, self.corner_normals, uv)
        return self._frames[uv_name]

    def _density(self, slot: Slot, corners: F64, faces: I32) -> F64:
        """(N,) texels to a unit of length on the faces whose placed UVs are `corners`."""
        sides = (corners[:, 1:] - corners[:, :1]) * [slot.texture.width, slot.texture.height]
        doubled = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
        return np.sqrt(doubled / np.maximum(self._areas[faces], 1e-300))

    def _scene(self, allowed: Bool) -> tuple[RayScene, I32]:
        from lodpipe.o3d import RayScene

        key = np.packbits(allowed).tobytes()
        if key not in self._scenes:
            rows = np.flatnonzero(allowed & (self._areas > 0)).astype(np.int32)
            positions = ((self.mesh.positions - self.centre) / self.scale).astype(np.float32)
            self._scenes[key] = RayScene(positions, self.mesh.faces[rows], self._threads), rows
        return self._scenes[key]

    def _barycentric(self, faces: I32, points: F32) -> F32:
        """(N, 3) of `points`, in the scene's coordinates, that lie in `faces`."""
        corners = (self.mesh.positions[self.mesh.faces[faces]] - self.centre) / self.scale
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        p = points - corners[:, 0]
        aa, ab, bb = (np.einsum("nd,nd->n", *pair) for pair in ((a, a), (a, b), (b, b)))
        pa, pb = np.einsum("nd,nd->n", p, a), np.einsum("nd,nd->n", p, b)
        determinant = np.maximum(aa * bb - ab * ab, 1e-300)
        v = np.clip((bb * pa - ab * pb) / determinant, 0, 1)
        w = np.clip((aa * pb - ab * pa) / determinant, 0, 1)
        total = np.maximum(v + w, 1.0)
        v, w = v / total, w / total
        return np.stack([1 - v - w, v, w], axis=1).astype(np.float32)

    @staticmethod
    def _blend(corners: F32, weights: F32) -> F32:
        blended: F32 = np.einsum("nkd,nk->nd", corners, weights)
        return blended
