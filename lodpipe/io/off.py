"""OFF with its variants: ST, C, N before the keyword say what follows the position of each vertex."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.asset import Asset
from lodpipe.core.errors import AssetError
from lodpipe.core.mesh import F32, F64
from lodpipe.io.build import Part, build_mesh
from lodpipe.io.clean import Warn
from lodpipe.io.paths import Folder
from lodpipe.io.plain import single_mesh
from lodpipe.io.polygons import triangulate, usable
from lodpipe.io.text import Lines, numbers, plain_text

_KEYWORD = re.compile(rb"\s*((?:ST)?C?N?4?n?OFF)\b[ \t]*(BINARY\b)?")


def read_off(folder: Folder, warn: Warn) -> Asset:
    """Polygons are cut into triangles; vertex normals, colours and texture coordinates are kept."""
    data = re.sub(rb"#[^\n]*", b"", plain_text(folder.read_asset()))
    if not data.strip():
        raise AssetError("the file is empty")
    match = _KEYWORD.match(data)
    if match and match[2]:
        raise AssetError("binary OFF is not supported", advice="save it as text OFF, or as PLY")
    kind = match[1] if match else b"OFF"
    if b"4" in kind or b"n" in kind:
        raise AssetError(f"{kind.decode()} files, with other than 3 dimensions, are not supported")
    data = data[match.end() :] if match else data
    lines = Lines(data)
    filled = np.flatnonzero(lines.words)
    head = numbers(lines.text(filled[:1]), 0)
    if not len(head) or not np.isfinite(head).all() or len(head) < 2:
        raise AssetError("its second line does not give the numbers of vertices and faces")
    vertices, polygons = int(head[0]), int(head[1])
    if vertices < 0 or polygons < 0 or vertices + polygons > len(filled) - 1:
        raise AssetError(
            f"its header says {vertices:,} vertices and {polygons:,} faces, but {len(filled) - 1:,} lines follow",
            advice="the file is cut off or damaged: copy or export it again",
        )
    folder.limits.check_triangles(polygons)
    positions, attributes = _vertices(lines, filled[1 : 1 + vertices], kind)
    counts, corners = _faces(lines, filled[1 + vertices : 1 + vertices + polygons], warn)
    good = usable(counts, corners, vertices, "faces", warn)
    corners, counts = corners[np.repeat(good, counts)], counts[good]
    faces, _ = triangulate(counts, positions[corners], "faces", warn)
    return single_mesh(folder.path, build_mesh([Part(positions, corners[faces], attributes)], "faces", warn))


def _vertices(lines: Lines, chosen: NDArray[np.intp], kind: bytes) -> tuple[F64, dict[str, NDArray[Any]]]:
    width = lines.words[chosen]
    if len(width) and (width != width[0]).any():
        raise AssetError("its vertex lines have different lengths")
    columns = int(width[0]) if len(width) else 3
    table = numbers(lines.text(chosen), columns * len(chosen)).reshape(len(chosen), columns)
    normals = 3 if b"N" in kind else 0
    uvs = 2 if b"ST" in kind else 0
    colours = columns - 3 - normals - uvs if b"C" in kind else 0
    if columns < 3 + normals + uvs or (b"C" in kind and colours not in (3, 4)):
        raise AssetError(f"its vertex lines have {columns} numbers, which do not make up {kind.decode()}")
    attributes: dict[str, NDArray[Any]] = {}
    at = 3
    if normals:
        attributes["NORMAL"] = table[:, at : at + 3]
        at += 3
    if colours:
        values = table[:, at : at + colours]
        attributes["COLOR_0"] = values / 255.0 if values.max(initial=0.0) > 1.0 else values
        at += colours
    if uvs:
        attributes["TEXCOORD_0"] = np.stack([table[:, at], 1.0 - table[:, at + 1]], axis=1)
    return table[:, :3], attributes


def _faces(lines: Lines, chosen: NDArray[np.intp], warn: Warn) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Corners of each face, and the corners one after another. Colours after the corners are left out."""
    text = lines.text(chosen)
    width = lines.words[chosen]
    values = numbers(text, int(width.sum()))
    if not np.isfinite(values).all() or (len(values) and np.abs(values).max() > 2**53):
        raise AssetError("its face lines hold words that are no numbers")
    whole = values.astype(np.int64)
    begin = np.cumsum(width) - width
    counts = whole[begin]
    if (counts < 0).any() or (counts > width - 1).any():
        raise AssetError(
            "a face line has fewer corners than it says",
            advice="the file is cut off or damaged: copy or export it again",
        )
    if (width - 1 > counts).any():
        warn("colours of faces left out")
    order = np.repeat(begin + 1, counts) + np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return counts, whole[order]


def write_off(positions: F64, faces: NDArray[np.int32], colours: F32 | None) -> Iterable[bytes]:
    """OFF, or COFF with `colours` (V, 3 or 4) in 0…1 for each position."""
    yield b"OFF\n" if colours is None else b"COFF\n"
    yield b"%d %d 0\n" % (len(positions), len(faces))
    table = positions if colours is None else np.hstack([positions, colours])
    row = " ".join(["%.17g"] * 3 + ["%.6g"] * (table.shape[1] - 3)) + "\n"
    yield (row * len(table) % tuple(table.ravel().tolist())).encode()
    yield ("3 %d %d %d\n" * len(faces) % tuple(faces.ravel().tolist())).encode()
