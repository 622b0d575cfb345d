"""Normals for meshes that bring none, as wedges: so that a level can keep the light that fell on its source."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lodpipe.core.mesh import F32, I32, Mesh
from lodpipe.geometry.normals import crease_normals, face_normals

CREASE = 60.0
"""Degrees between faces from which an edge is shaded sharp; what viewers make of meshes without normals."""


def with_normals(mesh: Mesh) -> Mesh:
    """The mesh with a NORMAL attribute on every primitive that had none, smooth but for creases.

    A wedge is split where a crease passes through it: its corners then fall into fans that creases do not cross, and
    each fan has the mean of its corners' normals. Meshes that have normals everywhere come back as they are.
    """
    bare = np.array(["NORMAL" not in p.attributes for p in mesh.primitives])
    if not bare.any() or not len(mesh.faces):
        return mesh
    corner = crease_normals(mesh.positions, mesh.faces, CREASE).reshape(-1, 3)
    wedges = mesh.wedges if mesh.attributes else _plain_wedges(mesh)
    fans = _fans(mesh, wedges)
    count = int(fans.max()) + 1
    normals = np.empty((count, 3), np.float32)
    for axis in range(3):
        normals[:, axis] = np.bincount(fans, corner[:, axis], minlength=count)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    up = np.array([0, 0, 1], np.float32)  # for fans without area
    normals = np.where(length > 1e-6, normals / np.maximum(length, 1e-6), up).astype(np.float32)
    source = np.empty(count, np.int32)
    source[fans] = wedges.ravel()
    attributes = {name: values[source] for name, values in mesh.attributes.items()}
    if "NORMAL" in attributes:  # some primitives have their own
        rows = np.zeros(count, bool)
        rows[fans.reshape(-1, 3)[bare[mesh.face_primitive]]] = True
        normals[~rows] = attributes["NORMAL"][~rows]
    attributes["NORMAL"] = normals
    primitives = tuple(
        replace(p, attributes=(*p.attributes, "NORMAL")) if missing else p
        for p, missing in zip(mesh.primitives, bare, strict=True)
    )
    return replace(mesh, wedges=fans.reshape(-1, 3), attributes=attributes, primitives=primitives)


def _plain_wedges(mesh: Mesh) -> I32:
    """One wedge for each position and primitive."""
    if len(mesh.primitives) == 1:
        return mesh.faces
    keys = mesh.faces.astype(np.int64) + mesh.face_primitive[:, None].astype(np.int64) * len(mesh.positions)
    rows: I32 = np.unique(keys, return_inverse=True)[1].reshape(-1, 3).astype(np.int32)
    return rows


def _fans(mesh: Mesh, wedges: I32) -> I32:
    """(3F,) int32: the fan of each corner. Corners of a wedge share a fan if a way leads from one to the other
    over edges that are no creases."""
    flat = face_normals(mesh.positions, mesh.faces).astype(np.float32)
    corners = np.arange(3 * len(mesh.faces), dtype=np.int32)
    wedge = wedges.ravel()
    parent = np.empty(int(wedge.max()) + 1, np.int32)  # any corner of each wedge
    parent[wedge[::-1]] = corners[::-1]
    label = parent[wedge]
    # wedges whose faces all look the way of their first one have one fan; the others are walked
    with np.errstate(invalid="ignore"):
        near = np.einsum("nd,nd->n", flat[corners // 3], flat[label // 3]) >= np.cos(np.radians(CREASE / 2))
    split = np.zeros(len(parent), bool)
    split[wedge[~near]] = True
    rows = corners[split[wedge]]
    if len(rows):
        label[rows] = _walked(mesh, wedge, flat, rows)
    return np.unique(label, return_inverse=True)[1].astype(np.int32)


def _walked(mesh: Mesh, wedge: I32, flat: F32, rows: I32) -> I32:
    """The lowest corner that each of `rows` is joined to, over smooth edges at its wedge."""
    face, slot = rows // 3, rows % 3
    around = mesh.faces[face]
    here = np.arange(len(rows))
    following = around[here, (slot + 1) % 3]
    previous = around[here, (slot + 2) % 3]
    # two corners of one wedge that both have the edge to `other`
    ends = np.concatenate([following, previous]).astype(np.int64)
    who = np.concatenate([here, here])
    key = wedge[rows][who].astype(np.int64) * (len(mesh.positions) + 1) + ends
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    a, b = who[order[same]], who[order[same + 1]]
    smooth = np.einsum("nd,nd->n", flat[face[a]], flat[face[b]]) >= np.cos(np.radians(CREASE))
    a, b = a[smooth], b[smooth]
    label = here.copy()
    while True:  # the lowest number wins, over ever longer ways
        lowest = label.copy()
        np.minimum.at(lowest, a, label[b])
        np.minimum.at(lowest, b, label[a])
        lowest = lowest[lowest]
        if np.array_equal(lowest, label):
            return rows[label]
        label = lowest
