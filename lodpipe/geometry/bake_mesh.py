"""A level's mesh on its way to new UVs: what stands at its corners, and the mesh that comes of it."""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import replace

import numpy as np

from lodpipe.core.mesh import F32, F64, I32, Mesh, Primitive
from lodpipe.geometry.normals import corner_angles, crease_normals, unit
from lodpipe.geometry.tangents import corner_tangents

LEAST_Z = 0.05
"""A baked normal leans away from the level's own by no more than this leaves upright: maps hold the outer half only."""
VARIANTS = "KHR_materials_variants"


class Corners:
    """The corners of a level's mesh: smooth normals for rays, new UVs, and the frames that normal maps refer to.

    smooth    (F, 3, 3) float32 unit: one normal for each position, so that rays leave no gaps at edges
    uv        (F, 3, 2) float32, what `put_uv` was given
    normals   (F, 3, 3) float32 unit, the level's own; where it has none made smooth, but for creases at UV seams
    tangents  (F, 3, 4) float32 MikkTSpace, or None
    """

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.smooth: F32 = crease_normals(mesh.positions, mesh.faces, 180.0)
        old = mesh.attributes.get("TEXCOORD_0")
        self.uv: F32 = np.zeros((len(mesh.faces), 3, 2), np.float32) if old is None else old[:, :2][mesh.wedges]
        self.baked = np.zeros(len(mesh.faces), bool)
        self.normals: F32 | None = None
        self.tangents: F32 | None = None

    def put_uv(self, rows: I32, uv: F64) -> None:
        """The new UVs (N, 3, 2) of the faces `rows`."""
        self.uv[rows] = uv
        self.baked[rows] = True

    def finish(self, normals: bool, given: F32 | None = None) -> None:
        """Number the UV vertices; with `normals` settle the frames, about `given` normals (F, 3, 3) if there are."""
        self.uv_number: I32 = _equal_rows(self.mesh.faces, self.uv)
        if not normals:
            return
        stored = self.mesh.attributes.get("NORMAL")
        self.normals = self._creased() if given is None else given
        if stored is not None and given is None:
            has = np.array(["NORMAL" in p.attributes for p in self.mesh.primitives])[self.mesh.face_primitive]
            own = stored[self.mesh.wedges[has]]
            self.normals[has] = np.where(own.any(axis=2, keepdims=True), own, self.normals[has])
        self.tangents = corner_tangents(self.mesh.positions, self.mesh.faces, self.normals, self.uv)

    def _creased(self) -> F32:
        """One normal for each UV vertex, the mean of its corners' under a crease angle: an edge is hard where it is
        sharp and a UV seam, since a normal map cannot change its frame in the middle of a chart."""
        angles = corner_angles(self.mesh.positions, self.mesh.faces)
        corners = crease_normals(self.mesh.positions, self.mesh.faces) * angles[..., None]
        number = self.uv_number.ravel()
        sums: F64 = np.stack([np.bincount(number, corners[..., k].ravel()) for k in range(3)], axis=1, dtype=np.float64)
        made = unit(sums)[self.uv_number]
        normals: F32 = np.where(made.any(axis=2, keepdims=True), made, self.smooth).astype(np.float32)
        return normals

    def encoded(self, faces: I32, weights: F32, normals: F32) -> F32:
        """Unit `normals` (N, 3) in the tangent space at those places of the level, as 0…1.

        As shaders decode them: tangent and normal interpolated and of unit length, the bitangent their cross product.
        """
        assert self.normals is not None and self.tangents is not None  # `finish` made them
        up = unit(np.einsum("nkd,nk->nd", self.normals[faces], weights).astype(np.float64))
        frame: F64 = np.einsum("nkd,nk->nd", self.tangents[faces], weights).astype(np.float64)
        along = unit(frame[:, :3])
        across = unit(np.cross(up, along)) * np.where(frame[:, 3:] < 0, -1.0, 1.0)
        # the frame may not be orthogonal between corners: solve for the three shares
        basis = np.stack([along, across, up], axis=2)
        volume = np.linalg.det(basis)
        sound = np.abs(volume) > 1e-3
        basis[~sound] = np.eye(3)
        shares = np.linalg.solve(basis, normals.astype(np.float64)[..., None])[..., 0].astype(np.float64)
        shares[~sound] = (0.0, 0.0, 1.0)
        low = shares[:, 2] < LEAST_Z
        shares[low, 2] = LEAST_Z
        return (unit(shares) * 0.5 + 0.5).astype(np.float32)


