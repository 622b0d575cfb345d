"""PLY, text and binary."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.asset import Asset
from lodpipe.core.errors import AssetError
from lodpipe.core.material import Image
from lodpipe.core.mesh import F32, F64
from lodpipe.io.build import Part, build_mesh
from lodpipe.io.clean import Warn
from lodpipe.io.images import find_image
from lodpipe.io.paths import Folder, shorten
from lodpipe.io.plain import single_mesh
from lodpipe.io.polygons import triangulate, usable
from lodpipe.io.text import decode_name, numbers

_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_TYPES |= {"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"}
_TYPES |= {"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"}
_ORDER = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
#: Names under which vertex properties are known, by glTF attribute.
_VERTEX: dict[str, list[tuple[str, ...]]] = {
    "NORMAL": [("nx", "ny", "nz")],
    "COLOR_0": [
        ("red", "green", "blue", "alpha"),
        ("red", "green", "blue"),
        ("r", "g", "b"),
        ("diffuse_red", "diffuse_green", "diffuse_blue"),
    ],
    "TEXCOORD_0": [("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("tx", "ty")],
}
_MAX_LIST = 1 << 24


@dataclass
class _Property:
    name: str
    type: str
    """NumPy's name for it, without byte order."""
    count_type: str = ""
    """Of a list: the type of the number before it."""


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)

    @property
    def least_size(self) -> int:
        """Bytes of a binary row whose lists are empty; words of a text row are never more than that."""
        return sum(np.dtype(p.count_type or p.type).itemsize for p in self.properties)


@dataclass
class _Lists:
    """A list property: `counts` (N,) and the values one after another."""

    counts: NDArray[Any]
    values: NDArray[Any]


_Columns = dict[str, Any]  # property name -> (N,) array or _Lists


def read_ply(folder: Folder, warn: Warn) -> Asset:
    """Faces or triangle strips; vertex normals, colours, UVs; corner UVs and a TextureFile as MeshLab writes them."""
    data = folder.read_asset()
    order, elements, textures, body = _header(data)
    folder.limits.check_triangles(max((e.count for e in elements if e.name == "face"), default=0))
    columns = {}
    for element, values in _rows(memoryview(data)[body:], order, elements):
        columns[element.name] = values
    vertex = columns.get("vertex")
    if vertex is None or not {"x", "y", "z"} <= set(vertex):
        raise AssetError("it has no vertex element with x, y and z")
    positions = np.stack([vertex[axis] for axis in "xyz"], axis=1)
    attributes = _attributes(vertex, warn)
    part = _part(columns, positions, attributes, warn)
    image: Image | None = None
    if textures:
        image = find_image(folder, textures[0])
        part.material = 0
        for name in textures[1:]:
            warn(f"texture {shorten(name)} left out: one texture for a PLY file is read")
    return single_mesh(folder.path, build_mesh([part], "faces", warn), image)


def _header(data: bytes) -> tuple[str, list[_Element], list[str], int]:
    """Byte order (empty for text), elements, texture names, and where the body starts."""
    end = re.search(rb"^end_header[ \t]*(\r\n|\n|\r)", data[: 1 << 20], re.MULTILINE)
    if not data.startswith(b"ply") or end is None:
        raise AssetError("it has no PLY header" if data else "the file is empty")
    order: str | None = None
    elements: list[_Element] = []
    textures = []
    for line in re.split(rb"\r\n|\n|\r", data[: end.start()])[1:]:
        words = decode_name(line).split()
        try:
            if not words or words[0] == "obj_info":
                continue
            if words[0] == "comment":
                if len(words) > 2 and words[1].lower() == "texturefile":
                    textures.append(decode_name(line).split(None, 2)[2])
            elif words[0] == "format":
                order = _ORDER[words[1]]
            elif words[0] == "element":
                elements.append(_Element(words[1], int(words[2])))
            elif words[0] == "property" and words[1] == "list":
                elements[-1].properties.append(_Property(words[4], _TYPES[words[3]], _TYPES[words[2]]))
            elif words[0] == "property":
                elements[-1].properties.append(_Property(words[2], _TYPES[words[1]]))
            else:
                raise KeyError(words[0])
        except (KeyError, IndexError, ValueError) as error:
            raise AssetError(f"its header line {shorten(decode_name(line))} cannot be understood") from error
    if order is None:
        raise AssetError("its header has no format line")
    if any(e.count < 0 for e in elements) or len({e.name for e in elements}) < len(elements):
        raise AssetError("its header is not valid: a negative count, or an element that is there twice")
    return order, elements, textures, end.end()


