"""Meshes as glTF primitives: vertices in the order in which the faces use them, attributes in valid values."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.errors import InvalidMesh, OutputError
from lodpipe.core.mesh import F32, F64, I32, Mesh, Primitive
from lodpipe.io.clean import Warn, directions, finite_attribute
from lodpipe.io.pack import INDICES, VERTICES, Packer

_TARGET = re.compile(r"^MORPH_(\d+)_(.+)$")
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 9: "MAT3", 16: "MAT4"}
#: Rounding to float32 may move a vertex by so much of the mesh's extent; beyond that the mesh is moved to the origin.
_LOSS = 1e-5


def far_offset(mesh: Mesh, place: str) -> list[float] | None:
    """The translation to take out of `mesh` so that float32 keeps its shape; None where none is needed.

    Raises OutputError for coordinates that float32 cannot hold.
    """
    if not len(mesh.faces):
        return None
    points = mesh.positions
    low, high = points.min(axis=0), points.max(axis=0)
    extent = float((high - low).max())
    if _loss(points) <= _LOSS * extent or extent == 0.0:
        return None
    middle = (low + high) / 2.0
    if _loss(points - middle) > _LOSS * extent:
        raise OutputError(
            f"coordinates up to {np.abs(points).max():.3g} with an extent of {extent:.3g} do not fit in glTF's "
            "32-bit floats",
            place=place,
            advice="scale the model, or write it as PLY",
        )
    return [float(v) for v in middle]


def _loss(points: F64) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        worst = np.abs(points.astype(np.float32) - points).max()
    return float(worst) if np.isfinite(worst) else float("inf")


def primitives(mesh: Mesh, pack: Packer, offset: list[float] | None, place: str, warn: Warn) -> list[dict[str, Any]]:
    """The JSON of `mesh`'s primitives that have faces, in order; their arrays go into `pack`."""
    result = []
    order = np.argsort(mesh.face_primitive, kind="stable")
    bound = np.searchsorted(mesh.face_primitive[order], np.arange(len(mesh.primitives) + 1))
    points = mesh.positions if offset is None else mesh.positions - np.array(offset)
    for i, primitive in enumerate(mesh.primitives):
        chosen = order[bound[i] : bound[i + 1]]
        if not len(chosen):
            continue
        whole = len(chosen) == len(mesh.faces)
        names = [n for n in primitive.attributes if n in mesh.attributes]
        faces = mesh.faces if whole else mesh.faces[chosen]
        rows = (mesh.wedges if whole else mesh.wedges[chosen]) if names else faces
        vertices, local = first_use(rows)
        position = np.empty(len(vertices), np.int32)
        position[local.ravel()] = faces.ravel()
        if (position[local] != faces).any():
            raise InvalidMesh("a wedge belongs to two positions", place=place)
        attributes = {name: mesh.attributes[name][vertices] for name in names}
        result.append(_primitive(primitive, points[position], local, attributes, pack, place, warn))
    return result


def first_use(rows: I32) -> tuple[I32, I32]:
    """The distinct values of `rows` (F, 3) in the order in which they first occur, and `rows` in terms of them."""
    flat = rows.ravel()
    top = int(flat.max()) + 1
    place = np.empty(top, np.int32)
    count = np.arange(len(flat), dtype=np.int32)
    place[flat[::-1]] = count[::-1]  # the last writer is the first occurrence
    is_first = place[flat] == count
    values = flat[is_first]
    place[values] = np.arange(len(values), dtype=np.int32)
    return values, place[rows]


def _primitive(
    said: Primitive,
    points: F64,
    faces: I32,
    attributes: Mapping[str, F32],
    pack: Packer,
    place: str,
    warn: Warn,
) -> dict[str, Any]:
    with np.errstate(over="ignore"):
        narrow = points.astype(np.float32)
    if not np.isfinite(narrow).all():
        raise OutputError("coordinates do not fit in glTF's 32-bit floats", place=place, advice="scale the model")
    table = {"POSITION": pack.accessor(narrow, "VEC3", target=VERTICES, bounds=True)}
    targets: dict[int, dict[str, int]] = {}
    normals: F32 | None = None
    for name, given in attributes.items():
        values = finite_attribute(name, given, place, warn)
        match = _TARGET.match(name)
        kind = _TYPES.get(values.shape[1])
        if kind is None:
            raise InvalidMesh(f"{name} has {values.shape[1]} components, which glTF has no type for", place=place)
        if match:
            row = pack.accessor(values, kind, target=VERTICES, bounds=match[2] == "POSITION")
            targets.setdefault(int(match[1]), {})[match[2]] = row
            continue
        if name == "NORMAL":
            values = normals = directions(values, points, faces, faces)
        elif name == "TANGENT":
            values = _tangents(values, normals)
        stored, normalized = _stored(name, values)
        table[name] = pack.accessor(stored, kind, normalized=normalized, target=VERTICES)
    index = np.dtype("<u2") if len(points) <= 65535 else np.dtype("<u4")  # the largest index is reserved
    corners = faces.reshape(-1, 1).astype(index)
    result: dict[str, Any] = {"attributes": table, "indices": pack.accessor(corners, "SCALAR", target=INDICES)}
    if said.material is not None:
        result["material"] = said.material
    if targets:
        none = np.zeros((len(points), 3), np.float32)
        result["targets"] = [
            targets.get(i) or {"POSITION": pack.accessor(none, "VEC3", target=VERTICES, bounds=True)}
            for i in range(max(targets) + 1)
        ]
    result.update(said.gltf)
    return result


def _stored(name: str, values: F32) -> tuple[NDArray[Any], bool]:
    """An attribute as the component type that holds it without loss, and whether its integers are normalized."""
    if name.startswith("JOINTS_"):
        return values.astype(np.uint8 if values.max(initial=0) < 256 else np.uint16), False
    if name.startswith("COLOR_"):
        clipped = np.clip(values, 0.0, 1.0)
        for kind in (np.uint8, np.uint16):
            top = np.float64(np.iinfo(kind).max)
            whole = np.rint(clipped * top)
            if ((whole / top).astype(np.float32) == clipped).all():
                return whole.astype(kind), True
        return clipped, False
    return values, False


def _tangents(tangents: F32, normals: F32 | None) -> F32:
    """Unit tangents (N, 4) with a sign of ±1; one of no length becomes any direction that is at right angles."""
    vector = tangents[:, :3].astype(np.float64)
    length = np.linalg.norm(vector, axis=1)
    flat = ~((length > 1e-8) & (length < 1e30))
    sign = np.where(tangents[:, 3:] < 0, -1.0, 1.0).astype(np.float32)
    if not flat.any() and (np.abs(length - 1.0) <= 1e-6).all() and (sign == tangents[:, 3:]).all():
        return tangents
    if flat.any():
        up = np.tile((0.0, 0.0, 1.0), (len(vector), 1)) if normals is None else normals.astype(np.float64)
        side = np.where(np.abs(up[:, :1]) < 0.9, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
        vector[flat] = np.cross(side, up)[flat]
        length = np.linalg.norm(vector, axis=1)
    off = np.abs(length - 1.0) > 1e-6
    vector[off] /= length[off, None]
    return np.hstack([vector.astype(np.float32), sign])
