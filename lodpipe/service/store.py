"""Lodpipe's plain data (assets, pages: dataclasses of `lodpipe.core` with arrays in them) as a file, and back.

The file has the data's shape as JSON, then the arrays and bytes that it names, and a checksum: nothing in it is
executed when it is read, and what is damaged or of another version is not taken.
"""

from __future__ import annotations

import dataclasses
import importlib
import json
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

_MAGIC = b"lodpipe1"
_HEAD = struct.Struct("<8sQQ")
"""Magic, bytes of JSON, bytes of what follows."""
_PLAIN = (type(None), bool, int, float, str)


class CannotStore(Exception):
    """There is something in the data that has no place in the file."""


def write(file: BinaryIO, value: Any) -> int:
    """Write `value`; the number of bytes. Raises CannotStore."""
    blobs: list[Any] = []
    text = json.dumps(_encode(value, blobs)).encode("ascii")
    parts = [text, *(memoryview(blob).cast("B") if len(memoryview(blob)) else b"" for blob in blobs)]
    body = sum(len(part) for part in parts) - len(text)
    check = 0
    file.write(_HEAD.pack(_MAGIC, len(text), body))
    for part in parts:
        file.write(part)
        check = zlib.crc32(part, check)
    file.write(check.to_bytes(4, "little"))
    return _HEAD.size + len(text) + body + 4


def read(data: bytes) -> Any:
    """The value in a file's content. Raises ValueError if it is not whole, or not of this version."""
    if len(data) < _HEAD.size:
        raise ValueError("cut off")
    magic, length, body = _HEAD.unpack_from(data)
    end = _HEAD.size + length + body
    if magic != _MAGIC or len(data) != end + 4:
        raise ValueError("not of this version, or cut off")
    content = memoryview(data)[_HEAD.size : end]
    if zlib.crc32(content) != int.from_bytes(data[end:], "little"):
        raise ValueError("damaged")
    try:
        return _Decoder(content[length:]).decode(json.loads(bytes(content[:length])))
    except (KeyError, TypeError, AttributeError, ImportError) as error:
        raise ValueError(f"not of this version ({error})") from error


def _encode(value: Any, blobs: list[Any]) -> Any:
    if isinstance(value, np.generic):
        value = np.asarray(value)
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise CannotStore("an array of objects")
        blobs.append(np.ascontiguousarray(value).reshape(-1).view(np.uint8) if value.size else b"")
        return {"array": [value.dtype.str, list(value.shape), value.nbytes]}
    if isinstance(value, bytes | bytearray | memoryview):
        blobs.append(bytes(value))
        return {"bytes": len(value)}
    if type(value) in _PLAIN:
        return value
    if isinstance(value, Path):
        return {"path": str(value)}
    if isinstance(value, tuple | list):
        return {"tuple" if isinstance(value, tuple) else "list": [_encode(item, blobs) for item in value]}
    if isinstance(value, Mapping):
        return {"map": [[_encode(key, blobs), _encode(item, blobs)] for key, item in value.items()]}
    kind = type(value)
    if dataclasses.is_dataclass(kind) and kind.__module__.startswith("lodpipe.core."):
        fields = {
            field.name: _encode(getattr(value, field.name), blobs) for field in dataclasses.fields(kind) if field.init
        }
        return {"data": [kind.__module__, kind.__qualname__, fields]}
    raise CannotStore(f"{kind.__module__}.{kind.__qualname__}")


class _Decoder:
    """Takes the arrays in the order in which they were written."""

    def __init__(self, body: memoryview) -> None:
        self._body, self._at = body, 0

    def decode(self, said: Any) -> Any:
        if not isinstance(said, dict):
            return said
        ((kind, content),) = said.items()
        if kind == "array":
            dtype, shape, size = content
            return np.frombuffer(self._take(size), np.dtype(dtype)).reshape(shape)
        if kind == "bytes":
            return bytes(self._take(content))
        if kind == "path":
            return Path(content)
        if kind == "tuple":
            return tuple(self.decode(item) for item in content)
        if kind == "list":
            return [self.decode(item) for item in content]
        if kind == "map":
            return {self.decode(key): self.decode(item) for key, item in content}
        module, name, values = content
        if not module.startswith("lodpipe.core."):
            raise ValueError(f"{module} is not a module of plain data")
        found: Any = getattr(importlib.import_module(module), name)
        if not (isinstance(found, type) and dataclasses.is_dataclass(found)):
            raise ValueError(f"{name} is not plain data")
        made: Any = found
        return made(**{key: self.decode(item) for key, item in values.items()})

    def _take(self, size: int) -> memoryview:
        self._at += size
        return self._body[self._at - size : self._at]
