"""Pictures of UV layouts, with what is wrong in colour."""

from __future__ import annotations

import numpy as np

from lodpipe.core.mesh import F64, Mesh
from lodpipe.geometry.charts import Charts, charts_of
from lodpipe.geometry.texture import U8
from lodpipe.kernel import layout

PAPER = (247, 247, 248)
OUTSIDE = (228, 228, 232)
"""What lies outside the texture, [0, 1]."""
PLAIN = (196, 211, 226)
FLIPPED = (240, 196, 110)
OVERLAPPED = (226, 96, 86)
LINES = (150, 168, 188)
BORDERS = (38, 52, 72)
"""sRGB: charts, mirrored ones, faces that overlap others, edges, borders of charts."""
LARGEST = 8.0
"""Layouts are shown up to so many tiles from the texture."""


def uv_picture(mesh: Mesh, name: str = "TEXCOORD_0", size: int = 512, material: int | None = None) -> U8:
    """The layout of a UV set as a picture (size, size, 3) uint8 sRGB, v = 0 at the top.

    Mirrored faces are amber, overlapping ones red; all of the layout is seen, the texture lighter than what is outside.
    `material`: only the faces of that row of `Asset.materials`.
    """
    charts = charts_of(mesh, name)
    if material is not None:
        charts = _of_material(mesh, charts, material)
    low, extent = _window(charts)
    to_picture = (size - 8) / extent
    uv = (charts.uv - low) * to_picture + 4
    picture = _ground(size, low, to_picture)
    if not len(uv):
        return picture
    lapping = layout.uv_overlaps(charts.uv, charts.label, charts.group, limit=20_000_000).faces
    order = np.argsort(~lapping, kind="stable")  # where faces lie on one another, the first of them is seen
    fills = np.where((charts.doubled_area > 0)[:, None], FLIPPED, PLAIN)
    fills[lapping] = OVERLAPPED
    window = (0, 0, size, size)
    seen = layout.uv_raster(uv[order], np.zeros((0, 2), np.int32), window)
    picture[seen.inside] = fills[order][seen.faces[seen.inside]]
    sides = np.stack([np.repeat(np.arange(len(uv)), 3), np.tile(np.arange(3), len(uv))], axis=1).astype(np.int32)
    if len(uv) * 40 < size * size:  # more edges than that would hide the faces
        _draw(picture, uv, sides, 0.5, LINES)
    _draw(picture, uv, charts.borders, 0.75, BORDERS)
    return picture


def _draw(picture: U8, uv: F64, sides: np.ndarray, reach: float, colour: tuple[int, int, int]) -> None:
    flat = np.repeat(uv[sides[:, 0], sides[:, 1]][:, None], 3, axis=1)
    flat[:, 1] = uv[sides[:, 0], (sides[:, 1] + 1) % 3]
    edges = np.stack([np.arange(len(sides)), np.zeros(len(sides))], axis=1).astype(np.int32)
    near = layout.uv_raster(flat, edges, (0, 0, *picture.shape[1::-1]), reach)
    picture[near.faces >= 0] = colour


def _of_material(mesh: Mesh, charts: Charts, material: int) -> Charts:
    keep = mesh.face_material[charts.rows] == material
    corners, label = charts.corners[keep], charts.label[keep]
    _, label = np.unique(label, return_inverse=True)
    return Charts(charts.rows[keep], charts.uv[keep], corners, charts.group[keep], label.astype(np.int32))


def _window(charts: Charts) -> tuple[F64, float]:
    """Lowest corner and side of the square that is shown."""
    corners = np.concatenate([charts.uv.reshape(-1, 2), [[0.0, 0.0], [1.0, 1.0]]])
    corners = np.clip(corners, -LARGEST, LARGEST + 1)
    low, high = corners.min(axis=0), corners.max(axis=0)
    extent = float((high - low).max())
    return (low + high - extent) / 2, extent


def _ground(size: int, low: F64, to_picture: float) -> U8:
    centre = (np.arange(size) + 0.5 - 4) / to_picture
    inside = [(low[axis] + centre >= 0) & (low[axis] + centre <= 1) for axis in (1, 0)]
    picture = np.empty((size, size, 3), np.uint8)
    picture[:] = np.where((inside[0][:, None] & inside[1])[..., None], PAPER, OUTSIDE)
    return picture
