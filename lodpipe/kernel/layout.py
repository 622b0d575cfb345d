"""Charts, overlaps, gutters, texels and packing of UV layouts: checked wrappers over the compiled module."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.errors import InvalidMesh
from lodpipe.core.mesh import F32, F64, I32
from lodpipe.kernel import _column, _indices, _native, _table


@dataclass(frozen=True, eq=False)
class UvOverlaps:
    """charts (P, 2) int32, pairs that overlap, the lower first; area (P, 2) float64, what triangles of the same and of
    opposite orientation share; faces (F,) bool; complete: False if `limit` ended the search."""

    charts: I32
    area: F64
    faces: NDArray[np.bool_]
    complete: bool


@dataclass(frozen=True, eq=False)
class UvRaster:
    """faces (H, W) int32, −1 where nothing is near; weights (H, W, 3) float32 barycentric; inside (H, W) bool, whether
    the texel's centre lies in the face and not only near one of its edges."""

    faces: I32
    weights: F32
    inside: NDArray[np.bool_]


def chart_labels(corners: I32) -> I32:
    """(F,) int32 labels of the charts of `corners` (F, 3): faces that share two corners hang together.

    Labels are 0, 1, … in the order of the charts' first faces.
    """
    labels = _native.chart_labels(_table(corners, np.int32, 3, "corners"))
    return cast("I32", labels)


def join_pairs(pairs: I32, nodes: int) -> I32:
    """(nodes,) int32: the lowest node of each node's connected part, of the graph with the edges `pairs` (N, 2)."""
    table = _table(pairs, np.int32, 2, "pairs")
    _indices(table, nodes, "pairs")
    return cast("I32", _native.join_pairs(table, int(nodes)))


def uv_overlaps(uv: F64, chart: I32, group: I32, slack: float = 1e-7, limit: int = 100_000_000) -> UvOverlaps:
    """Which of the triangles `uv` (F, 3, 2) of one `group` (F,) overlap, and how much of their charts' area is common.

    Triangles are clipped against each other; what is thinner than `slack` (UV units) counts as touching. At most
    `limit` pairs are looked at. Raises InvalidMesh for coordinates that are not finite.
    """
    found = _native.uv_overlaps(*_uv_faces(uv, chart, group), float(slack), int(limit))
    return UvOverlaps(**{**found, "faces": found["faces"].astype(bool)})


def uv_coverage(uv: F64, group: I32, lines: int = 4096) -> F64:
    """(G, 2) float64: the area that at least one, and at least two, of each group's triangles `uv` (F, 3, 2) cover.

    Integrated exactly along each of `lines` scan lines over the group's height, by the midpoint rule across them.
    """
    table, group, _ = _uv_faces(uv, group, group)
    areas = _native.uv_coverage(table, group, int(group.max(initial=-1)) + 1, int(lines))
    return cast("F64", areas)


def uv_gaps(segments: F64, chart: I32, group: I32, groups: int, reach: float) -> F64:
    """(groups,) float64: the least distance between `segments` (N, 2, 2) of different charts of a group, ≤ `reach`."""
    table = _table(np.reshape(segments, (-1, 4)), np.float64, 4, "segments")
    rows = len(table)
    gaps = _native.uv_gaps(
        table, _column(chart, np.int32, rows, "chart"), _column(group, np.int32, rows, "group"), groups, float(reach)
    )
    return cast("F64", gaps)


def uv_raster(uv: F64, edges: I32, window: tuple[int, int, int, int], reach: float = 0.0, threads: int = 0) -> UvRaster:
    """The triangle of `uv` (F, 3, 2), in texels, under the centre of each texel of `window` (left, top, width, height).

    The lowest face wins where several cover a centre. A texel that none covers takes the nearest point, up to `reach`
    texels away, of `edges` (N, 2): rows of a face and of its corner from which the edge starts.
    """
    left, top, width, height = (int(value) for value in window)
    if min(width, height) < 1 or width * height > 1 << 28:
        raise InvalidMesh(f"a window of {width} × {height} texels cannot be filled")
    table = _table(np.reshape(uv, (-1, 6)), np.float64, 6, "uv")
    edges = _table(edges, np.int32, 2, "edges")
    _indices(edges[:, 0], len(table), "edges")
    _indices(edges[:, 1], 3, "sides of edges")
    found = _native.uv_raster(
        _finite(table), edges, left, top, width, height, float(reach), threads or os.cpu_count() or 1
    )
    weights = found["weights"].reshape(height, width, 3)
    return UvRaster(found["faces"], weights, found["inside"].astype(bool))


def _uv_faces(uv: F64, chart: I32, group: I32) -> tuple[Any, Any, Any]:
    table = _finite(_table(np.reshape(uv, (-1, 6)), np.float64, 6, "uv"))
    chart, group = (_column(column, np.int32, len(table), "charts and groups") for column in (chart, group))
    if group.size and (int(group.min()) < 0 or int(group.max()) > len(table)):
        raise InvalidMesh("groups are numbered from 0")
    return table, chart, group


def _finite(table: Any) -> Any:
    if not np.isfinite(table).all():
        raise InvalidMesh("UVs are not finite")
    return table


@dataclass(frozen=True, eq=False)
class UvPacking:
    """scale: texels to a unit, 0 where the charts do not fit; corner (C, 2) float64: where the lowest corner of each
    chart's turned box goes, in texels; turn (C,) int32: by how many quarters, from u towards −v."""

    scale: float
    corner: F64
    turn: I32


def uv_pack(
    uv: F64, chart: I32, size: tuple[int, int], padding: float, largest: float = float("inf"), cells: int = 256
) -> UvPacking:
    """Put charts side by side into `size` (width, height) texels at one scale, the largest that is found.

    `uv` (F, 3, 2), in any unit, are triangles of the charts `chart` (F,), 0 … C − 1; the lowest corner of each chart's
    bounding box lies at the origin. Between two charts at least `padding` texels stay empty, half of it at the outside.
    The rectangle is divided into at most `cells` cells along its longer side; `largest` bounds the scale.
    """
    table, chart, _ = _uv_faces(uv, chart, chart)
    width, height = (int(side) for side in size)
    if min(width, height) < 1 or not padding >= 0:
        raise InvalidMesh(f"charts cannot be packed into {width} × {height} texels with a padding of {padding:g}")
    count = int(chart.max(initial=-1)) + 1
    return UvPacking(
        **_native.uv_pack(table, chart, count, width, height, float(padding), int(cells), min(float(largest), 1e30))
    )
