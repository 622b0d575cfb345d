"""From the arrays of a file to a Mesh: the one road that every reader takes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.mesh import F32, Mesh, Primitive
from lodpipe.io.clean import (
    Warn,
    directions,
    drop_doubles,
    drop_non_finite,
    drop_out_of_range,
    finite_attribute,
)
from lodpipe.io.weld import unique_rows

#: Attributes that move a vertex: two positions are one only if these agree too (lips that touch must still open).
_MOVES = re.compile(r"^(JOINTS_\d+|WEIGHTS_\d+|MORPH_\d+_POSITION)$")


@dataclass
class Part:
    """One primitive as a file holds it: an array row is a vertex in the GPU's sense.

    positions   (N, 3) float32 or float64
    faces       (F, 3) rows of it, of any integer type; may be out of range
    attributes  name -> (N, K), of any numeric type
    """

    positions: NDArray[Any]
    faces: NDArray[Any]
    attributes: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    material: int | None = None
    gltf: Mapping[str, Any] = field(default_factory=dict)


def build_mesh(parts: Sequence[Part], place: str, warn: Warn, *, name: str = "", keep_reason: str = "") -> Mesh:
    """A Mesh of `parts`, repaired (lodpipe.io.clean), welded and without rows that no face uses.

    Positions that are equal bit by bit are one position across all parts; each remaining row is a wedge. Rows keep
    the order of the file. Exact doubles of faces go, except where `keep_reason` asks for the mesh as it is.
    """
    used = [part for part in (_compact(part, place, warn) for part in parts) if len(part.faces)]
    if not used:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32), name=name, keep_reason=keep_reason or "no triangles")
    offsets = np.cumsum([0] + [len(part.positions) for part in used])
    rows = used[0].faces if len(used) == 1 else _stack([p.faces + o for p, o in zip(used, offsets, strict=False)])
    owner = np.repeat(np.arange(len(used), dtype=np.int32), [len(part.faces) for part in used])
    points = _stack([part.positions for part in used])
    attributes = _columns(used, offsets, place, warn)
    keys = [points[:, axis] for axis in range(3)]
    keys += [v[:, k] for n, v in attributes.items() if _MOVES.match(n) for k in range(v.shape[1])]
    first, inverse = unique_rows(keys)
    welded = len(first) < len(points)
    positions = (points[first] if welded else points).astype(np.float64) + 0.0  # no negative zeros
    faces = inverse[rows] if welded else rows
    if not keep_reason:
        keep = drop_doubles(faces, owner, place, warn)
        if len(keep) < len(faces):
            faces, rows, owner = faces[keep], rows[keep], owner[keep]
    if "NORMAL" in attributes:
        normals = attributes["NORMAL"]
        attributes["NORMAL"] = _fill_normals(attributes["NORMAL"], used, positions, faces, rows, owner)
        filled = int((attributes["NORMAL"] != normals).any(axis=1).sum())
        if filled:
            warn(f"{place}: {filled:,} normals of no length; taken from the faces round them")
    apart = bool(attributes) or len(used) > 1
    return Mesh(
        positions=positions,
        faces=faces,
        wedges=rows if apart else faces,
        attributes=attributes,
        face_primitive=owner,
        primitives=tuple(Primitive(p.material, tuple(p.attributes), p.gltf) for p in used),
        name=name,
        keep_reason=keep_reason,
    )


def _compact(part: Part, place: str, warn: Warn) -> Part:
    """The part without faces that cannot be used and rows that none uses; faces int32, attributes float32."""
    faces = drop_out_of_range(part.faces, len(part.positions), place, warn)
    faces = drop_non_finite(faces, part.positions, place, warn)
    in_use = np.zeros(len(part.positions), bool)
    in_use[faces.ravel()] = True
    everything = bool(in_use.all())
    if not everything:
        place_of = np.cumsum(in_use, dtype=np.int32) - np.int32(1)
        faces = place_of[faces]
    chosen = slice(None) if everything else np.flatnonzero(in_use)
    attributes = {}
    with np.errstate(over="ignore", invalid="ignore"):
        for name, values in part.attributes.items():
            column = np.ascontiguousarray(values[chosen], np.float32)
            attributes[name] = finite_attribute(name, column, place, warn)
    return Part(part.positions[chosen], faces.astype(np.int32, copy=False), attributes, part.material, part.gltf)


def _columns(parts: list[Part], offsets: NDArray[Any], place: str, warn: Warn) -> dict[str, F32]:
    """Each attribute over all parts: zeros where a part lacks it, the widest number of components."""
    if len(parts) == 1:
        return dict(parts[0].attributes)
    columns: dict[str, F32] = {}
    for name in dict.fromkeys(n for part in parts for n in part.attributes):
        widths = {part.attributes[name].shape[1] for part in parts if name in part.attributes}
        if len(widths) > 1 and not name.startswith("COLOR_"):
            warn(f"{place}: {name} has {min(widths)} and {max(widths)} components; the shorter is filled up with 0")
        column = np.zeros((int(offsets[-1]), max(widths)), np.float32)
        for part, offset in zip(parts, offsets, strict=False):
            if name in part.attributes:
                values = part.attributes[name]
                block = column[offset : offset + len(values)]
                block[:, : values.shape[1]] = values
                if name.startswith("COLOR_"):
                    block[:, values.shape[1] :] = 1.0  # a colour without alpha is opaque
        columns[name] = column
    return columns


def _fill_normals(normals: F32, parts: list[Part], positions: Any, faces: Any, rows: Any, owner: Any) -> F32:
    """`normals` with a direction for the wedges that have none, in the primitives that carry normals."""
    zero = ~normals.any(axis=1)
    if not zero.any():
        return normals
    has = np.array(["NORMAL" in part.attributes for part in parts])
    wedge_has = np.zeros(len(normals), bool)
    wedge_has[rows[has[owner]].ravel()] = True
    fill = zero & wedge_has
    if fill.any():
        normals = normals.copy()
        normals[fill] = directions(normals, positions, faces, rows)[fill]
    return normals


def _stack(arrays: list[NDArray[Any]]) -> NDArray[Any]:
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)
