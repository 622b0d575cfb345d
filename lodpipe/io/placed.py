"""Meshes where the scene puts them, for formats that have no node tree."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from lodpipe.core.asset import Asset
from lodpipe.core.mesh import F32, F64, I32, Mesh
from lodpipe.io.clean import vertex_normals
from lodpipe.io.primitives import first_use


@dataclass(frozen=True)
class Placed:
    """One placement of a mesh in the world.

    positions (V, 3) float64, faces (F, 3) rows of it, wedges (F, 3) rows of the mesh's attributes, normals (W, 3)
    or None. Faces are turned over where the placement mirrors.
    """

    mesh: Mesh
    positions: F64
    faces: I32
    wedges: I32
    normals: F32 | None


def placements(asset: Asset, meshes: Sequence[Mesh]) -> Iterator[Placed]:
    """Each placement of each mesh that has faces; `meshes` stands in for `asset.meshes`, row for row."""
    for row, matrix in asset.instances():
        mesh = meshes[row]
        if not len(mesh.faces):
            continue
        normals = mesh.attributes.get("NORMAL")
        if np.array_equal(matrix, np.eye(4)):
            yield Placed(mesh, mesh.positions, mesh.faces, mesh.wedges, normals)
            continue
        linear = matrix[:3, :3]
        order = [0, 2, 1] if np.linalg.det(linear) < 0 else [0, 1, 2]
        positions = mesh.positions @ linear.T + matrix[:3, 3]
        faces, wedges = mesh.faces[:, order], mesh.wedges[:, order]
        yield Placed(mesh, positions, faces, wedges, None if normals is None else _turned(normals, linear))


def _turned(normals: F32, linear: F64) -> F32:
    """Unit normals under a linear map, by its cofactors: right for uneven scales and for flat matrices too."""
    a, b, c = linear
    cofactors = np.array([np.cross(b, c), np.cross(c, a), np.cross(a, b)])
    if np.linalg.det(linear) < 0:
        cofactors = -cofactors
    turned = normals.astype(np.float64) @ (cofactors / (np.abs(cofactors).max() or 1.0)).T
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    return (turned / np.where(length > 0, length, 1.0)).astype(np.float32)


def one_surface(parts: Sequence[Placed]) -> tuple[F64, I32]:
    """Positions and faces of all parts together, positions in the order in which the faces use them."""
    positions, faces = [np.zeros((0, 3))], [np.zeros((0, 3), np.int32)]
    start = 0
    for part in parts:
        used, local = first_use(part.faces)
        positions.append(part.positions[used])
        faces.append(local + np.int32(start))
        start += len(used)
    return np.concatenate(positions), np.concatenate(faces)


def one_vertex_list(parts: Sequence[Placed], names: Sequence[str]) -> tuple[F64, I32, dict[str, F32]]:
    """The same with attributes for each vertex: a position is there once for each wedge that it has.

    An attribute that a part lacks is filled up: NORMAL from its faces, colours with 1, others with 0.
    """
    width = {n: max(p.mesh.attributes[n].shape[1] for p in parts if n in p.mesh.attributes) for n in names}
    positions, faces, columns = [], [], {name: [np.zeros((0, width[name]), np.float32)] for name in names}
    start = 0
    for part in parts:
        apart = bool(part.mesh.attributes)
        used, local = first_use(part.wedges if apart else part.faces)
        rows = np.empty(len(used), np.int32)
        rows[local.ravel()] = part.faces.ravel()
        positions.append(part.positions[rows])
        faces.append(local + np.int32(start))
        start += len(used)
        for name in names:
            values = part.normals if name == "NORMAL" else part.mesh.attributes.get(name)
            if values is not None:
                block = np.ones((len(used), width[name]), np.float32)
                block[:, : values.shape[1]] = values[used]
            elif name == "NORMAL":
                block = vertex_normals(part.positions, part.faces)[rows].astype(np.float32)
            else:
                block = np.full((len(used), width[name]), 1.0 if name.startswith("COLOR_") else 0.0, np.float32)
            columns[name].append(block)
    return np.concatenate(positions), np.concatenate(faces), {n: np.concatenate(c) for n, c in columns.items()}
