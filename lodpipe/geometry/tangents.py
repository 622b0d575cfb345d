"""Tangents as glTF wants them: MikkTSpace, the same that renderers and normal-map bakers make.

Mikkelsen 2008, "Simulation of Wrinkled Surfaces Revisited", and his published reference behaviour: corners that agree
in position, normal and UV share a tangent with the faces they reach over shared edges of the same UV orientation;
each face's direction of u, projected onto the normal's plane, counts by its angle there.
"""

from __future__ import annotations

import numpy as np

from lodpipe.core.mesh import F32, F64, I32
from lodpipe.geometry.normals import unit
from lodpipe.kernel import layout

TINY = float(np.finfo(np.float32).tiny)


def corner_tangents(positions: F64 | F32, faces: I32, normals: F64 | F32, uv: F64 | F32) -> F32:
    """(F, 3, 4) float32: unit tangent and sign of the bitangent for each corner.

    positions (V, 3), faces (F, 3), normals (F, 3, 3) unit, uv (F, 3, 2) with v = 0 at the top. The bitangent, cross
    (normal, tangent) · sign, points to where v falls, as the green of a glTF normal map means it.
    """
    count = len(faces)
    if not count:
        return np.zeros((0, 3, 4), np.float32)
    normals, uv = np.asarray(normals, np.float64), np.asarray(uv, np.float64)
    vertex = _welded(faces, normals, uv)
    corners = positions[faces].astype(np.float64)
    along, forward, undirected = _directions(corners, uv)
    degenerate = (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])
    orientation = _adopted(vertex, forward, undirected & ~degenerate)
    group = layout.join_pairs(_neighbours(vertex, orientation, degenerate), 3 * count)
    share = _shares(corners, normals, along)
    share[degenerate | undirected] = 0.0
    sums = np.stack([np.bincount(group, share[..., k].ravel(), 3 * count) for k in range(3)], axis=1)
    tangents = unit(sums.astype(np.float64))[group].reshape(count, 3, 3)
    empty = ~tangents.any(axis=2)
    if empty.any():
        tangents[empty] = _any_tangent(normals[empty])
    signs = np.repeat(np.where(orientation, 1.0, -1.0)[:, None], 3, axis=1)
    if degenerate.any():
        tangents, signs = _lent(tangents, signs, vertex, degenerate)
    return np.concatenate([tangents, signs[..., None]], axis=2).astype(np.float32)


def _welded(faces: I32, normals: F64, uv: F64) -> I32:
    """(F, 3) equal numbers for corners of equal position, normal and UV."""
    values = np.concatenate([normals.reshape(-1, 3), uv.reshape(-1, 2)], axis=1).astype(np.float32) + np.float32(0)
    bits = np.ascontiguousarray(values).view(np.uint32).astype(np.uint64)
    keys = [faces.ravel().astype(np.uint64) << np.uint64(32) | bits[:, 0]]
    keys += [bits[:, 1] << np.uint64(32) | bits[:, 2], bits[:, 3] << np.uint64(32) | bits[:, 4]]
    order = np.lexsort(keys)
    new = np.zeros(len(order), np.int64)
    for key in keys:
        ranked = key[order]
        new[1:] |= ranked[1:] != ranked[:-1]
    number = np.empty(len(order), np.int32)
    number[order] = np.cumsum(new)
    return number.reshape(-1, 3)


def _directions(corners: F64, uv: F64) -> tuple[F64, np.ndarray, np.ndarray]:
    """(F, 3) unit direction of growing u, (F,) whether UVs run counter-clockwise (v up), (F,) whether without area."""
    p, q = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    s, t = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area = -(s[:, 0] * t[:, 1] - s[:, 1] * t[:, 0])  # v down becomes v up
    along = p * -t[:, 1:] + q * s[:, 1:]
    forward = area > 0
    along *= np.where(forward, 1.0, -1.0)[:, None]
    return unit(along), forward, np.abs(area) <= TINY


def _sides(vertex: I32) -> tuple[np.ndarray, np.ndarray]:
    """(3F,) a number for each side, equal for equal ends; and the order that sorts them."""
    a, b = vertex.ravel().astype(np.int64), np.roll(vertex, -1, axis=1).ravel().astype(np.int64)
    key = np.minimum(a, b) << 32 | np.maximum(a, b)
    return key, np.argsort(key, kind="stable")


def _adopted(vertex: I32, forward: np.ndarray, undirected: np.ndarray) -> np.ndarray:
    """Orientation of each face; those without area in the texture take a neighbour's."""
    if not undirected.any():
        return forward
    key, order = _sides(vertex)
    orientation, todo = forward.copy(), undirected.copy()
    same = key[order][1:] == key[order][:-1]
    left, right = order[:-1][same] // 3, order[1:][same] // 3
    for _ in range(8):
        for a, b in ((left, right), (right, left)):
            known = todo[a] & ~todo[b]
            orientation[a[known]] = orientation[b[known]]
            todo[a[known]] = False
    return orientation


def _neighbours(vertex: I32, orientation: np.ndarray, degenerate: np.ndarray) -> I32:
    """(N, 2) corners, as 3·face + corner, of faces of one orientation that share an edge."""
    key, order = _sides(vertex)
    ranked = key[order]
    rows = np.flatnonzero(ranked[1:] == ranked[:-1])
    a, b = order[rows], order[rows + 1]
    good = (orientation[a // 3] == orientation[b // 3]) & ~degenerate[a // 3] & ~degenerate[b // 3]
    a, b = a[good], b[good]
    after_a, after_b = a // 3 * 3 + (a + 1) % 3, b // 3 * 3 + (b + 1) % 3
    flat = vertex.ravel()
    crossed = flat[a] == flat[after_b]  # the other face runs through the edge the other way
    first = np.where(crossed, after_b, b)
    second = np.where(crossed, b, after_b)
    return np.concatenate([np.stack([a, first], axis=1), np.stack([after_a, second], axis=1)]).astype(np.int32)


def _shares(corners: F64, normals: F64, along: F64) -> F64:
    """(F, 3, 3): what each face gives to each of its corners' tangents."""

    def flattened(vectors: F64) -> F64:
        return unit(vectors - normals * np.einsum("fkd,fkd->fk", vectors, normals)[..., None])

    forward = flattened(np.roll(corners, -1, axis=1) - corners)
    back = flattened(np.roll(corners, 1, axis=1) - corners)
    angle = np.arccos(np.clip(np.einsum("fkd,fkd->fk", forward, back), -1.0, 1.0))
    shares: F64 = flattened(np.repeat(along[:, None], 3, axis=1)) * angle[..., None]
    return shares


def _any_tangent(normals: F64) -> F64:
    """A unit vector across each of `normals` (N, 3)."""
    axis: F64 = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    return unit(axis - normals * np.einsum("nd,nd->n", axis, normals)[:, None])


def _lent(tangents: F64, signs: F64, vertex: I32, degenerate: np.ndarray) -> tuple[F64, F64]:
    """Corners of degenerate faces take what the first other corner at their vertex has."""
    flat = vertex.ravel()
    owner = np.full(int(flat.max()) + 1, -1)
    good = np.flatnonzero(np.repeat(~degenerate, 3))
    owner[flat[good[::-1]]] = good[::-1]
    taken = np.flatnonzero(np.repeat(degenerate, 3) & (owner[flat] >= 0))
    tangents.reshape(-1, 3)[taken] = tangents.reshape(-1, 3)[owner[flat[taken]]]
    signs.reshape(-1)[taken] = signs.reshape(-1)[owner[flat[taken]]]
    return tangents, signs