def _rows(body: memoryview, order: str, elements: list[_Element]) -> Iterable[tuple[_Element, _Columns]]:
    if not order:
        words = numbers(bytes(body), -1)
        at = 0
        for element in elements:
            need = element.count * len(element.properties)
            _check_room(element, need, len(words) - at)
            columns, at = _take(words, at, element)
            yield element, columns
        return
    at = 0
    for element in elements:
        _check_room(element, element.count * element.least_size, len(body) - at)
        columns, at = _binary(body, at, order, element)
        yield element, columns


def _check_room(element: _Element, need: int, there: int) -> None:
    if need > there:
        raise AssetError(
            f"its header says {element.count:,} rows of '{element.name}', but the data ends before that",
            advice="the file is cut off or damaged: copy or export it again",
        )


def _binary(body: memoryview, at: int, order: str, element: _Element) -> tuple[_Columns, int]:
    """The columns of a binary element, and where it ends.

    Rows are taken as if all lists were as long as those of the first row: true for triangle meshes, and then no
    row is looked at by itself.
    """
    lengths = _first_lengths(body, at, order, element)
    row = np.dtype(
        [
            item
            for i, p in enumerate(element.properties)
            for item in (
                [(f"n{i}", order + p.count_type), (f"v{i}", order + p.type, (lengths[i],))]
                if p.count_type
                else [(f"v{i}", order + p.type)]
            )
        ]
    )
    size = row.itemsize * element.count
    if at + size <= len(body):
        table = np.frombuffer(body, row, element.count, at)
        lists = [i for i, p in enumerate(element.properties) if p.count_type]
        if all((table[f"n{i}"] == lengths[i]).all() for i in lists):
            columns: _Columns = {}
            for i, p in enumerate(element.properties):
                values = table[f"v{i}"]
                columns[p.name] = _Lists(np.full(len(table), lengths[i]), values.reshape(-1)) if i in lists else values
            return columns, at + size
    return _row_by_row(body, at, order, element)


def _first_lengths(body: memoryview, at: int, order: str, element: _Element) -> list[int]:
    """For each property the length of its list in the first row; 1 for a scalar."""
    lengths = []
    for p in element.properties:
        n = 1
        if p.count_type and element.count:
            n = int(_scalar(body, at, order + p.count_type, element))
            at += np.dtype(p.count_type).itemsize
        lengths.append(n)
        at += n * np.dtype(p.type).itemsize
    return lengths


def _scalar(body: memoryview, at: int, kind: str, element: _Element) -> Any:
    if at + np.dtype(kind).itemsize > len(body):
        _check_room(element, 1, 0)
    value = np.frombuffer(body, kind, 1, at)[0]
    if not 0 <= value <= _MAX_LIST:
        raise AssetError(f"a list of '{element.name}' says that it has {value} values")
    return value


def _row_by_row(body: memoryview, at: int, order: str, element: _Element) -> tuple[_Columns, int]:
    """Binary rows whose lists differ in length."""
    spans: list[list[int]] = [[] for _ in element.properties]
    counts: list[list[int]] = [[] for _ in element.properties]
    sizes = [np.dtype(p.type).itemsize for p in element.properties]
    heads = [np.dtype(p.count_type).itemsize if p.count_type else 0 for p in element.properties]
    endian: Literal["little", "big"] = "little" if order == "<" else "big"
    signed = [p.count_type.startswith("i") for p in element.properties]
    total = len(body)
    for _ in range(element.count):
        for i, head in enumerate(heads):
            n = 1
            if head:
                n = int.from_bytes(body[at : at + head], endian, signed=signed[i])
                at += head
                counts[i].append(n)
            spans[i].append(at)
            at += n * sizes[i]
            if at > total or not 0 <= n <= _MAX_LIST:
                _check_room(element, 1, 0)
    columns: _Columns = {}
    raw = np.frombuffer(body, np.uint8)
    for i, p in enumerate(element.properties):
        n_values = np.array(counts[i] if p.count_type else np.ones(element.count, int), np.int64)
        starts = np.repeat(np.array(spans[i], np.int64), n_values)
        within = np.arange(len(starts)) - np.repeat(np.cumsum(n_values) - n_values, n_values)
        picked = raw[(starts + within * sizes[i])[:, None] + np.arange(sizes[i])]
        values = np.ascontiguousarray(picked).view(order + p.type).reshape(-1)
        columns[p.name] = _Lists(n_values, values) if p.count_type else values
    return columns, at


