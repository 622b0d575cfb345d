"""New UV layouts: triangles unfolded into charts, and charts packed into a texture."""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lodpipe.core.errors import Cancelled, InvalidMesh
from lodpipe.core.mesh import F64, I32
from lodpipe.geometry.flatten import Bool
from lodpipe.geometry.normals import face_normals
from lodpipe.geometry.topology import flat_faces
from lodpipe.kernel import layout

MAX_FACES = 150_000
"""More than that take xatlas longer than anybody waits (35 s for 82,000); they are unfolded by their directions."""
POLL = 0.2
"""Seconds between looks at whether the work was cancelled."""


@dataclass(frozen=True, eq=False)
class Unfolded:
    """Charts in the plane, each at the size of its surface: uv (F, 3, 2) float64, label (F,) int32 0, 1, …

    `problem` says what xatlas did not do, empty if nothing; `left_out` faces have no area and lie in a point.
    """

    uv: F64
    label: I32
    problem: str = ""
    left_out: int = 0


def unfold(
    positions: F64,
    faces: I32,
    *,
    seconds: float = 60.0,
    max_cost: float = 2.0,
    cancelled: Callable[[], bool] = lambda: False,
) -> Unfolded:
    """Charts for all of `faces` (F, 3), none of which overlaps another part of itself.

    By xatlas, in a process of its own that is ended after `seconds`. It is given each face once (copies and backs make
    charts of their own), at a scale at which it drops none for being small, and no face without area. What it leaves
    out, or all when it fails, is laid out by the directions that faces look in. Raises Cancelled.
    """
    solid, scaled = _cleaned(positions, faces)
    uv, label = np.zeros((len(faces), 3, 2)), np.full(len(faces), -1, np.int32)
    problem = ""
    rows = np.flatnonzero(solid)
    layers = _copies(faces[rows])
    for layer in range(int(layers.max(initial=-1)) + 1):
        part = rows[layers == layer]
        if len(part) > MAX_FACES:
            problem = f"{len(part):,} faces are too many for xatlas"
            continue
        try:
            done, found, charts = _xatlas(scaled, faces[part], seconds, max_cost, cancelled)
        except _Failed as error:
            problem = str(error)
            continue
        uv[part[done]] = found
        label[part[done]] = charts + int(label.max(initial=-1)) + 1
    missing = rows[label[rows] < 0]
    if len(missing):
        problem = problem or f"xatlas left out {len(missing):,} faces"
        flat, charts = lay_out(scaled, faces[missing])
        uv[missing] = flat
        label[missing] = charts + int(label.max(initial=-1)) + 1
    label[rows] = without_folds(uv[rows], label[rows])
    uv[rows] = as_large_as(unmirrored(uv[rows], label[rows]), label[rows], positions[faces[rows]])
    flat_rows = np.flatnonzero(~solid)
    label[flat_rows] = 0
    return Unfolded(uv, label, problem, len(flat_rows))


def pack(
    uv: F64,
    label: I32,
    size: tuple[int, int],
    padding: float,
    largest: float = float("inf"),
    straighten: bool = True,
) -> F64:
    """The charts (F, 3, 2) side by side in `size` texels, in texels, with `padding` texels between two charts.

    They are scaled alike, by `largest` at most. With `straighten` each chart is first turned so that its box is small;
    without it charts turn by quarters alone. Raises InvalidMesh where they do not fit at any scale.
    """
    count = int(label.max(initial=-1)) + 1
    if not count:
        return uv.copy()
    turned = _straight(uv, label) if straighten else uv.copy()
    low, _ = chart_boxes(turned, label)
    turned -= low[label][:, None]
    _, high = chart_boxes(turned, label)
    while True:
        found = layout.uv_pack(turned, label, size, padding, largest)
        if found.scale or padding <= 1:
            break
        padding = padding / 2  # very many charts in a small texture: closer together is better than nothing
    if not found.scale:
        raise InvalidMesh(
            f"{count:,} UV charts do not fit into {size[0]} × {size[1]} texels", advice="ask for a larger texture"
        )
    u, v = turned[..., 0], turned[..., 1]
    wide, tall = high[label].T[:, :, None]
    turn = found.turn[label][:, None]
    x = np.select([turn == 1, turn == 2, turn == 3], [v, wide - u, tall - v], u)
    y = np.select([turn == 1, turn == 2, turn == 3], [wide - u, tall - v, u], v)
    placed: F64 = np.stack([x, y], axis=2) * found.scale + found.corner[label][:, None]
    return placed


def lay_out(positions: F64, faces: I32) -> tuple[F64, I32]:
    """Charts by the directions that faces look in: each is seen along its axis. Folds are cut; there may be many."""
    normals = face_normals(positions, faces)
    axis = np.abs(normals).argmax(axis=1)
    side = np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] > 0
    corners = positions[faces]
    across = (axis[:, None] + np.array([1, 2])) % 3
    uv = np.take_along_axis(corners, across[:, None, :].repeat(3, axis=1), axis=2)
    uv[~side, :, 0] *= -1  # the texture is not mirrored
    key = faces.astype(np.int64) + (axis * 2 + side)[:, None] * len(positions)
    _, number = np.unique(key, return_inverse=True)
    label = layout.chart_labels(number.reshape(-1, 3).astype(np.int32))
    # v points down
    uv[..., 1] *= -1
    return uv, without_folds(uv, label)


def without_folds(uv: F64, label: I32) -> I32:
    """Labels under which no chart overlaps itself: faces that do become charts of their own."""
    found = layout.uv_overlaps(uv, label, label)
    if not found.faces.any():
        return _renumbered(label)
    label = label.astype(np.int64)
    alone = np.flatnonzero(found.faces)
    label[alone] = int(label.max()) + 1 + np.arange(len(alone))
    return _renumbered(label)


