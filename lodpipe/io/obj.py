"""Wavefront OBJ."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.asset import Asset
from lodpipe.core.errors import AssetError
from lodpipe.core.material import Material
from lodpipe.core.mesh import F64, Mesh
from lodpipe.io.build import Part, build_mesh
from lodpipe.io.clean import Warn
from lodpipe.io.mtl import Library
from lodpipe.io.paths import Folder, stem
from lodpipe.io.polygons import triangulate, usable
from lodpipe.io.text import Lines, decode_name, integers, plain_text, strip_comments, word_starts
from lodpipe.io.weld import unique_rows
from lodpipe.kernel import tables

_Ints = NDArray[np.signedinteger[Any]]
#: A face line that is not made of v, v/t, v//n or v/t/n.
_BAD_FACE = re.compile(rb"[^0-9/+\-\s]|[0-9][+-]|[+\-](?![0-9])|(?<![0-9/])/|///|/[^\s/]*/[^\s/]*/")
_LEFT_OUT = {b"l": "lines", b"p": "points", b"curv": "curves", b"surf": "surfaces"}


@dataclass
class _Corners:
    """The corners of all polygons: rows of the v, vt and vn lines, −1 where the file names none."""

    counts: _Ints
    line: NDArray[np.intp]
    vertex: _Ints
    uv: _Ints
    normal: _Ints


def read_obj(folder: Folder, warn: Warn) -> Asset:
    """An OBJ with its material libraries and maps.

    Each `o` object becomes a Mesh, as long as no two objects share a vertex; where they do, the whole file is one
    Mesh, so that the border between the objects stays closed. Each material becomes a primitive. Groups and
    smoothing groups are not kept.
    """
    data = plain_text(folder.read_asset())
    folder.limits.check_triangles(data.count(b"\nf "))
    if b"\\" in data:
        data = data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    lines = Lines(strip_comments(data, b"v|vt|vn|f"))
    vertex_lines = lines.starting(b"v")
    if not len(vertex_lines):
        raise AssetError("it has no vertices", advice="check that the file is a Wavefront OBJ and not empty")
    for keyword, what in _LEFT_OUT.items():
        if count := len(lines.starting(keyword)):
            warn(f"{count:,} {what} left out")
    wide = int(lines.words[vertex_lines].max()) > 6
    table, columns = lines.table(vertex_lines, b"v", 6 if wide else 3)
    corners = _polygons(lines, vertex_lines, warn)
    good = usable(corners.counts, corners.vertex, len(table), "faces", warn)
    corners = _select(corners, good)
    faces, owner = triangulate(corners.counts, table[corners.vertex, :3], "faces", warn)
    face_line = corners.line[owner]
    library = Library(folder, warn)
    for line in lines.starting(b"mtllib").tolist():
        for name in library_names(folder, decode_name(lines.rest(line, b"mtllib"))):
            library.read(name)
    material = _names(lines, b"usemtl", face_line)
    used = set(np.unique(material.of_face).tolist())
    rows = np.array([library.row(name) if name and i in used else -1 for i, name in enumerate(material.names)])
    material_of = rows[material.of_face]
    reader = _Reader(lines, table, columns, corners, warn)
    meshes = [
        reader.mesh(faces[chosen], material_of[chosen], name)
        for name, chosen in _objects(lines, face_line, corners.vertex[faces])
    ]
    title = stem(folder.path)
    nodes = [{"mesh": i, "name": mesh.name or title} for i, mesh in enumerate(meshes)]
    return Asset(
        name=title,
        meshes=tuple(meshes),
        materials=tuple(Material(m) for m in library.materials),
        images=tuple(library.images),
        document=library.document(nodes),
    )


class _Reader:
    """The tables of the file, from which meshes are cut."""

    def __init__(self, lines: Lines, table: F64, columns: _Ints, corners: _Corners, warn: Warn) -> None:
        self.positions = table[:, :3]
        self.colours = None
        if table.shape[1] == 6:
            self.colours = np.where(columns[:, None] >= 6, table[:, 3:], 1.0)
            if np.nanmax(self.colours, initial=0.0) > 1.0:
                self.colours = self.colours / 255.0
        self.uvs, _ = lines.table(lines.starting(b"vt"), b"vt", 2)
        self.normals, _ = lines.table(lines.starting(b"vn"), b"vn", 3)
        for name, index, rows in (("vt", corners.uv, self.uvs), ("vn", corners.normal, self.normals)):
            outside = index >= len(rows)
            outside |= index < -1
            if outside.any():
                warn(f"{int(outside.sum()):,} corners name a {name} that is not there; they get none")
                index[outside] = -1
        self.corners = corners
        self.warn = warn

    def mesh(self, faces: _Ints, material: _Ints, name: str) -> Mesh:
        """The Mesh of `faces` (F, 3), rows of the corners, with a primitive for each material."""
        kinds = np.unique(material)
        parts = []
        for kind in kinds.tolist():
            chosen = faces if len(kinds) == 1 else faces[material == kind]
            parts.append(self._part(chosen, None if kind < 0 else kind))
        return build_mesh(parts, f"object {name}" if name else "mesh", self.warn, name=name)

    def _part(self, faces: _Ints, material: int | None) -> Part:
        """One primitive: each distinct v/t/n becomes a row."""
        flat = faces.ravel()
        keys = [self.corners.vertex[flat], self.corners.uv[flat], self.corners.normal[flat]]
        used = [key for key in keys[1:] if (key >= 0).any()]
        if used:
            first, rows = unique_rows([keys[0], *used])
            vertex, uv, normal = (key[first] for key in keys)
            points = self.positions[vertex]
        else:
            vertex, uv, normal = np.arange(len(self.positions)), np.full(1, -1), np.full(1, -1)
            rows, points = keys[0].astype(np.int32), self.positions
        attributes = {}
        if (normal >= 0).any():
            attributes["NORMAL"] = np.where(normal[:, None] >= 0, self.normals[normal], 0.0)
        if (uv >= 0).any():
            chosen = np.where(uv[:, None] >= 0, self.uvs[uv], (0.0, 1.0))
            attributes["TEXCOORD_0"] = np.stack([chosen[:, 0], 1.0 - chosen[:, 1]], axis=1)
        if self.colours is not None:
            attributes["COLOR_0"] = self.colours[vertex]
        return Part(points, rows.reshape(-1, 3), attributes, material)


def _polygons(lines: Lines, vertex_lines: NDArray[np.intp], warn: Warn) -> _Corners:
    face_lines = lines.starting(b"f")
    counts = lines.words[face_lines].astype(np.int64) - 1
    parsed: tuple[_Ints, _Ints, _Ints] | None = tables.text_corners(
        lines.data, lines.first[face_lines] + 1, lines.end[face_lines], counts
    )
    if parsed is None:
        body = lines.body(face_lines, b"f")
        parsed = _indices(body)
    if parsed is None:
        bad = np.array([bool(_BAD_FACE.search(line)) for line in body.split(b"\n")[:-1]], bool)
        warn(f"{int(bad.sum()):,} face lines that are not made of indices left out")
        face_lines, counts = face_lines[~bad], counts[~bad]
        parsed = _indices(lines.body(face_lines, b"f"))
        if parsed is None:
            raise AssetError("its face lines cannot be understood", advice="export the model again")
    resolved = []
    for index, keyword in zip(parsed, (b"v", b"vt", b"vn"), strict=True):
        defined = vertex_lines if keyword == b"v" else lines.starting(keyword)
        if (index < 0).any():
            before = np.repeat(np.searchsorted(defined, face_lines), counts)
            # a negative index counts back from the last one defined; one before the first is out of range
            index = np.where(index < 0, np.where(before + index < 0, -2, before + index), index - 1)
        else:
            index = index - 1
        resolved.append(index)
    return _Corners(counts, face_lines, *resolved)


def _indices(body: bytes) -> tuple[_Ints, _Ints, _Ints] | None:
    """The v, t and n of each word of face lines, 0 where there is none; None if a word is something else."""
    if body.translate(None, b"0123456789/+- \t\r\n\v\f"):
        return None
    body = body.replace(b"//", b"/0/")
    if re.search(rb"/\s", body):
        body = re.sub(rb"/(?=\s)", b"/0", body)
    codes = np.frombuffer(body, np.uint8)
    words = word_starts(codes)
    slashes = np.flatnonzero(codes == ord("/"))
    numbers = 1 + np.bincount(np.searchsorted(words, slashes, "right") - 1, minlength=len(words))
    try:
        values = integers(body.replace(b"/", b" "))
    except (ValueError, DeprecationWarning):
        return None
    if len(values) != numbers.sum() or (len(numbers) and numbers.max() > 3):
        return None
    begin = np.cumsum(numbers) - numbers
    none = np.zeros(len(words), np.int64)
    result = [values[begin], none, none]
    for k in (1, 2):
        has = numbers > k
        if has.any():
            result[k] = np.where(has, values[np.where(has, begin + k, 0)], 0)
    return result[0], result[1], result[2]


def _select(corners: _Corners, good: NDArray[np.bool_]) -> _Corners:
    if good.all():
        return corners
    keep = np.repeat(good, corners.counts)
    return _Corners(
        corners.counts[good], corners.line[good], corners.vertex[keep], corners.uv[keep], corners.normal[keep]
    )


@dataclass
class _Named:
    """Which name holds for each face: `names[of_face]`; names[0] is empty, for faces before the first statement."""

    names: list[str]
    of_face: _Ints


def _names(lines: Lines, keyword: bytes, face_line: NDArray[np.intp]) -> _Named:
    said = lines.starting(keyword)
    names = [""]
    row = {"": 0}
    table = [0]
    for line in said.tolist():
        name = decode_name(lines.rest(line, keyword))
        if name not in row:
            row[name] = len(names)
            names.append(name)
        table.append(row[name])
    return _Named(names, np.array(table)[np.searchsorted(said, face_line)])


def _objects(lines: Lines, face_line: NDArray[np.intp], faces: _Ints) -> list[tuple[str, NDArray[np.intp]]]:
    """(name, faces) of each object in the order of the file; one without a name if objects share vertices."""
    named = _names(lines, b"o", face_line)
    everything = np.arange(len(face_line))
    kinds = np.unique(named.of_face)
    if len(kinds) <= 1:
        return [(named.names[int(kinds[0])] if len(kinds) else "", everything)]
    owner = np.full(int(faces.max()) + 1, -1)
    owner[faces.ravel()] = np.repeat(named.of_face, 3)
    if (owner[faces] != named.of_face[:, None]).any():
        return [("", everything)]
    order = np.argsort(named.of_face, kind="stable")
    bound = np.searchsorted(named.of_face[order], kinds)
    return [(named.names[int(k)], c) for k, c in zip(kinds, np.split(order, bound[1:]), strict=True)]


def library_names(folder: Folder, text: str) -> list[str]:
    """The names of a mtllib statement: one with spaces in it if there is such a file, else one for each word."""
    if " " not in text:
        return [text] if text else []
    try:
        folder.find(text)
    except AssetError:
        words = text.split()
        return words if any(word.lower().endswith(".mtl") for word in words[:-1]) else [text]
    return [text]