def _take(words: F64, at: int, element: _Element) -> tuple[_Columns, int]:
    """The columns of a text element, and the word after it."""
    width = len(element.properties)
    lists = [p for p in element.properties if p.count_type]
    if not lists:
        table = words[at : at + width * element.count].reshape(element.count, width)
        return {p.name: _typed(table[:, i], p) for i, p in enumerate(element.properties)}, at + table.size
    starts = np.zeros((element.count, width), np.int64)
    lengths = np.ones((element.count, width), np.int64)
    if len(element.properties) == 1 and element.count and words[at] == words[at]:
        n = int(words[at])
        block = words[at : at + element.count * (n + 1)] if 0 <= n <= _MAX_LIST else words[:0]
        if block.size == element.count * (n + 1) and (block[:: n + 1] == n).all():
            counts = np.full(element.count, n)
            values = block.reshape(element.count, n + 1)[:, 1:].reshape(-1)
            return {lists[0].name: _Lists(counts, values)}, at + block.size
    for row in range(element.count):
        for i, p in enumerate(element.properties):
            if p.count_type:
                if at >= len(words) or not 0 <= words[at] <= len(words):
                    _check_room(element, 1, 0)
                lengths[row, i] = int(words[at])
                at += 1
            starts[row, i] = at
            at += int(lengths[row, i])
            if at > len(words):
                _check_room(element, 1, 0)
    columns: _Columns = {}
    for i, p in enumerate(element.properties):
        n_values = lengths[:, i]
        within = np.arange(n_values.sum()) - np.repeat(np.cumsum(n_values) - n_values, n_values)
        values = words[np.repeat(starts[:, i], n_values) + within]
        columns[p.name] = _Lists(n_values, values) if p.count_type else _typed(values, p)
    return columns, at


def _typed(values: F64, said: _Property) -> NDArray[Any]:
    """Integers where the header says so: colours are told by it."""
    return _whole(values).astype(said.type) if said.type[0] in "iu" else values


def _attributes(vertex: Mapping[str, Any], warn: Warn) -> dict[str, NDArray[Any]]:
    attributes: dict[str, NDArray[Any]] = {}
    used = {"x", "y", "z"}
    for attribute, spellings in _VERTEX.items():
        names = next((s for s in spellings if set(s) <= set(vertex)), None)
        if names is None:
            continue
        used |= set(names)
        values = np.stack([vertex[n] for n in names], axis=1).astype(np.float64)
        if attribute == "COLOR_0" and (vertex[names[0]].dtype.kind in "iu" or values.max(initial=0.0) > 1.0):
            values /= 65535.0 if vertex[names[0]].dtype.itemsize == 2 else 255.0
        if attribute == "TEXCOORD_0":
            values[:, 1] = 1.0 - values[:, 1]
        attributes[attribute] = values
    rest = sorted(set(vertex) - used)
    if rest:
        warn(f"vertex properties left out: {', '.join(map(shorten, rest))}")
    return attributes


def _part(
    columns: Mapping[str, _Columns], positions: NDArray[Any], attributes: dict[str, NDArray[Any]], warn: Warn
) -> Part:
    face = columns.get("face", {})
    lists = next((face[n] for n in ("vertex_indices", "vertex_index") if isinstance(face.get(n), _Lists)), None)
    if lists is None or not len(lists.counts):
        strips = columns.get("tristrips", {}).get("vertex_indices")
        faces = _strips(strips.values) if isinstance(strips, _Lists) else np.zeros((0, 3), np.int64)
        return Part(positions, faces, attributes)
    corners = _whole(lists.values)
    good = usable(lists.counts, corners, len(positions), "faces", warn)
    each = np.repeat(good, lists.counts)
    counts = lists.counts[good]
    rest = sorted(set(face) - {"vertex_indices", "vertex_index", "texcoord", "texnumber"})
    if rest:
        warn(f"face properties left out: {', '.join(map(shorten, rest))}")
    corners = corners if good.all() else corners[each]
    uvs = face.get("texcoord")
    points = positions[corners] if (counts != 3).any() else np.empty((len(corners), 0))
    faces, _ = triangulate(counts, points, "faces", warn)
    if isinstance(uvs, _Lists) and (uvs.counts == 2 * lists.counts).all():
        corner_uv = uvs.values.reshape(-1, 2)[each].astype(np.float64)
        corner_uv[:, 1] = 1.0 - corner_uv[:, 1]
        apart = {name: values[corners] for name, values in attributes.items()} | {"TEXCOORD_0": corner_uv}
        return _merge_corners(positions[corners], faces, apart)
    if isinstance(uvs, _Lists) and uvs.counts.any():
        warn("texcoord of faces left out: not two for each corner")
    return Part(positions, corners[faces] if (counts != 3).any() else corners.reshape(-1, 3), attributes)


