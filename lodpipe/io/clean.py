"""Repairs of what files get wrong: each says what it did through `warn`, so that nothing is mended in silence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.mesh import F32, F64
from lodpipe.io.weld import unique_rows

Warn = Callable[[str], None]
Indices = NDArray[Any]  # (F, 3) of any integer type


def drop_out_of_range(faces: Indices, rows: int, place: str, warn: Warn) -> Indices:
    """`faces` without those that name a row beyond `rows`, or below 0."""
    if not len(faces) or (int(faces.min()) >= 0 and int(faces.max()) < rows):
        return faces
    good = ((faces >= 0) & (faces < rows)).all(axis=1)
    warn(f"{place}: {count_faces(len(faces) - int(good.sum()))} with an index out of range left out")
    return faces[good]


def drop_non_finite(faces: Indices, positions: NDArray[Any], place: str, warn: Warn) -> Indices:
    """`faces` without those that use a position that is NaN or infinite."""
    if np.isfinite(positions).all():
        return faces
    finite = np.isfinite(positions).all(axis=1)
    good: NDArray[np.bool_] = finite[faces].all(axis=1)
    bad_rows = int(len(finite) - finite.sum())
    if not good.all():
        dropped = count_faces(len(faces) - int(good.sum()))
        are = "1 position is not finite" if bad_rows == 1 else f"{bad_rows:,} positions are not finite"
        warn(f"{place}: {are}; {dropped} left out")
    kept: Indices = faces[good]
    return kept


def drop_doubles(faces: Indices, owner: Indices, place: str, warn: Warn) -> NDArray[np.intp]:
    """The rows of `faces` without exact copies: same three positions, same orientation, same primitive.

    A face with two equal corners is no copy of anything, and a copy that is turned over is the back of a thin
    sheet: both stay.
    """
    corner = faces.argmin(axis=1)
    row = np.arange(len(faces))
    turned = [faces[row, (corner + k) % 3] for k in range(3)]
    first, _ = unique_rows([*turned, owner])
    if len(first) == len(faces):
        return row
    keep = (turned[0] == turned[1]) | (turned[1] == turned[2]) | (turned[2] == turned[0])
    keep[first] = True
    if not keep.all():
        warn(f"{place}: {count_faces(len(faces) - int(keep.sum()))} that are exact doubles of others left out")
    return np.flatnonzero(keep)


def finite_attribute(name: str, values: F32, place: str, warn: Warn) -> F32:
    """`values` (W, K) with each row that is not finite replaced: UVs by 0, colours by 1, vectors by 0.

    A zero NORMAL or TANGENT has no direction; `directions` gives it one.
    """
    if np.isfinite(values).all():
        return values
    bad = np.logical_not(np.isfinite(values).all(axis=1))
    fill = 1.0 if name.startswith("COLOR_") else 0.0
    warn(f"{place}: {int(bad.sum()):,} of {len(values):,} {name} values are not finite; set to {fill:g}")
    mended: F32 = np.where(bad[:, None], np.float32(fill), values)
    return mended


def directions(normals: F32, positions: F64, faces: Indices, wedges: Indices) -> F32:
    """Unit `normals` (W, 3) for each wedge: those of (nearly) no length are taken from the faces round the position.

    Lengths within 1e-6 of 1 are left as they are, bit by bit. A wedge without any area round it gets +z.
    """
    with np.errstate(over="ignore"):
        length = np.linalg.norm(normals.astype(np.float64), axis=1)
    bad = ~((length > 1e-8) & (length < 1e30))
    off = (np.abs(length - 1.0) > 1e-6) & ~bad
    if not (bad.any() or off.any()):
        return normals
    result = normals.copy()
    result[off] = (normals[off] / length[off, None]).astype(np.float32)
    if bad.any():
        rows = np.zeros(len(normals), np.int64)
        rows[wedges.ravel()] = faces.ravel()
        result[bad] = vertex_normals(positions, faces)[rows[bad]].astype(np.float32)
    return result


def vertex_normals(positions: F64, faces: Indices) -> F64:
    """Area-weighted unit normals (V, 3) of the faces round each position; +z where they cancel or have no area."""
    cross = face_cross(positions, faces)
    total = np.zeros_like(positions)
    for axis in range(3):
        for corner in range(3):
            total[:, axis] += np.bincount(faces[:, corner], cross[:, axis], len(positions))
    length = np.linalg.norm(total, axis=1)
    flat = ~(length > 0)
    total[flat], length[flat] = (0.0, 0.0, 1.0), 1.0
    unit: F64 = total / length[:, None]
    return unit


def face_cross(positions: F64, faces: Indices) -> F64:
    """(F, 3): twice the area times the normal, in units in which the largest extent of the faces is 1."""
    corners = positions[faces]
    if len(faces):
        low = corners.min(axis=(0, 1))
        corners -= low
        corners /= float(corners.max()) or 1.0
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    cross: F64 = np.cross(b - a, c - a)
    return cross


def has_area(positions: F64, faces: Indices, chunk: int = 65536) -> bool:
    """Whether any face has an area. Looks at faces until it finds one."""
    return any(bool(face_cross(positions, faces[i : i + chunk]).any()) for i in range(0, len(faces), chunk))


def count_faces(count: int) -> str:
    """`1 face`, `2 faces` …"""
    return "1 face" if count == 1 else f"{count:,} faces"
