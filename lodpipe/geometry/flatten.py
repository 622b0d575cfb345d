"""An asset's placed meshes as one list of triangles in world space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.asset import Asset
from lodpipe.core.errors import InvalidMesh
from lodpipe.core.mesh import F32, F64, I32, Mesh

Bool = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Part:
    """One placement of a mesh: its 4×4 world matrix and the first of its rows in the soup's faces."""

    mesh: Mesh
    matrix: F64
    first_face: int

    @property
    def mirrored(self) -> bool:
        """Whether the matrix turns the mesh inside out, so that its faces are wound the other way round."""
        return bool(np.linalg.det(self.matrix[:3, :3]) < 0)


@dataclass(frozen=True, eq=False)
class Soup:
    """All placed triangles of an asset in world space.

    positions      (V, 3) float64
    faces          (F, 3) int32, rows of `positions`; counter-clockwise from outside, under mirroring matrices too
    face_material  (F,) int32, rows of `Asset.materials`, −1 for the default material
    parts          where the faces came from, in order
    """

    positions: F64
    faces: I32
    face_material: I32
    parts: tuple[Part, ...]

    @cached_property
    def bounds(self) -> tuple[F64, F64]:
        """Lowest and highest corner (3,) float64 of the triangles' bounding box; zeros without triangles."""
        if not len(self.faces):
            return np.zeros(3), np.zeros(3)
        used = self.positions[self.used]
        return used.min(axis=0), used.max(axis=0)

    @property
    def diagonal(self) -> float:
        """Length of the bounding box's diagonal, the yardstick of every relative error."""
        low, high = self.bounds
        extent = high - low
        largest = float(extent.max())  # taken out, so that the squares neither overflow nor vanish
        return largest * float(np.linalg.norm(extent / largest)) if largest > 0 else 0.0

    @cached_property
    def used(self) -> I32:
        """Rows of `positions` that a triangle uses, ascending."""
        mask = np.zeros(len(self.positions), bool)
        mask[self.faces] = True
        return np.flatnonzero(mask).astype(np.int32)

    @cached_property
    def wedges(self) -> I32:
        """(F, 3) int32: rows of the values that `attribute` returns, corner for corner with `faces`."""
        rows, start = [np.zeros((0, 3), np.int32)], 0
        for part in self.parts:
            wedges = part.mesh.wedges + np.int32(start)
            rows.append(wedges[:, ::-1] if part.mirrored else wedges)
            start += _wedge_rows(part.mesh)
        return np.concatenate(rows)

    def attribute(self, name: str) -> tuple[F32, Bool] | None:
        """The attribute `name` over all parts: values (W, K) float32, and (F,) bool which faces have it.

        None if no face has it. Where parts differ in K the rest is filled with ones (a colour's alpha). NORMAL is
        turned into world space and has unit length, or zero length where the file's has; TANGENT likewise, and its
        fourth value keeps the bitangent's side.
        """
        has = np.zeros(len(self.faces), bool)
        for part in self.parts:
            table = np.array([name in p.attributes and name in part.mesh.attributes for p in part.mesh.primitives])
            has[part.first_face : part.first_face + len(part.mesh.faces)] = table[part.mesh.face_primitive]
        if not has.any():
            return None
        width = max(part.mesh.attributes[name].shape[1] for part in self.parts if name in part.mesh.attributes)
        values = []
        for part in self.parts:
            own = part.mesh.attributes.get(name)
            block = np.ones((_wedge_rows(part.mesh), width), np.float32)
            if own is not None:
                block[:, : own.shape[1]] = _TURN[name](own, part.matrix) if name in _TURN else own
            values.append(block)
        return np.concatenate(values), has


def flatten(asset: Asset, meshes: Sequence[Mesh] | None = None) -> Soup:
    """All instances of `asset`'s default scene, placed in world space.

    `meshes` (a level's, for instance) stands in for `asset.meshes`, row for row; InvalidMesh is raised if their
    numbers differ. Nothing is copied for a single mesh that is not moved.
    """
    given = asset.meshes if meshes is None else tuple(meshes)
    if len(given) != len(asset.meshes):
        raise InvalidMesh(f"a level has {len(given)} meshes where the asset has {len(asset.meshes)}")
    return _soup(given, asset.instances())


