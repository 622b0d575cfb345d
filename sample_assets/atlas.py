"""A one-to-one texture atlas: box charts, split where they would overlap, packed; and painting into it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from implicit import F64, I64

U8 = NDArray[np.uint8]
I32 = NDArray[np.int32]

SMALL = 12
"""Charts of fewer faces join a neighbour where they can."""


@dataclass(frozen=True)
class Atlas:
    """UV coordinates (F, 3, 2) in 0…1, v = 0 at the top, and each face's chart (F,), 0 being the largest."""

    uv: F64
    chart: I64
    size: int
    """Width and height of the texture in texels that the gaps between charts were made for."""


def unwrap(positions: F64, faces: I32, size: int = 1024, gap: int = 4) -> Atlas:
    """Cut a surface into charts that are seen along ±x, ±y or ±z without overlap, and pack them into a square."""
    corners = positions[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    near = neighbours(faces)
    side = _sides(normals, near)
    plane = _flattened(corners, side)
    chart = _split(plane, _components(near, side), near)
    order = np.argsort(-np.bincount(chart), kind="stable")
    chart = np.argsort(order)[chart]
    return Atlas(_pack(plane, chart, size, gap), chart, size)


def neighbours(faces: I32) -> I64:
    """(F, 3): the face across each edge (corner k to k + 1) of a closed surface."""
    ends = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    owner = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort((ends.max(axis=1), ends.min(axis=1)))
    across = np.empty(len(ends), np.int64)
    across[order[0::2]], across[order[1::2]] = owner[order[1::2]], owner[order[0::2]]
    return across.reshape(3, -1).T


def _sides(normals: F64, near: I64) -> I64:
    """(F,): 0…5 for +x, −x, +y …: the direction that a face is seen from best, small patches joined to others."""
    facing = np.stack([normals[:, 0], -normals[:, 0], normals[:, 1], -normals[:, 1], normals[:, 2], -normals[:, 2]])
    side: I64 = facing.argmax(axis=0)
    rows = np.arange(len(side))
    for _ in range(8):  # straighten borders: a face goes with two neighbours that agree
        around = np.sort(side[near], axis=1)
        fits = (around[:, 0] == around[:, 1]) | (around[:, 1] == around[:, 2])
        fits &= facing[around[:, 1], rows] > 0.4
        side = np.where(fits, around[:, 1], side)
    for _ in range(6):
        patch = _components(near, side)
        small = np.bincount(patch)[patch] < SMALL
        votes = np.where(small, -1, side)[near]  # of the neighbours in larger patches
        for choice in range(3):
            wanted = votes[:, choice]
            fits = small & (wanted >= 0) & (facing[wanted, rows] > 0.25)
            side = np.where(fits, wanted, side)
            small &= ~fits
    return side


def _components(near: I64, label: I64) -> I64:
    """(F,): a number for each connected patch of equal labels, by passing the lowest face number on."""
    same = label[near] == label[:, None]
    patch = np.arange(len(label))
    while True:
        lowest = np.minimum(patch, np.where(same, patch[near], patch[:, None]).min(axis=1))
        lowest = lowest[lowest]
        if np.array_equal(lowest, patch):
            break
        patch = lowest
    numbers: I64 = np.unique(patch, return_inverse=True)[1]
    return numbers


def _flattened(corners: F64, side: I64) -> F64:
    """(F, 3, 2): the corners as seen from each face's side, right and down."""
    right = np.array([[0, 0, -1], [0, 0, 1], [1, 0, 0], [1, 0, 0], [1, 0, 0], [-1, 0, 0]], float)
    down = np.array([[0, -1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1], [0, -1, 0], [0, -1, 0]], float)
    axes = np.stack([right[side], down[side]], axis=1)
    flat: F64 = np.einsum("fkd,fad->fka", corners, axes)
    return flat


def _split(plane: F64, chart: I64, near: I64) -> I64:
    """Charts whose faces overlap, divided until none do: the overlapping faces leave for a chart of their own."""
    scale = 1000 / np.ptp(plane.reshape(-1, 2), axis=0).max()
    texels = (plane - plane.min(axis=(0, 1))) * scale
    stride = int(texels.max()) + 2
    face, row, column, _ = covered(texels)
    while True:
        place = (chart[face] * stride + row) * stride + column
        order = np.lexsort((face, place))
        shared = np.flatnonzero(place[order][1:] == place[order][:-1]) + 1
        if not len(shared):
            return chart
        covering = np.zeros(len(chart), bool)
        covering[face[order[shared]]] = True
        wider = covering
        for _ in range(3):  # a few faces around them go as well: no charts of single faces
            wider = wider | (wider[near] & (chart[near] == chart[:, None])).any(axis=1)
        stays = np.bincount(chart[~wider], minlength=chart.max() + 1) > 0
        chart = _components(near, chart * 2 + np.where(stays[chart], wider, covering))


def covered(corners: F64) -> tuple[I64, I64, I64, F64]:
    """The texel centres inside triangles (F, 3, 2), given in texels.

    (N,) each: the triangle, row and column; and (N, 3) the weights of its corners there. Those on an edge count for
    no triangle.
    """
    low = np.floor(corners.min(axis=1)).astype(np.int64)
    width, height = (np.ceil(corners.max(axis=1)).astype(np.int64) - low).T
    area = width * height
    face = np.repeat(np.arange(len(corners)), area)
    number = np.arange(area.sum()) - np.repeat(np.cumsum(area) - area, area)
    row = low[face, 1] + number // width[face]
    column = low[face, 0] + number % width[face]
    a, b, c = (corners[face, k] for k in range(3))
    point = np.stack([column, row], axis=1) + 0.5
    whole = _cross(b - a, c - a)
    u, v = _cross(point - a, c - a), _cross(b - a, point - a)
    u, v = (np.divide(part, whole, out=np.full(len(whole), -1.0), where=whole != 0) for part in (u, v))
    inside = (u > 1e-9) & (v > 1e-9) & (u + v < 1 - 1e-9)
    u, v = u[inside], v[inside]
    return face[inside], row[inside], column[inside], np.stack([1 - u - v, u, v], axis=1)


def _cross(a: F64, b: F64) -> F64:
    """(N,): the third component of the cross product of plane vectors (N, 2)."""
    product: F64 = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return product


def _pack(plane: F64, chart: I64, size: int, gap: int) -> F64:
    """UV: all charts at one scale, the largest that fits, in rows of falling height."""
    count = int(chart.max()) + 1
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, chart, plane.min(axis=1))
    np.maximum.at(high, chart, plane.max(axis=1))
    extent = high - low
    order = np.lexsort((-extent[:, 0], -extent[:, 1]))
    smallest, largest = 0.0, size / extent.max()
    place = np.zeros((count, 2))
    for _ in range(40):
        scale = (smallest + largest) / 2
        found = _shelves(np.ceil(extent * scale) + gap, order, size)
        if found is None:
            largest = scale
        else:
            smallest, place = scale, found
    uv: F64 = ((plane - low[chart][:, None]) * smallest + place[chart][:, None] + gap / 2) / size
    return uv


