"""Values on a surface as colours: distances, weights, segments."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.mesh import F32, F64, I32
from lodpipe.geometry.flatten import Soup
from lodpipe.geometry.texture import U8
from lodpipe.kernel.surfaces import TriangleTree

RAMP = ("#b4bcc8", "#f3e08f", "#f5a623", "#d7301f", "#67001f")
"""Nothing, little … much: from pale grey through yellow to dark red."""
DECADES = 1000.0


def ramp(values: F64 | F32) -> U8:
    """(N, 3) uint8 sRGB colours of `values` (N,) in 0…1, evenly along RAMP; values outside are clipped."""
    stops = np.array([_rgb(colour) for colour in RAMP], np.float64)
    at = np.clip(np.nan_to_num(np.asarray(values, np.float64)), 0.0, 1.0)
    columns = [np.interp(at, np.linspace(0, 1, len(stops)), stops[:, k]) for k in range(3)]
    return np.rint(np.stack(columns, axis=-1)).astype(np.uint8)


def place(distance: F64, top: float) -> F64:
    """Places on the ramp, 0…1, of `distance`, 0…`top`: almost logarithmic over three powers of ten, with a zero.

    A third of the ramp is a hundredth of `top`, two thirds a tenth, so that levels a hundred times apart in error
    can be shown on one scale.
    """
    if not top > 0:
        return np.zeros(np.shape(distance))
    places: F64 = np.log1p(DECADES * np.clip(distance / top, 0.0, 1.0)) / np.log1p(DECADES)
    return places


def value_at(at: float, top: float) -> float:
    """The distance at a place on the ramp: the inverse of `place`."""
    return top * float(np.expm1(at * np.log1p(DECADES)) / DECADES)


def distance_to(source: Soup, level: Soup, points: F64 | None = None, threads: int = 0) -> F64:
    """Distance of each vertex of `source` (or of `points` (N, 3)) to the surface of `level`, in % of the source's
    bounding-box diagonal. Raises ValueError for a level without triangles.
    """
    _, distance, _ = _closest(source, level, source.positions if points is None else points, threads)
    return 100.0 * distance


def nearest_vertices(source: Soup, points: F64, threads: int = 0) -> I32:
    """(N,) rows of the source's positions: of the triangle nearest to each of `points` (N, 3), the nearest corner."""
    asked, _, faces = _closest(source, source, points, threads)
    low, high = source.bounds
    corners = (source.positions[source.faces[faces]] - (low + (high - low) / 2)) / (source.diagonal or 1.0)
    best = np.square(corners - asked[:, None]).sum(axis=2).argmin(axis=1)
    rows: I32 = source.faces[faces, best]
    return rows


def _closest(frame: Soup, surface: Soup, points: F64, threads: int) -> tuple[F32, F64, I32]:
    """`points` in the frame's diagonals about its centre, their distances from `surface` in diagonals, the faces."""
    low, high = frame.bounds
    centre, scale = low + (high - low) / 2, frame.diagonal or 1.0
    tree = TriangleTree(((surface.positions - centre) / scale).astype(np.float32), surface.faces, threads)
    asked = ((points - centre) / scale).astype(np.float32)
    distance, _, faces = tree.closest(asked)
    return asked, distance, faces


def _rgb(colour: str) -> NDArray[np.uint8]:
    return np.frombuffer(bytes.fromhex(colour[1:]), np.uint8)
