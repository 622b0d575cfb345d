"""Buffers, buffer views and accessors of a glTF, checked before anything is read or allocated."""

from __future__ import annotations

import base64
import binascii
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.errors import AssetError, LimitError
from lodpipe.io import meshopt
from lodpipe.io.gltf_schema import Json
from lodpipe.io.paths import Folder

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
Bytes = NDArray[np.uint8]


class Buffers:
    """The binary data of one glTF, read when it is asked for."""

    def __init__(self, tree: Json, folder: Folder, chunk: memoryview | None) -> None:
        self._tree = tree
        self._folder = folder
        self._chunk = chunk
        self._buffers: dict[int, Bytes] = {}
        self._views: dict[int, Bytes] = {}

    def accessor(self, row: int) -> NDArray[Any]:
        """The elements (count, components) of an accessor as stored; read-only, a view of the buffer where possible."""
        said = self._tree["accessors"][row]
        place = f"accessors[{row}]"
        kind, width = component(said, place)
        count = said["count"]
        need = count * width * kind.itemsize
        if "bufferView" in said:
            values = self._elements(said["bufferView"], said.get("byteOffset", 0), kind, said["type"], count, place)
        elif need > self._folder.limits.input_bytes:
            raise LimitError(f"{count:,} elements need {need:,} bytes", place=place)
        else:
            values = np.zeros((count, width), kind)
        sparse = said.get("sparse")
        return values if sparse is None else self._sparse(values, sparse, kind, said["type"], place)

    def floats(self, row: int) -> NDArray[np.float32]:
        """The same as float32, normalized integers as −1…1 or 0…1 (glTF 2.0, section 3.11)."""
        return as_floats(self.accessor(row), bool(self._tree["accessors"][row].get("normalized")))

    def view(self, row: int) -> Bytes:
        """The bytes of a buffer view, decompressed where it is compressed."""
        if row in self._views:
            return self._views[row]
        said = self._tree["bufferViews"][row]
        place = f"bufferViews[{row}]"
        name = next((n for n in meshopt.EXTENSIONS if n in said.get("extensions", {})), None)
        if name is None:
            data = self._range(said["buffer"], said.get("byteOffset", 0), said["byteLength"], place)
        else:
            data = self._decompress(said["extensions"][name], said["byteLength"], f"{place}.extensions.{name}")
        self._views[row] = data
        return data

    def _decompress(self, said: Json, length: int, place: str) -> Bytes:
        try:
            buffer, size, stride, count = (int(said[k]) for k in ("buffer", "byteLength", "byteStride", "count"))
            offset, mode, method = int(said.get("byteOffset", 0)), str(said["mode"]), str(said.get("filter", "NONE"))
        except (KeyError, TypeError, ValueError) as error:
            raise AssetError(f"{error} is missing or of the wrong type", place=place) from error
        if min(buffer, size, stride, count, offset) < 0 or buffer >= len(self._tree.get("buffers", ())):
            raise AssetError("it names a buffer or a range that is not there", place=place)
        if stride * count != length or length > self._folder.limits.input_bytes:
            raise AssetError(f"{count:,} elements of {stride} bytes are not the view's {length:,} bytes", place=place)
        source = self._range(buffer, offset, size, place)
        try:
            return meshopt.decode(bytes(source), mode, method, count, stride)
        except AssetError as error:
            raise error.at(place) from error

    def _elements(
        self, view: int, offset: int, kind: np.dtype[Any], type_name: str, count: int, place: str
    ) -> NDArray[Any]:
        data = self.view(view)
        column, rows = column_layout(type_name, kind.itemsize)
        size = column * rows if type_name.startswith("MAT") else kind.itemsize * WIDTHS[type_name]
        stride = self._tree["bufferViews"][view].get("byteStride", size)
        if stride < size:
            raise AssetError(
                f"byteStride {stride} is less than an element's {size} bytes", place=f"bufferViews[{view}]"
            )
        if offset + stride * (count - 1) + size > len(data):
            raise AssetError(
                f"{count:,} elements reach beyond the {len(data):,} bytes of bufferViews[{view}]",
                place=place,
                advice="the file is cut off or damaged: copy or export it again",
            )
        if not type_name.startswith("MAT"):
            return np.ndarray((count, WIDTHS[type_name]), kind, data.data, offset, (stride, kind.itemsize))
        cells = np.ndarray((count, rows, rows), kind, data.data, offset, (stride, column, kind.itemsize))
        return np.ascontiguousarray(cells).reshape(count, -1)

    def _sparse(self, base: NDArray[Any], said: Json, kind: np.dtype[Any], type_name: str, place: str) -> NDArray[Any]:
        count = said["count"]
        place = f"{place}.sparse"
        if count > len(base):
            raise AssetError(f"{count:,} values for {len(base):,} elements", place=place)
        at, what = said["indices"], said["values"]
        index_kind, _ = component({**at, "type": "SCALAR"}, place)
        rows = self._elements(at["bufferView"], at.get("byteOffset", 0), index_kind, "SCALAR", count, place)[:, 0]
        values = self._elements(what["bufferView"], what.get("byteOffset", 0), kind, type_name, count, place)
        if index_kind.kind != "u" or (count and int(rows.max()) >= len(base)):
            raise AssetError("an index is out of range", place=place)
        result = np.array(base)
        result[rows] = values
        return result

    def _range(self, buffer: int, offset: int, length: int, place: str) -> Bytes:
        data = self._buffer(buffer)
        if offset + length > len(data):
            raise AssetError(
                f"bytes {offset:,} to {offset + length:,} reach beyond buffers[{buffer}] with {len(data):,}",
                place=place,
                advice="the file is cut off or damaged: copy or export it again",
            )
        return data[offset : offset + length]

    def _buffer(self, row: int) -> Bytes:
        if row not in self._buffers:
            said = self._tree["buffers"][row]
            place = f"buffers[{row}]"
            try:
                data = self._buffer_bytes(row, said)
            except AssetError as error:
                raise error.at(place) from error
            if len(data) < said["byteLength"]:
                raise AssetError(
                    f"it has {len(data):,} bytes instead of {said['byteLength']:,}",
                    place=place,
                    advice="the file is cut off: copy or export it again",
                )
            array = np.frombuffer(data, np.uint8)[: said["byteLength"]]
            self._buffers[row] = array
        return self._buffers[row]

    def _buffer_bytes(self, row: int, said: Json) -> bytes | memoryview:
        uri = said.get("uri")
        if uri is None:
            if row or self._chunk is None:
                raise AssetError("it has neither a URI nor a binary chunk")
            return self._chunk
        return data_uri(uri) if uri.startswith("data:") else self._folder.read_uri(uri)


