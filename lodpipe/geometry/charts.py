"""Charts: the pieces of a UV set that hang together, as they lie in the texture."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lodpipe.core.mesh import F64, I32, Mesh
from lodpipe.geometry.flatten import Bool
from lodpipe.kernel import layout


@dataclass(frozen=True, eq=False)
class Charts:
    """One UV set of a mesh, cut into charts; rows are those faces of the mesh that have it.

    rows     (N,) int32, rows of the mesh's faces
    uv       (N, 3, 2) float64
    corners  (N, 3) int32: numbers of UV vertices, equal where position, UV and material are
    group    (N,) int32: 0, 1, … for each material; every group has a texture space of its own
    label    (N,) int32: the chart of each face, 0, 1, … in the order of their first faces
    """

    rows: I32
    uv: F64
    corners: I32
    group: I32
    label: I32

    @cached_property
    def count(self) -> int:
        """Number of charts."""
        return int(self.label.max(initial=-1)) + 1

    @cached_property
    def doubled_area(self) -> F64:
        """(N,) float64: twice the signed area in UV space; positive where the texture is seen mirrored (v is down)."""
        a, b = self.uv[:, 1] - self.uv[:, 0], self.uv[:, 2] - self.uv[:, 0]
        area: F64 = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        return area

    @cached_property
    def borders(self) -> I32:
        """(B, 2) int32: the edges at which a chart ends, as row of `uv` and the corner from which the edge runs."""
        return borders_of(self.corners)

    @cached_property
    def chart_group(self) -> I32:
        """(count,) int32: the group of each chart."""
        groups = np.zeros(self.count, np.int32)
        groups[self.label] = self.group
        return groups

    @cached_property
    def bounds(self) -> tuple[F64, F64]:
        """(count, 2) float64 each: lowest and highest UV of each chart."""
        low, high = np.full((self.count, 2), np.inf), np.full((self.count, 2), -np.inf)
        for corner in range(3):
            np.minimum.at(low, self.label, self.uv[:, corner])
            np.maximum.at(high, self.label, self.uv[:, corner])
        return low, high


def charts_of(mesh: Mesh, name: str = "TEXCOORD_0") -> Charts:
    """The charts of the UV set `name` of `mesh`; none where no face has it. Values that are not finite are none."""
    values = mesh.attributes.get(name)
    has = np.array([name in primitive.attributes for primitive in mesh.primitives], bool)[mesh.face_primitive]
    if values is None or not has.any():
        none = np.zeros(0, np.int32)
        return Charts(none, np.zeros((0, 3, 2)), np.zeros((0, 3), np.int32), none, none)
    finite: Bool = np.logical_and.reduce(np.isfinite(values[:, :2]), axis=1)
    if not finite.all():
        has &= finite[mesh.wedges].all(axis=1)
    rows = np.flatnonzero(has).astype(np.int32)
    wedges, positions = mesh.wedges[rows], mesh.faces[rows]
    _, group = np.unique(mesh.face_material[rows], return_inverse=True)
    owner = np.zeros(len(values), np.int64)  # a wedge has one position and one primitive
    owner[wedges] = positions
    wedge_group = np.zeros(len(values), np.int64)
    wedge_group[wedges] = group[:, None]
    place = np.ascontiguousarray(values[:, :2] + np.float32(0.0)).view(np.uint64)[:, 0]  # −0 is 0
    number = _numbers(owner + wedge_group * len(mesh.positions), place)
    corners = np.ascontiguousarray(number[wedges])
    uv = values[:, :2].astype(np.float64)[wedges]
    return Charts(rows, uv, corners, group.astype(np.int32), layout.chart_labels(corners))


def borders_of(corners: I32) -> I32:
    """(B, 2) int32: the sides that only one of `corners` (F, 3) has, as row and corner from which the side runs."""
    edges, _ = _edges(corners)
    _, inverse, count = np.unique(edges, return_inverse=True, return_counts=True)
    single = np.flatnonzero(count[inverse] == 1)
    return np.stack([single // 3, single % 3], axis=1).astype(np.int32)


def seam_edges(mesh: Mesh, charts: Charts) -> I32:
    """(S, 2) int32 positions of the edges that faces share in space and not in the texture."""
    in_texture, _ = _edges(charts.corners)
    in_space, ends = _edges(mesh.faces[charts.rows])
    _, first, inverse, faces = np.unique(in_space, return_index=True, return_inverse=True, return_counts=True)
    _, alike, count = np.unique(in_texture, return_inverse=True, return_counts=True)
    torn = np.zeros(len(faces), bool)
    # an edge is torn where not all of its faces meet at it in the texture too
    torn[inverse[count[alike] < faces[inverse]]] = True
    return ends[first[torn]].astype(np.int32)


def _edges(corners: I32) -> tuple[np.ndarray, np.ndarray]:
    """(3N,) int64 a number for each side of each face, equal for equal ends; and the (3N, 2) ends, the lower first."""
    sides = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2).astype(np.int64)
    low, high = sides.min(axis=1), sides.max(axis=1)
    return low << 32 | high, np.stack([low, high], axis=1)


def _numbers(first: np.ndarray, second: np.ndarray) -> I32:
    """(N,) int32: equal numbers for rows in which both arrays are equal."""
    order = np.lexsort((second, first))
    a, b = first[order], second[order]
    new = np.ones(len(order), bool)
    new[1:] = (a[1:] != a[:-1]) | (b[1:] != b[:-1])
    numbers = np.empty(len(order), np.int32)
    numbers[order] = np.cumsum(new) - 1
    return numbers
