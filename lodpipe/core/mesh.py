"""The triangle mesh that every stage works on: arrays, checked once, and no algorithms."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.errors import InvalidMesh

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
I32 = NDArray[np.int32]


@dataclass(frozen=True)
class Primitive:
    """A run of a mesh's faces that is drawn with one material: glTF's word and meaning.

    `material` indexes `Asset.materials` (None: the default material). `attributes` names the attributes that
    this primitive's faces have; in the others' columns their wedges hold zeros, which are never written.
    `gltf` is what else the file said of the primitive (extras, extensions), kept as it was.
    """

    material: int | None = None
    attributes: tuple[str, ...] = ()
    gltf: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Mesh:
    """An indexed triangle mesh whose positions may have several wedges.

    Positions and attributes are indexed apart. A *wedge* is one set of attribute values at one position, what a
    GPU calls a vertex; where a position has more than one wedge there is a seam or a border between materials.

    positions       (V, 3) float64, any unit
    faces           (F, 3) int32, rows of `positions`; counter-clockwise from outside
    wedges          (F, 3) int32, rows of each array in `attributes`, which all have W rows
    attributes      name -> (W, K) float32; glTF's names (NORMAL, TEXCOORD_0 with v = 0 at the top, COLOR_0, _CUSTOM)
    face_primitive  (F,) int32, rows of `primitives`

    Each wedge belongs to one position and one primitive. Arrays are read-only. Left out, `wedges` equals `faces`,
    `face_primitive` is 0 and `primitives` is a single one that has every attribute.

    Raises InvalidMesh for a wrong shape, an index out of range, or a position that is not finite.
    """

    positions: F64
    faces: I32
    wedges: I32 = None  # type: ignore[assignment]  # never None once constructed
    attributes: Mapping[str, F32] = field(default_factory=dict)
    face_primitive: I32 = None  # type: ignore[assignment]  # never None once constructed
    primitives: tuple[Primitive, ...] = ()
    name: str = ""
    #: Why stages must pass this mesh on as it is; empty: it may be simplified.
    keep_reason: str = ""

    def __post_init__(self) -> None:
        positions = _array(self.positions, np.float64, (None, 3), "positions")
        faces = _array(self.faces, np.int32, (None, 3), "faces")
        count = len(faces)
        wedges = faces if self.wedges is None else _array(self.wedges, np.int32, (count, 3), "wedges")
        owner = np.zeros(count, np.int32) if self.face_primitive is None else self.face_primitive
        owner = _array(owner, np.int32, (count,), "face_primitive")
        attributes = {name: _array(values, np.float32, (None, None), name) for name, values in self.attributes.items()}
        rows = {len(values) for values in attributes.values()}
        if len(rows) > 1:
            raise InvalidMesh(f"attributes have different lengths: {sorted(rows)}")
        if not np.isfinite(positions).all():
            bad = int((~np.isfinite(positions)).any(axis=1).sum())
            raise InvalidMesh(f"{bad} of {len(positions)} positions are not finite")
        _in_range(faces, len(positions), "faces")
        if rows:
            _in_range(wedges, rows.pop(), "wedges")
        primitives = tuple(self.primitives) or (Primitive(attributes=tuple(attributes)),)
        _in_range(owner, len(primitives), "face_primitive")
        for key, value in {
            "positions": positions,
            "faces": faces,
            "wedges": wedges,
            "face_primitive": owner,
            "attributes": attributes,
            "primitives": primitives,
        }.items():
            object.__setattr__(self, key, value)

    @cached_property
    def wedge_count(self) -> int:
        """Number of wedges that the faces use (glTF's vertex count)."""
        if not len(self.wedges):
            return 0
        used = np.zeros(int(self.wedges.max()) + 1, bool)
        used[self.wedges] = True
        return int(np.count_nonzero(used))

    @cached_property
    def face_material(self) -> I32:
        """(F,) int32: row of `Asset.materials` for each face, −1 for the default material."""
        table = np.array([-1 if p.material is None else p.material for p in self.primitives], np.int32)
        return table[self.face_primitive]

    def fingerprint(self) -> str:
        """Hex digest of every array, name and primitive: equal for equal content, for caches and tests."""
        digest = hashlib.sha256()
        arrays: dict[str, NDArray[Any]] = {
            "positions": self.positions,
            "faces": self.faces,
            "wedges": self.wedges,
            "face_primitive": self.face_primitive,
        }
        arrays.update(self.attributes)
        for name in sorted(arrays):
            digest.update(f"{name}{arrays[name].shape}".encode())
            digest.update(np.ascontiguousarray(arrays[name]).tobytes())
        digest.update(repr((self.name, self.keep_reason, self.primitives)).encode())
        return digest.hexdigest()


def _array(values: Any, dtype: type, shape: tuple[int | None, ...], name: str) -> NDArray[Any]:
    """`values` as a read-only, C-contiguous array of the dtype; a view where it is one already."""
    given = np.asarray(values)
    if given.ndim != len(shape) or any(want not in (None, got) for want, got in zip(shape, given.shape, strict=True)):
        want = "×".join("n" if n is None else str(n) for n in shape)
        raise InvalidMesh(f"{name} must have the shape {want} (got {'×'.join(map(str, given.shape))})")
    if given.dtype.kind not in "iuf" or (np.issubdtype(dtype, np.integer) and given.dtype.kind == "f"):
        raise InvalidMesh(f"{name} must hold {np.dtype(dtype).name} values (got {given.dtype})")
    array: NDArray[Any] = np.ascontiguousarray(given, dtype)
    if array.flags.writeable:
        array = array.view()
        array.flags.writeable = False
    return array


def _in_range(indices: I32, count: int, name: str) -> None:
    if indices.size and (int(indices.min()) < 0 or int(indices.max()) >= count):
        raise InvalidMesh(f"{name} hold index {_first_bad(indices, count)}, but there are {count} rows")


def _first_bad(indices: I32, count: int) -> int:
    flat = indices.ravel()
    return int(flat[(flat < 0) | (flat >= count)][0])