def _shelves(boxes: F64, order: I64, size: int) -> F64 | None:
    """Upper left corners of boxes (N, 2), set in `order` from left to right in rows; None if they do not fit."""
    place = np.zeros_like(boxes)
    x = y = height = 0.0
    for box in order:
        if x + boxes[box, 0] > size:
            x, y, height = 0.0, y + height, 0.0
        place[box] = x, y
        x, height = x + boxes[box, 0], max(height, boxes[box, 1])
        if x > size or y + height > size:
            return None
    return place


def paint(atlas: Atlas, positions: F64, faces: I32, colour: Callable[[F64], F64]) -> U8:
    """A texture (size, size, 3): `colour` maps points in space (N, 3) to sRGB (N, 3) in 0…1.

    Texels outside the charts take the colour of the nearest texel inside, a few texels far.
    """
    places = np.zeros((atlas.size, atlas.size, 3))
    known = np.zeros((atlas.size, atlas.size), bool)
    face, row, column, weights = covered(atlas.uv * atlas.size)
    places[row, column] = np.einsum("nk,nkd->nd", weights, positions[faces[face]])
    known[row, column] = True
    image = np.full((atlas.size, atlas.size, 3), 0.5)
    image[known] = colour(places[known])
    for _ in range(4):
        for shift, axis in ((1, 0), (-1, 0), (1, 1), (-1, 1)):
            spread = ~known & np.roll(known, shift, axis)
            image[spread] = np.roll(image, shift, axis)[spread]
            known |= spread
    texels: U8 = np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)
    return texels