def unmirrored(uv: F64, label: I32) -> F64:
    """The charts so that none shows its texture mirrored (v points down)."""
    turned = np.bincount(label, _doubled(uv), int(label.max(initial=-1)) + 1) > 0
    result = uv.copy()
    result[turned[label], :, 0] *= -1
    return result


def as_large_as(uv: F64, label: I32, corners: F64) -> F64:
    """The charts scaled so that each has the area of its surface `corners` (F, 3, 3)."""
    count = int(label.max(initial=-1)) + 1
    surface = np.bincount(label, _areas(corners), count)
    flat = np.bincount(label, np.abs(_doubled(uv)) / 2, count)
    scale = np.sqrt(surface / np.where(flat > 0, flat, 1.0))
    return uv * scale[label][:, None, None]


def chart_boxes(uv: F64, label: I32) -> tuple[F64, F64]:
    """(C, 2) float64 each: lowest and highest corner of each chart."""
    count = int(label.max(initial=-1)) + 1
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    order = np.argsort(label, kind="stable")
    starts = np.searchsorted(label[order], np.arange(count))
    for axis in range(2):
        low[:, axis] = np.minimum.reduceat(uv[order, :, axis].min(axis=1), starts)
        high[:, axis] = np.maximum.reduceat(uv[order, :, axis].max(axis=1), starts)
    return low, high


class _Failed(Exception):
    """xatlas did not do its work."""


def _xatlas(
    positions: F64, faces: I32, seconds: float, max_cost: float, cancelled: Callable[[], bool]
) -> tuple[I32, F64, I32]:
    """Rows of `faces` that were unfolded, their UVs and charts."""
    used, corners = np.unique(faces, return_inverse=True)
    command = [sys.executable, "-m", "lodpipe.geometry.xatlas_child"]
    # a file, not a pipe: `communicate` loses input that it could not send before its timeout (CPython 3.11)
    with tempfile.TemporaryFile() as data:
        np.savez(
            data,
            positions=positions[used].astype(np.float32),
            faces=corners.reshape(-1, 3).astype(np.uint32),
            max_cost=max_cost,
        )
        data.seek(0)
        with subprocess.Popen(command, stdin=data, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
            until = time.monotonic() + seconds
            while True:
                try:
                    out, said = child.communicate(timeout=POLL)
                    break
                except subprocess.TimeoutExpired:
                    if cancelled():
                        child.kill()
                        raise Cancelled("cancelled") from None
                    if time.monotonic() > until:
                        child.kill()
                        raise _Failed(f"xatlas was stopped after {seconds:g} s ({len(faces):,} faces)") from None
    if child.returncode != 0:
        last = said.decode(errors="replace").strip().splitlines()[-1:]
        raise _Failed(f"xatlas failed ({last[0] if last else f'exit code {child.returncode}'})")
    found = np.load(io.BytesIO(out))
    uv: F64 = found["uv"].astype(np.float64)
    good: Bool = ~flat_faces(uv) & np.logical_and.reduce(np.isfinite(uv), axis=(1, 2))
    return found["faces"][good], uv[good], found["label"][good]


def _cleaned(positions: F64, faces: I32) -> tuple[Bool, F64]:
    """Which faces have an area, and positions so large that xatlas, which drops areas up to 1.2e-7, drops none."""
    corners = positions[faces]
    low = corners.min(axis=(0, 1)) if len(faces) else np.zeros(3)
    extent = float((corners - low).max(initial=0.0)) or 1.0
    scaled = (positions - low) / extent
    areas = _areas(scaled[faces])
    sides = np.linalg.norm(np.roll(scaled[faces], -1, axis=1) - scaled[faces], axis=2).max(axis=1, initial=0.0)
    solid: Bool = areas > 1e-9 * sides**2
    smallest = float(np.percentile(areas[solid], 0.1)) if solid.any() else 1.0
    return solid, scaled * min(max(1.0, np.sqrt(1e-3 / smallest)), 1e5)


def _copies(faces: I32) -> I32:
    """(F,) 0 for the first face with its three corners, 1 for the second, …"""
    corners = np.sort(faces, axis=1)
    order = np.lexsort((np.arange(len(faces)), *corners.T[::-1]))
    same = np.zeros(len(faces), bool)
    same[1:] = (corners[order][1:] == corners[order][:-1]).all(axis=1)
    start = np.maximum.accumulate(np.where(~same, np.arange(len(faces)), 0)) if len(faces) else order
    number = np.empty(len(faces), np.int32)
    number[order] = np.arange(len(faces)) - start
    return number


def _straight(uv: F64, label: I32) -> F64:
    """Each chart turned, by one of 16 angles, to where its bounding box is smallest."""
    best, turned = np.full(int(label.max()) + 1, np.inf), uv.copy()
    for angle in np.arange(16) * (np.pi / 32):
        c, s = np.cos(angle), np.sin(angle)
        trial = uv @ np.array([[c, s], [-s, c]])
        low, high = chart_boxes(trial, label)
        area = (high - low).prod(axis=1)
        better = area < best * (1 - 1e-6)
        best = np.where(better, area, best)
        turned[better[label]] = trial[better[label]]
    return turned


def _renumbered(label: I32) -> I32:
    """Labels 0, 1, … without gaps."""
    _, rows = np.unique(label, return_inverse=True)
    return rows.astype(np.int32)


def _doubled(uv: F64) -> F64:
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    doubled: F64 = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return doubled


def _areas(corners: F64) -> F64:
    """(F,) areas of triangles (F, 3, 3)."""
    areas: F64 = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    return areas