def rebuilt(
    mesh: Mesh, corners: Corners, material_of: Mapping[int, int], kept_as: Mapping[int, int], gone: Set[str]
) -> Mesh:
    """`mesh` with the corners' UVs as TEXCOORD_0, and new materials.

    `material_of` and `kept_as` number old materials (−1: the default one) anew: those whose faces were baked, and the
    others.

    Attributes in `gone` are left out, and tangents, which belong to the old UVs.
    """
    gone = {*gone, "TEXCOORD_0", "TANGENT"}
    columns = {name: values[mesh.wedges] for name, values in mesh.attributes.items() if name not in gone}
    columns["TEXCOORD_0"] = corners.uv
    if corners.normals is not None and corners.tangents is not None:
        columns["NORMAL"], columns["TANGENT"] = corners.normals, corners.tangents
    table = np.concatenate([column.reshape(-1, column.shape[2]) for column in columns.values()], axis=1)
    wedges = _equal_rows(mesh.faces, table.reshape(len(mesh.faces), 3, -1))
    rows = np.zeros(int(wedges.max(initial=-1)) + 1, np.int64)
    rows[wedges.ravel()] = np.arange(wedges.size)
    primitives: list[Primitive] = []
    numbers = np.zeros(len(mesh.primitives), np.int32)
    # a wedge belongs to one primitive: faces of two that stay apart may not share one
    for index, old in enumerate(mesh.primitives):
        row = -1 if old.material is None else old.material
        names = [name for name in old.attributes if name in columns]
        made = [name for name in ("TEXCOORD_0", "NORMAL", "TANGENT") if name in columns and row in material_of]
        attributes = tuple(dict.fromkeys([*names, *made]))
        material = material_of.get(row, kept_as.get(row))
        new = Primitive(material, attributes, _without_variants(old.gltf))
        if new not in primitives:
            primitives.append(new)
        numbers[index] = primitives.index(new)
    face_primitive = numbers[mesh.face_primitive]
    if len(primitives) > 1:
        key = wedges.astype(np.int64) + face_primitive[:, None].astype(np.int64) * len(rows)
        kept, wedges = np.unique(key, return_inverse=True)
        wedges = wedges.reshape(-1, 3).astype(np.int32)
        rows = rows[kept % len(rows)]
    attributes_ = {name: column.reshape(-1, column.shape[2])[rows] for name, column in columns.items()}
    return replace(
        mesh, wedges=wedges, attributes=attributes_, face_primitive=face_primitive, primitives=tuple(primitives)
    )


def _without_variants(said: Mapping[str, object]) -> Mapping[str, object]:
    extensions = said.get("extensions")
    if not isinstance(extensions, Mapping) or VARIANTS not in extensions:
        return said
    rest = {name: value for name, value in extensions.items() if name != VARIANTS}
    return {**said, "extensions": rest} if rest else {k: v for k, v in said.items() if k != "extensions"}


def _equal_rows(faces: I32, values: F32) -> I32:
    """(F, 3) int32: equal numbers for corners of one position whose `values` (F, 3, K) are equal, bit by bit."""
    bits = np.ascontiguousarray(values.reshape(faces.size, -1) + np.float32(0)).view(np.uint32)
    table = np.concatenate([faces.reshape(-1, 1).astype(np.uint32), bits], axis=1)
    order = np.lexsort(table.T)
    ranked = table[order]
    new = np.zeros(len(order), np.int64)
    new[1:] = (ranked[1:] != ranked[:-1]).any(axis=1)
    numbers = np.empty(len(order), np.int32)
    numbers[order] = np.cumsum(new)
    return numbers.reshape(-1, 3)
