"""Any level between two levels, from the record of collapses (a progressive mesh; Hoppe 1996)."""

from __future__ import annotations

import numpy as np

from lodpipe.core.mesh import F32, F64, I32
from lodpipe.kernel import Level, Record


def rebuild(positions: F64, faces: I32, wedges: I32, values: F32, record: Record, triangles: int) -> Level:
    """The mesh after the first collapses of the record that leave at most `triangles` triangles.

    positions (V, 3), faces and wedges (F, 3), values (W, K): what the record was made from. If the record ends before
    that, its last state. Each state costs time linear in the source, whichever it is.
    """
    live = _counted(faces) - np.concatenate([[0], np.cumsum(record.triangles, dtype=np.int64)])
    reached = np.flatnonzero(live <= triangles)
    count = int(reached[0]) if len(reached) else len(record.removed)
    target = _ends(len(positions), record.removed[:count], record.kept[:count])
    events = int(np.searchsorted(record.wedge_event, count))
    gone = record.wedge_from[:events] != record.wedge_to[:events]
    wedge_target = _ends(len(values), record.wedge_from[:events][gone], record.wedge_to[:events][gone])
    placed, moved = positions.copy(), np.zeros(len(positions), bool)
    kept, last = _last(record.kept[:count])
    placed[kept] = record.positions[:count][last]
    moved[kept] = (placed[kept] != positions[kept]).any(axis=1)
    set_values, changed = values.copy(), np.zeros(len(values), bool)
    written, row = _last(record.wedge_to[:events])
    set_values[written] = record.wedge_values[:events][row]
    changed[written] = (set_values[written] != values[written]).any(axis=1)

    corners = target[faces]
    keep = (corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2]) & (corners[:, 0] != corners[:, 2])
    corners = corners[keep]
    used, new_faces = np.unique(corners, return_inverse=True)
    ends = wedge_target[wedges[keep]] if values.shape[1] else wedges[keep]
    rows, new_wedges = np.unique(ends, return_inverse=True)
    return Level(
        target=triangles,
        stop="triangles" if len(corners) <= triangles else "topology",
        error=float(record.error[:count].max(initial=0.0)),
        relaxed=False,
        positions=placed[used],
        faces=new_faces.reshape(-1, 3).astype(np.int32),
        wedges=new_wedges.reshape(-1, 3).astype(np.int32),
        values=set_values[rows] if values.shape[1] else np.empty((len(rows), 0), np.float32),
        vertex_source=np.where(moved[used], -1, used).astype(np.int32),
        face_source=np.flatnonzero(keep).astype(np.int32),
        wedge_source=np.where(changed[rows], -1, rows).astype(np.int32) if values.shape[1] else rows.astype(np.int32),
        vertex_to=_among(used, target),
        wedge_to=_among(rows, wedge_target if values.shape[1] else np.arange(len(values), dtype=np.int32)),
    )


def _counted(faces: I32) -> int:
    """Triangles with three different corners: the others were left out from the start."""
    a, b, c = faces.T
    return int(((a != b) & (b != c) & (a != c)).sum())


def _ends(count: int, removed: I32, kept: I32) -> I32:
    """For each row, the row that stands for it after all merges: chains are followed by doubling."""
    target = np.arange(count, dtype=np.int32)
    target[removed] = kept
    while True:
        further = target[target]
        if np.array_equal(further, target):
            return target
        target = further


def _among(used: I32, target: I32) -> I32:
    """Where each of `target` stands in `used`, −1 for those that are not there."""
    row = np.full(int(max(target.max(initial=0), used.max(initial=0))) + 1, -1, np.int32)
    row[used] = np.arange(len(used), dtype=np.int32)
    return row[target]


def _last(rows: I32) -> tuple[I32, I32]:
    """The distinct rows, and for each where it stands last."""
    distinct, at = np.unique(rows[::-1], return_index=True)
    return distinct, (len(rows) - 1 - at).astype(np.int32)
