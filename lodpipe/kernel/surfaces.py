"""Closest points, normals and pictures of a surface: checked wrappers over the compiled module."""

from __future__ import annotations

import os
from typing import cast

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.errors import InvalidMesh
from lodpipe.core.mesh import F32, F64, I32
from lodpipe.core.rays import Hits
from lodpipe.kernel import _column, _indices, _native, _table


class TriangleTree:
    """A surface's triangles, ready for questions about what lies near.

    positions (V, 3) float32 and faces (F, 3) int32; centre them and scale them to about unit size first. Building takes
    about 0.2 s and 110 bytes a triangle for a million of them; a question near the surface takes two microseconds, far
    from very many triangles that are almost equally near as much as a millisecond. Points that follow one another in
    space are answered faster. `threads` bounds the threads of a question, 0 for all cores; answers do not depend on
    them. Raises InvalidMesh for positions that are not finite and faces that point outside of them.
    """

    def __init__(self, positions: F32, faces: I32, threads: int = 0) -> None:
        positions, faces = _table(positions, np.float32, 3, "positions"), _table(faces, np.int32, 3, "faces")
        if not np.isfinite(positions).all():
            raise InvalidMesh("positions are not finite")
        _indices(faces, len(positions), "faces")
        self.empty = len(faces) == 0
        self._threads = threads or os.cpu_count() or 1
        self._tree = _native.TriangleTree(positions, faces)

    def closest(self, points: F32) -> tuple[F64, F64, I32]:
        """The closest point of the surface to each of `points` (N, 3): distances (N,), points (N, 3) and faces (N,).

        Of faces that are equally near the first counts. Raises ValueError for a surface without triangles.
        """
        if self.empty:
            raise ValueError("a surface without triangles has no closest points")
        return self._tree.closest(_table(points, np.float32, 3, "points"), self._threads)

    def facing(self, points: F32, normals: F64, reach: F64) -> I32:
        """(N,) of the faces that each point's normal line meets within ±`reach` (N,), and whose normals have a positive
        product with the unit `normals` (N, 3), the one met nearest to the point; −1 where there is none."""
        points, normals = _table(points, np.float32, 3, "points"), _table(normals, np.float64, 3, "normals")
        reach = np.ascontiguousarray(reach, np.float64)
        if not len(points) == len(normals) == reach.size:
            raise InvalidMesh(f"{len(points)} points, {len(normals)} normals and {reach.size} reaches")
        return cast(I32, self._tree.facing(points, normals, reach, self._threads))


def crease_normals(positions: F64, faces: I32, degrees: float, threads: int = 0) -> F32:
    """(F, 3, 3) float32: a unit normal for each corner of `faces` (F, 3), rows of `positions` (V, 3).

    A corner's normal is the mean of the faces around its vertex that are turned from its own face by at most
    `degrees`, 0…180, each weighted by its angle at the vertex (Thürmer & Wüthrich 1998); zero where none of them has
    an area. Around a vertex with a crease a corner looks at no more than the 1,024 faces next to it in the list.
    """
    positions, faces = _table(positions, np.float64, 3, "positions"), _table(faces, np.int32, 3, "faces")
    _indices(faces, len(positions), "faces")
    least = float(np.cos(np.radians(degrees)))
    normals = cast(F32, _native.crease_normals(positions, faces, least, threads or os.cpu_count() or 1))
    return normals.reshape(-1, 3, 3)


def face_normals(positions: F32, faces: I32) -> F32:
    """(F, 3) float32: the unit normal of each of `faces` (F, 3), rows of `positions` (V, 3); zero without an area."""
    positions, faces = _table(positions, np.float32, 3, "positions"), _table(faces, np.int32, 3, "faces")
    _indices(faces, len(positions), "faces")
    return cast(F32, _native.face_normals(positions, faces))


def raster(
    positions: F32,
    faces: I32,
    axes: tuple[F64, F64, F64, F64],
    size: float,
    perspective: bool,
    shape: tuple[int, int],
    rows: slice,
    behind: F32 | None = None,
) -> Hits | None:
    """What the rays through the pixels of `rows` of a picture meet first, by drawing the triangles; rows from the top.

    axes    the eye (or the middle of an orthographic picture's plane), and unit vectors to the right, up and ahead
    size    half the picture's height, in the positions' unit; of a perspective picture the tangent of half its angle
    shape   (height, width) of the whole picture in pixels
    behind  (N,) float32: what lies nearer is looked through; infinity: nothing is looked for

    Distances are along rays of unit length. None where a vertex lies beside or behind the eye of a perspective view (or
    within a thousandth before it): that takes real rays.
    """
    positions, faces = _table(positions, np.float32, 3, "positions"), _table(faces, np.int32, 3, "faces")
    _indices(faces, len(positions), "faces")
    view = np.array([*(x for axis in axes for x in axis), size], np.float64)
    height, width = shape
    top, bottom, _ = rows.indices(height)
    if behind is not None:
        behind = _column(behind, np.float32, (bottom - top) * width, "behind")
    found = _native.raster(positions, faces, view, perspective, width, height, top, bottom, behind)
    return None if found is None else Hits(*cast(tuple[F32, I32, F32], found))


class Silhouettes:
    """What orthographic views show of a surface, as bits, to compare small meshes with: some ten thousand a second.

    points (V, 3) float64 and faces (F, 3) int32 of the surface; axes (N, 2, 3): for each view vectors to the right and
    up, such that p · axis is −1 at one border of the picture and 1 at the other; size: pixels along a side. A pixel is
    set if its centre lies in the shadow of a triangle. Raises InvalidMesh for faces that point outside of `points`.
    """

    def __init__(self, points: F64, faces: I32, axes: F64, size: int, threads: int = 0) -> None:
        self.axes = _table(np.asarray(axes, np.float64).reshape(-1, 6), np.float64, 6, "axes")
        self.size = size
        self._threads = threads or os.cpu_count() or 1
        self.bits = cast(NDArray[np.uint64], _native.silhouettes(*_mesh(points, faces), self.axes, size))

    def overlap(self, points: F64, faces: I32) -> float:
        """The mean over the views of intersection over union with another mesh's silhouettes."""
        return float(_native.silhouette_overlap(*_mesh(points, faces), self.axes, self.size, self.bits))

    def overlaps_moved(self, points: F64, faces: I32, vertex: I32, places: F64) -> F64:
        """(K,) that overlap for K meshes in each of which one `vertex` (K,) is at another of `places` (K, 3).

        A collapse of an edge onto one of its ends is such a move: of the vertex that goes, to the one that stays.
        Raises InvalidMesh for vertices that `points` does not have.
        """
        vertex = _column(np.ascontiguousarray(vertex, np.int32), np.int32, len(places), "vertex")
        if len(vertex) and not 0 <= vertex.min() <= vertex.max() < len(points):
            raise InvalidMesh(f"vertices to move must lie in 0…{len(points) - 1}")
        places = _table(np.ascontiguousarray(places, np.float64), np.float64, 3, "places")
        bits, size = self.bits, self.size
        found = _native.silhouette_moves(*_mesh(points, faces), vertex, places, self.axes, size, bits, self._threads)
        return cast(F64, found)


def _mesh(points: F64, faces: I32) -> tuple[F64, I32]:
    points, faces = _table(points, np.float64, 3, "points"), _table(faces, np.int32, 3, "faces")
    _indices(faces, len(points), "faces")
    if not np.isfinite(points).all():
        raise InvalidMesh("points are not finite")
    return points, faces
