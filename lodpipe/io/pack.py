"""The binary side of a glTF that is being written: accessors, buffer views and one buffer, each array once."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.io.accessors import COMPONENTS, column_layout

VERTICES, INDICES = 34962, 34963
_CODES = {np.dtype(name): code for code, name in COMPONENTS.items()}


class Packer:
    """Collects arrays; `accessors` and `views` are the JSON for them, `data` the buffer."""

    def __init__(self) -> None:
        self.accessors: list[dict[str, Any]] = []
        self.views: list[dict[str, Any]] = []
        self._pieces: list[bytes] = []
        self._size = 0
        self._known: dict[tuple[Any, ...], int] = {}

    @property
    def data(self) -> bytes:
        """The buffer, a multiple of four bytes long."""
        return b"".join(self._pieces)

    def accessor(
        self,
        values: NDArray[Any],
        type_name: str,
        *,
        normalized: bool = False,
        target: int | None = None,
        bounds: bool = False,
        rest: Mapping[str, Any] | None = None,
    ) -> int:
        """The row of an accessor with the elements `values` (N, K), little-endian; the same array has the same row.

        `target` tells what a GPU uses it for, `bounds` asks for min and max, `rest` is further JSON.
        """
        kind = values.dtype.newbyteorder("<")
        said: dict[str, Any] = {"componentType": _CODES[kind], "count": len(values), "type": type_name}
        if normalized:
            said["normalized"] = True
        if bounds:
            said["min"], said["max"] = values.min(axis=0).tolist(), values.max(axis=0).tolist()
        said.update(rest or {})
        raw, stride = _rows(values.astype(kind, copy=False), type_name, target == VERTICES)
        key = (hashlib.blake2b(raw, digest_size=16).digest(), target, repr(said))
        if key not in self._known:
            view = self.view(raw, target=target, stride=stride)
            self._known[key] = len(self.accessors)
            self.accessors.append({"bufferView": view, **said})
        return self._known[key]

    def view(self, raw: bytes, *, target: int | None = None, stride: int | None = None) -> int:
        """The row of a new buffer view with the bytes `raw`, at a multiple of four."""
        said: dict[str, Any] = {"buffer": 0, "byteOffset": self._size, "byteLength": len(raw)}
        if stride is not None:
            said["byteStride"] = stride
        if target is not None:
            said["target"] = target
        padding = -len(raw) % 4
        self._pieces += [raw, bytes(padding)]
        self._size += len(raw) + padding
        self.views.append(said)
        return len(self.views) - 1


def _rows(values: NDArray[Any], type_name: str, is_vertex: bool) -> tuple[bytes, int | None]:
    """The bytes, with elements of a vertex attribute and columns of a matrix at multiples of four; the stride."""
    size = values.dtype.itemsize
    if type_name.startswith("MAT"):
        column, rows = column_layout(type_name, size)
        if column == rows * size:
            return values.tobytes(), None
        padded = np.zeros((len(values), rows, column // size), values.dtype)
        padded[:, :, :rows] = values.reshape(-1, rows, rows)
        return padded.tobytes(), None
    width = values.shape[1] * size
    if not is_vertex or width % 4 == 0:
        return values.tobytes(), None
    stride = width + -width % 4
    filled = np.zeros((len(values), stride), np.uint8)
    filled[:, :width] = np.ascontiguousarray(values).view(np.uint8).reshape(len(values), width)
    return filled.tobytes(), stride
