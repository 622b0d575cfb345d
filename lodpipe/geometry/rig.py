"""Joints, weights and morph targets of a level: read off the source where the level's vertices lie on it."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.mesh import F32, F64, I32, Mesh

_RIG = re.compile(r"^(JOINTS|WEIGHTS)_\d+$|^MORPH_\d+_\w+$")
_OF_WEDGES = re.compile(r"^MORPH_\d+_(?!POSITION$)")
CHUNK = 200_000  # pairs of a triangle and a point at a time


def is_rig(name: str) -> bool:
    """Whether an attribute says how a vertex moves: such ones do not enter a collapse, but are read off the source."""
    return bool(_RIG.match(name))


def carry(
    source: Mesh,
    positions: F64,
    vertex_source: I32,
    vertex_to: I32,
    vertex_of: I32,
    wedge_source: I32,
    wedge_to: I32,
) -> dict[str, F32]:
    """The rig's attributes for the wedges of a level.

    positions      (v, 3) of the level's vertices, in the source's space
    vertex_source  (v,) row of the source where a vertex did not move, −1 elsewhere; wedge_source (w,) likewise
    vertex_to      (V,) the level's vertex that each of the source's was merged into, −1 for none; wedge_to (W,)
                   likewise. Both may be empty where that is not known: the nearest vertex then stands in
    vertex_of      (w,) the vertex of each of the level's wedges

    A vertex takes its weights and displacements from the closest point of the triangles that were merged into it, so
    that a leg never follows the other leg however near it is. As many joints as the source allows keep their weights,
    which are scaled to a sum of 1.
    """
    names = [name for name in source.attributes if is_rig(name)]
    if not names:
        return {}
    corner = np.zeros(len(source.positions), np.int64)
    corner[source.faces] = source.wedges
    rows, share = _closest(source, source.faces, positions, vertex_source, vertex_to)
    rows = corner[rows]
    out: dict[str, F32] = {}
    if any(_OF_WEDGES.match(name) for name in names):
        apart, apart_share = _closest(source, source.wedges, positions[vertex_of], wedge_source, wedge_to)
    for name in names:
        if name.startswith("MORPH_"):
            own = _OF_WEDGES.match(name)
            chosen, parts = (apart, apart_share) if own else (rows[vertex_of], share[vertex_of])
            values = np.einsum("wk,wkc->wc", parts, source.attributes[name][chosen].astype(np.float64))
            out[name] = values.astype(np.float32)
    sets = [n for n in range(8) if f"JOINTS_{n}" in names and f"WEIGHTS_{n}" in names]
    if sets:
        index = np.concatenate([source.attributes[f"JOINTS_{n}"] for n in sets], axis=1)[rows].astype(np.int64)
        weight = np.concatenate([source.attributes[f"WEIGHTS_{n}"] for n in sets], axis=1)[rows] * share[:, :, None]
        joints, weights = _strongest(index.reshape(len(rows), -1), weight.reshape(len(rows), -1), 4 * len(sets))
        kept = share[:, 0] == 1  # the source's own numbers, in their own order
        for k, n in enumerate(sets):
            part = slice(4 * k, 4 * k + 4)
            first = rows[:, 0]
            for name, values in ((f"JOINTS_{n}", joints), (f"WEIGHTS_{n}", weights)):
                table = np.where(kept[:, None], source.attributes[name][first], values[:, part]).astype(np.float32)
                out[name] = table[vertex_of]
    for name in names:  # a set without its counterpart
        out.setdefault(name, source.attributes[name][rows[vertex_of, 0]])
    return {name: out[name] for name in names}


def _closest(source: Mesh, corners: I32, points: F64, known: I32, target: I32) -> tuple[NDArray[Any], F64]:
    """The closest point of each point's triangles: rows (n, 3) of what `corners` names, and their shares (n, 3)."""
    count = len(points)
    rows = np.zeros((count, 3), np.int64)
    share = np.zeros((count, 3))
    share[:, 0] = 1.0
    rows[:] = np.maximum(known, 0)[:, None]
    best = np.full(count, np.inf)
    if len(target):
        owner = target[corners]
        owner = np.where((owner >= 0) & (known[np.maximum(owner, 0)] < 0), owner, -1)
        owner[:, 1] = np.where(owner[:, 1] == owner[:, 0], -1, owner[:, 1])
        owner[:, 2] = np.where((owner[:, 2] == owner[:, 0]) | (owner[:, 2] == owner[:, 1]), -1, owner[:, 2])
        face, slot = np.nonzero(owner >= 0)
        for start in range(0, len(face), CHUNK):
            f, s = face[start : start + CHUNK], slot[start : start + CHUNK]
            who = owner[f, s]
            parts, distance = _on_triangle(points[who], source.positions[source.faces[f]])
            order = np.lexsort((f, distance, who))
            first = order[np.flatnonzero(np.diff(who[order], prepend=-1))]
            first = first[distance[first] < best[who[first]]]
            best[who[first]] = distance[first]
            rows[who[first]], share[who[first]] = corners[f[first]], parts[first]
    lost = (known < 0) & ~np.isfinite(best)
    if lost.any() and len(source.faces):
        vertex, row = np.unique(source.faces.ravel(), return_index=True)
        from scipy.spatial import cKDTree  # takes as long to load as a small model to process

        _, near = cKDTree(source.positions[vertex]).query(points[lost])
        rows[lost] = corners.ravel()[row[near]][:, None]
    return rows, share