def flatten_once(asset: Asset) -> Soup:
    """Every mesh of `asset` that has triangles once, in the placement at which the scene shows it largest.

    A mesh that is not placed, or only flat, lies where its own numbers say.
    """
    places: dict[int, list[F64]] = {index: [] for index, mesh in enumerate(asset.meshes) if len(mesh.faces)}
    for index, matrix in asset.instances():
        if index in places:
            places[index].append(matrix)
    return _soup(asset.meshes, [(index, largest_placement(matrices)) for index, matrices in places.items()])


def largest_placement(matrices: Sequence[F64]) -> F64:
    """The one of 4×4 `matrices` that magnifies most; identity if there is none, or none with a volume."""
    sizes = [abs(float(np.linalg.det(m[:3, :3]))) for m in matrices]
    if not sizes or not max(sizes) > 0 or not np.isfinite(max(sizes)):
        return np.eye(4)
    return matrices[int(np.argmax(sizes))]


def _soup(meshes: Sequence[Mesh], places: Sequence[tuple[int, F64]]) -> Soup:
    positions, faces, materials, parts = [], [], [], []
    first_position = first_face = 0
    for index, matrix in places:
        mesh = meshes[index]
        part = Part(mesh, matrix, first_face)
        corners = mesh.faces[:, ::-1] if part.mirrored else mesh.faces
        positions.append(_placed(mesh.positions, matrix))
        faces.append(corners + np.int32(first_position) if first_position else corners)
        materials.append(mesh.face_material)
        parts.append(part)
        first_position += len(mesh.positions)
        first_face += len(mesh.faces)
    if len(parts) == 1:
        return Soup(positions[0], faces[0], materials[0], tuple(parts))
    return Soup(
        np.concatenate([np.zeros((0, 3)), *positions]),
        np.concatenate([np.zeros((0, 3), np.int32), *faces]),
        np.concatenate([np.zeros(0, np.int32), *materials]),
        tuple(parts),
    )


def _placed(positions: F64, matrix: F64) -> F64:
    if np.array_equal(matrix, np.eye(4)):
        return positions
    return positions @ matrix[:3, :3].T + matrix[:3, 3]


def turned_normals(normals: F32, matrix: F64) -> F32:
    """Unit normals under `matrix`, by its cofactors: the inverse transpose, without dividing by a determinant of 0.

    The cofactor matrix of a mirroring matrix points normals inwards, where the inverse transpose points outwards.
    """
    a, b, c = matrix[:3, :3]
    cofactors = np.array([np.cross(b, c), np.cross(c, a), np.cross(a, b)])
    if np.linalg.det(matrix[:3, :3]) < 0:
        cofactors = -cofactors
    scale = np.abs(cofactors).max()
    turned = normals.astype(np.float64) @ (cofactors / scale if scale > 0 else np.eye(3)).T
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    return (turned / np.where(length > 0, length, 1.0)).astype(np.float32)


def _turned_tangents(tangents: F32, matrix: F64) -> F32:
    """Unit tangents with their bitangent's sign (W, 4) under `matrix`: they lie in the surface."""
    turned = tangents[:, :3].astype(np.float64) @ matrix[:3, :3].T
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    sides = tangents[:, 3:] * np.float32(-1.0 if np.linalg.det(matrix[:3, :3]) < 0 else 1.0)
    return np.concatenate([(turned / np.where(length > 0, length, 1.0)).astype(np.float32), sides], axis=1)


_TURN = {"NORMAL": turned_normals, "TANGENT": _turned_tangents}


def _wedge_rows(mesh: Mesh) -> int:
    for values in mesh.attributes.values():
        return len(values)
    return int(mesh.wedges.max()) + 1 if len(mesh.wedges) else 0