def component(said: Json, place: str) -> tuple[np.dtype[Any], int]:
    """NumPy type and number of components of an accessor's elements."""
    if said["componentType"] not in COMPONENTS:
        raise AssetError(f"componentType {said['componentType']} is none of glTF 2.0", place=place)
    if said["type"] not in WIDTHS:
        raise AssetError(f"type '{said['type'][:20]}' is none of glTF 2.0", place=place)
    return np.dtype(COMPONENTS[said["componentType"]]), WIDTHS[said["type"]]


def column_layout(type_name: str, size: int) -> tuple[int, int]:
    """Bytes from one matrix column to the next, which starts at a multiple of four, and the number of columns."""
    rows = {"MAT2": 2, "MAT3": 3, "MAT4": 4}.get(type_name, 1)
    return -(-rows * size // 4) * 4, rows


def as_floats(values: NDArray[Any], normalized: bool) -> NDArray[np.float32]:
    """Stored components as float32."""
    if not normalized or values.dtype.kind == "f":
        return values.astype(np.float32, copy=False)
    top = float(np.iinfo(values.dtype).max)
    return np.maximum(values / top, -1.0).astype(np.float32)


def data_uri(uri: str) -> bytes:
    """The bytes of a data: URI. Raises AssetError."""
    head, comma, body = uri.partition(",")
    if not comma:
        raise AssetError("the data URI has no data")
    if not head.endswith(";base64"):
        return unquote_to_bytes(body)
    try:
        return base64.b64decode(unquote_to_bytes(body) if "%" in body else body, validate=True)
    except (binascii.Error, ValueError) as error:
        raise AssetError("the data URI is not valid base64") from error