def _merge_corners(positions: NDArray[Any], faces: NDArray[Any], attributes: dict[str, NDArray[Any]]) -> Part:
    """A part with a row for each corner, equal rows made one."""
    from lodpipe.io.weld import unique_rows

    table = [positions, *attributes.values()]
    first, inverse = unique_rows([np.ascontiguousarray(t[:, k]) for t in table for k in range(t.shape[1])])
    return Part(positions[first], inverse[faces], {name: values[first] for name, values in attributes.items()})


def _strips(values: NDArray[Any]) -> NDArray[np.int64]:
    """Triangles of strips, each ended by −1; every other one is turned. Without those of two equal corners."""
    index = _whole(values)
    if len(index) < 3:
        return np.zeros((0, 3), np.int64)
    start = np.concatenate([[0], np.flatnonzero(index < 0) + 1])
    since = np.arange(len(index)) - start[np.searchsorted(start, np.arange(len(index)), "right") - 1]
    a, b, c = index[:-2], index[1:-1], index[2:]
    real = (a >= 0) & (b >= 0) & (c >= 0) & (a != b) & (b != c) & (c != a)
    odd = since[:-2] % 2 == 1
    faces: NDArray[np.int64] = np.stack([np.where(odd, b, a), np.where(odd, a, b), c], axis=1)[real]
    return faces


def _whole(values: NDArray[Any]) -> NDArray[Any]:
    """Indices as integers; −2, which is out of range, for a number that is none."""
    if values.dtype.kind in "iu":
        return values.astype(np.int64) if values.dtype.kind == "u" else values
    return np.where(np.isfinite(values) & (np.abs(values) < 2**40), values, -2).astype(np.int64)


def write_ply(
    positions: F64, faces: NDArray[np.int32], attributes: Mapping[str, F32], textures: Sequence[str] = ()
) -> Iterable[bytes]:
    """Binary little-endian PLY: float positions (double where float would lose digits), normals, UVs and colours."""
    exact = bool((positions.astype(np.float32) == positions).all())
    fields: list[tuple[str, str, str, NDArray[Any]]] = []
    real = ("float", "<f4") if exact else ("double", "<f8")
    fields += [("xyz"[k], *real, positions[:, k]) for k in range(3)]
    if "NORMAL" in attributes:
        fields += [(f"n{'xyz'[k]}", "float", "<f4", attributes["NORMAL"][:, k]) for k in range(3)]
    if "TEXCOORD_0" in attributes:
        uv = attributes["TEXCOORD_0"]
        fields += [("s", "float", "<f4", uv[:, 0]), ("t", "float", "<f4", 1.0 - uv[:, 1].astype(np.float64))]
    if "COLOR_0" in attributes:
        colours = np.rint(np.clip(attributes["COLOR_0"], 0, 1) * 255)
        names = ("red", "green", "blue", "alpha")[: colours.shape[1]]
        fields += [(name, "uchar", "u1", colours[:, k]) for k, name in enumerate(names)]
    header = ["ply", "format binary_little_endian 1.0", "comment lodpipe"]
    header += [f"comment TextureFile {name}" for name in textures]
    header += [f"element vertex {len(positions)}"]
    header += [f"property {kind} {name}" for name, kind, _, _ in fields]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    yield "\n".join(header).encode()
    rows = np.zeros(len(positions), np.dtype([(name, code) for name, _, code, _ in fields]))
    for name, _, _, values in fields:
        rows[name] = values
    yield rows.tobytes()
    corners = np.zeros(len(faces), np.dtype([("n", "u1"), ("v", "<i4", 3)]))
    corners["n"], corners["v"] = 3, faces
    yield corners.tobytes()