def _on_triangle(points: F64, triangles: F64) -> tuple[F64, F64]:
    """Barycentric coordinates (n, 3) of the points (n, 3) of triangles (n, 3, 3) closest to points, and the squared
    distances (n,): the foot of the perpendicular, or the best of the three edges."""
    edges = triangles[:, [1, 2, 0]] - triangles
    length = np.maximum(np.einsum("nkc,nkc->nk", edges, edges), 1e-300)
    along = np.clip(np.einsum("nkc,nkc->nk", points[:, None] - triangles, edges) / length, 0.0, 1.0)
    gap = points[:, None] - triangles - along[:, :, None] * edges
    edge_distance = np.einsum("nkc,nkc->nk", gap, gap)
    edge = edge_distance.argmin(axis=1)
    every = np.arange(len(points))
    parts = np.zeros((len(points), 3))
    parts[every, edge] = 1 - along[every, edge]
    parts[every, (edge + 1) % 3] = along[every, edge]
    distance = edge_distance[every, edge]
    normal = np.cross(edges[:, 0], edges[:, 1])
    square = np.einsum("nc,nc->n", normal, normal)
    to = points[:, None] - triangles  # the part of a corner is the area of the triangle of the point and the others
    area = np.einsum("nkc,nc->nk", np.cross(edges[:, [1, 2, 0]], to[:, [1, 2, 0]]), normal)
    inside = (area > 0).all(axis=1) & (square > 0)
    flat = area[inside] / area[inside].sum(axis=1, keepdims=True)
    height = np.einsum("nc,nc->n", to[inside, 0], normal[inside]) ** 2 / square[inside]
    parts[inside], distance[inside] = flat, height
    return parts, distance


def _strongest(joints: NDArray[Any], weights: F64, count: int) -> tuple[F32, F32]:
    """The `count` joints with the largest weights of each row, strongest first, and the weights, which sum up to 1."""
    order = np.argsort(joints, axis=1, kind="stable")
    joints, weights = np.take_along_axis(joints, order, 1), np.take_along_axis(weights, order, 1)
    same = np.concatenate([np.zeros((len(joints), 1), bool), joints[:, 1:] == joints[:, :-1]], axis=1)
    for k in range(joints.shape[1] - 1, 0, -1):  # what equal joints weigh goes to the first of them
        weights[:, k - 1] += np.where(same[:, k], weights[:, k], 0)
        weights[:, k] = np.where(same[:, k], 0, weights[:, k])
    order = np.argsort(-weights, axis=1, kind="stable")[:, :count]
    joints, weights = np.take_along_axis(joints, order, 1), np.take_along_axis(weights, order, 1)
    joints = np.where(weights > 0, joints, 0)
    total = weights.sum(axis=1, keepdims=True)
    return joints.astype(np.float32), (weights / np.where(total > 0, total, 1)).astype(np.float32)
