"""STL, binary and text: a soup of triangles."""

from __future__ import annotations

import struct
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.asset import Asset
from lodpipe.core.errors import AssetError
from lodpipe.core.mesh import F64
from lodpipe.io.build import Part, build_mesh
from lodpipe.io.clean import Warn, face_cross
from lodpipe.io.limits import Limits
from lodpipe.io.paths import Folder
from lodpipe.io.plain import single_mesh
from lodpipe.io.text import Lines, plain_text

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("flags", "<u2")])
_HEADER = 84


def read_stl(folder: Folder, warn: Warn) -> Asset:
    """Corners that agree bit by bit are one position. Facet normals are not used: the winding tells them."""
    data = folder.read_asset()
    if not data:
        raise AssetError("the file is empty")
    corners = _text(data, folder.limits, warn) if _is_text(data) else _binary(data, folder.limits, warn)
    faces = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    return single_mesh(folder.path, build_mesh([Part(corners, faces)], "facets", warn))


def _is_text(data: bytes) -> bool:
    """A binary file may start with `solid` too: its size gives it away."""
    if data[:200].lstrip()[:5].lower() != b"solid":
        return False
    if len(data) >= _HEADER and len(data) == _HEADER + 50 * struct.unpack_from("<I", data, 80)[0]:
        return False
    return b"\0" not in data[:1000]


def _binary(data: bytes, limits: Limits, warn: Warn) -> NDArray[np.float32]:
    if len(data) < _HEADER:
        raise AssetError("it is cut off in its header")
    count = struct.unpack_from("<I", data, 80)[0]
    held = (len(data) - _HEADER) // _FACET.itemsize
    if count > held:
        raise AssetError(
            f"its header says {count:,} facets, but there is data for {held:,}",
            advice="the file is cut off or damaged: copy or export it again",
        )
    limits.check_triangles(count)
    if len(data) > _HEADER + count * _FACET.itemsize:
        warn(f"{len(data) - _HEADER - count * _FACET.itemsize:,} bytes after the last facet left out")
    facets = np.frombuffer(data, _FACET, count, _HEADER)
    return np.ascontiguousarray(facets["corners"]).reshape(-1, 3)


def _text(data: bytes, limits: Limits, warn: Warn) -> F64:
    text = plain_text(data).lower()
    limits.check_triangles(text.count(b"endfacet"))
    lines = Lines(text)
    chosen = lines.starting(b"vertex")
    table, count = lines.table(chosen, b"vertex", 3)
    if len(chosen) % 3 or (count != 3).any():
        raise AssetError(
            "its vertex lines are not threes of three numbers",
            advice="the file is cut off or damaged: copy or export it again",
        )
    if b"endsolid" not in text[-1000:]:
        warn("the last line, endsolid, is missing: the file may be cut off")
    return table


def write_stl(positions: F64, faces: NDArray[np.int32]) -> Iterable[bytes]:
    """A binary STL in float32, with facet normals."""
    facets = np.zeros(len(faces), _FACET)
    cross = face_cross(positions, faces)
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    facets["normal"] = np.divide(cross, length, out=np.zeros_like(cross), where=length > 0)
    facets["corners"] = positions[faces]
    yield b"lodpipe".ljust(80, b"\0")
    yield struct.pack("<I", len(faces))
    yield facets.tobytes()
