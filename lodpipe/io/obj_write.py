"""Wavefront OBJ with a material library and its maps."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.asset import Asset
from lodpipe.core.mesh import I32, Mesh
from lodpipe.io.clean import Warn
from lodpipe.io.mtl import format_material
from lodpipe.io.placed import Placed, placements
from lodpipe.io.primitives import first_use
from lodpipe.io.textures import file_names

_CHUNK = 100_000


def obj_files(asset: Asset, path: Path, meshes: Sequence[Mesh], warn: Warn) -> list[tuple[str, bytes]]:
    """Name and bytes of the .obj, its .mtl and its maps. Each placed mesh is an object, each material a `usemtl`."""
    library = _Library(asset, path)
    out = [b"# lodpipe\n"]
    if asset.materials:
        out.append(f"mtllib {library.name}\n".encode())
    count = np.ones(3, np.int64)  # next number of v, vt and vn
    for number, part in enumerate(placements(asset, meshes)):
        title = _word(part.mesh.name) or f"{_word(asset.name) or 'mesh'}_{number}"
        out.append(f"o {title}\n".encode())
        out += _object(part, count, library)
    lost = {n for mesh in meshes for n in mesh.attributes} - {"NORMAL", "TEXCOORD_0", "COLOR_0"}
    if lost:
        warn(f"OBJ has no place for {', '.join(sorted(lost))}; left out")
    return [(path.name, b"".join(out)), *library.files()]


def _object(part: Placed, count: NDArray[np.int64], library: _Library) -> Iterator[bytes]:
    mesh, attributes = part.mesh, part.mesh.attributes
    colours = attributes.get("COLOR_0")
    # a position whose wedges differ in colour needs a v line for each
    used, faces = first_use(part.faces if colours is None else part.wedges)
    rows = np.empty(len(used), np.int32)
    rows[faces.ravel()] = part.faces.ravel()
    points = part.positions[rows]
    digits = "%.9g" if (points.astype(np.float32) == points).all() else "%.17g"
    if colours is None:
        yield from _lines(f"v {digits} {digits} {digits}\n", points)
    else:
        yield from _lines(f"v {digits} {digits} {digits} %.6g %.6g %.6g\n", np.hstack([points, colours[used][:, :3]]))
    corners: dict[str, I32] = {}
    for name, values in (("TEXCOORD_0", attributes.get("TEXCOORD_0")), ("NORMAL", part.normals)):
        if values is None:
            continue
        wedges, corners[name] = first_use(part.wedges)
        table = values[wedges].astype(np.float64)
        if name == "TEXCOORD_0":
            table[:, 1] = 1.0 - table[:, 1]
            yield from _lines("vt %.9g %.9g\n", table)
        else:
            yield from _lines("vn %.7g %.7g %.7g\n", table)
    for i, primitive in enumerate(mesh.primitives):
        chosen = np.flatnonzero(mesh.face_primitive == i)
        if not len(chosen):
            continue
        if library.materials:
            yield f"usemtl {library.material(primitive.material)}\n".encode()
        columns = [faces[chosen] + count[0]]
        pattern = "%d"
        if "TEXCOORD_0" in corners and "TEXCOORD_0" in primitive.attributes:
            columns.append(corners["TEXCOORD_0"][chosen] + count[1])
            pattern = "%d/%d"
        if "NORMAL" in corners and "NORMAL" in primitive.attributes:
            columns.append(corners["NORMAL"][chosen] + count[2])
            pattern += "/%d" if len(columns) == 3 else "//%d"
        yield from _lines(f"f {pattern} {pattern} {pattern}\n", np.stack(columns, axis=2).reshape(len(chosen), -1))
    sizes = [len(used), *(int(corners[n].max()) + 1 if n in corners else 0 for n in ("TEXCOORD_0", "NORMAL"))]
    count += sizes


class _Library:
    """The material library of one OBJ, with names that are words and each used once."""

    def __init__(self, asset: Asset, path: Path) -> None:
        self.asset = asset
        self.name = _word(path.stem) + ".mtl"
        self.materials: list[str] = []
        taken: set[str] = set()
        for i, material in enumerate(asset.materials):
            title = _word(material.name) or f"material_{i}"
            while title in taken:
                title += "_"
            taken.add(title)
            self.materials.append(title)
        self.images = file_names(asset.images, (path.name, self.name))
        self._used: set[int] = set()

    def material(self, row: int | None) -> str:
        return "default" if row is None else self.materials[row]

    def files(self) -> list[tuple[str, bytes]]:
        """The .mtl, and the maps that it names."""
        if not self.materials:
            return []
        text = "# lodpipe\n" + "".join(
            format_material(m, name, self._map) for m, name in zip(self.asset.materials, self.materials, strict=True)
        )
        maps = {self.images[i]: self.asset.images[i].data for i in sorted(self._used)}
        return [(self.name, text.encode()), *maps.items()]

    def _map(self, texture: int) -> str | None:
        row = texture_source(self.asset.document, texture)
        if row is None or not self.asset.images[row].data:
            return None
        self._used.add(row)
        return self.images[row]


def texture_source(document: Mapping[str, Any], texture: int) -> int | None:
    """The image row of a texture: its own source, else the first that an extension gives."""
    said = document.get("textures", ())[texture]
    sources = [said, *said.get("extensions", {}).values()]
    return next((int(s["source"]) for s in sources if "source" in s), None)


def _word(name: str) -> str:
    """A name as one word."""
    return re.sub(r"\s+", "_", "".join(c for c in name if c.isprintable()).strip())


def _lines(pattern: str, table: NDArray[Any]) -> Iterator[bytes]:
    """Each row of `table` by `pattern`."""
    for start in range(0, len(table), _CHUNK):
        block = table[start : start + _CHUNK]
        yield (pattern * len(block) % tuple(block.ravel().tolist())).encode()
