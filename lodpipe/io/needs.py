"""Which files an asset is made of, found without reading it as a model: what a watcher waits for and copies.

Only names are taken from the file, by plain text and JSON; the same rules of safety hold as for reading (`Folder`).
"""

from __future__ import annotations

import posixpath
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote

from lodpipe.core.errors import AssetError, LimitError, LodpipeError
from lodpipe.io.gltf_schema import parse_json
from lodpipe.io.limits import Limits
from lodpipe.io.mtl import image_names, map_names
from lodpipe.io.obj import library_names
from lodpipe.io.paths import Folder
from lodpipe.io.text import decode_name, plain_text

_CHUNK = 1 << 20
_MTLLIB = re.compile(rb"(?m)^[ \t]*mtllib[ \t]+([^\r\n]+)")
_SMALL_TEXT = 64 << 20
"""UTF-16 is looked through in text of up to so many bytes."""


@dataclass
class Needs:
    """The files beside an asset that it needs, by the names that it gives them, with slashes."""

    members: dict[str, int] = field(default_factory=dict)
    """Files that are there, and how many bytes they must have at least."""
    missing: list[str] = field(default_factory=list)
    """Files that are not there. Names that must not be followed (out of the folder, addresses) are not waited for."""
    wanted: list[str] = field(default_factory=list)
    """The same with every other name that would do in the place of one of them."""


def find_needs(path: Path, limits: Limits) -> Needs:
    """What the model at `path` needs besides itself. A file that cannot be understood needs nothing."""
    finder = _Finder(Folder(path, limits))
    try:
        if path.suffix.lower() in (".gltf", ".glb"):
            finder.gltf()
        elif path.suffix.lower() == ".obj":
            finder.obj()
    except (LodpipeError, OSError, ValueError, RecursionError, struct.error):
        pass  # reading it tells what is wrong with it
    return finder.needs


class _Finder:
    def __init__(self, folder: Folder) -> None:
        self.folder = folder
        self.needs = Needs()

    def gltf(self) -> None:
        tree = parse_json(_gltf_text(self.folder.path, self.folder.limits), self.folder.limits)
        for key in ("buffers", "images"):
            listed = tree.get(key)
            for said in listed if isinstance(listed, list) else ():
                uri = said.get("uri") if isinstance(said, dict) else None
                if isinstance(uri, str) and not uri.startswith("data:"):
                    length = said.get("byteLength", 0) if key == "buffers" else 0
                    self.want([unquote(uri)], length if isinstance(length, int) else 0)

    def obj(self) -> None:
        for statement in dict.fromkeys(_mtllibs(self.folder.path)):
            for name in library_names(self.folder, decode_name(statement)):
                library = self.want([name])
                if library is None:
                    continue
                base = name.replace("\\", "/").rpartition("/")[0]
                for texture in map_names(plain_text(self.folder.read(name))):
                    self.want(image_names(texture, base))

    def want(self, names: list[str], at_least: int = 0) -> Path | None:
        """Note the first of `names` that is there; else the first that may be followed, as missing."""
        for name in names:
            plain = name.replace("\\", "/")
            try:
                path = self.folder.find(name)
            except AssetError:
                if ".." in plain.split("/") and plain not in self.folder.missing:
                    return None  # it leads out of the folder: the reader says so, there is nothing to wait for
                continue
            self.needs.members[plain] = max(self.needs.members.get(plain, 0), at_least)
            return path
        wanted = [name for name in (name.replace("\\", "/") for name in names) if name in self.folder.missing]
        shown = [name for name in wanted if ":" not in name] or wanted  # rather not the path of another machine
        if shown and shown[0] not in self.needs.missing:
            self.needs.missing.append(shown[0])
        self.needs.wanted += [name for name in wanted if name not in self.needs.wanted]
        return None


def contained(name: str, folder: str) -> str:
    """The place of the member `name` relative to the parent of its asset's `folder`, dots resolved; '' if outside."""
    place = posixpath.normpath(posixpath.join(folder, name))
    return place if place.startswith(folder + "/") else ""


def _gltf_text(path: Path, limits: Limits) -> bytes:
    with path.open("rb") as file:
        head = file.read(20)
        if head[:4] != b"glTF":
            size, rest = path.stat().st_size, limits.json_bytes - len(head)
            if size > limits.json_bytes:
                raise LimitError("its JSON is too large")
            return head + file.read(rest)
        length, kind = struct.unpack_from("<II", head, 12)
        if kind != 0x4E4F534A or length > limits.json_bytes:
            raise AssetError("it has no JSON chunk")
        return file.read(length)


def _mtllibs(path: Path) -> Iterator[bytes]:
    """What follows `mtllib` in the lines of an OBJ, which is read in pieces."""
    with path.open("rb") as file:
        head = file.read(64)
        if b"\0" in head:
            if path.stat().st_size <= _SMALL_TEXT:
                yield from (match[1].strip() for match in _MTLLIB.finditer(plain_text(head + file.read(_SMALL_TEXT))))
            return
        rest = head
        while chunk := file.read(_CHUNK):
            *lines, rest = (rest + chunk).rsplit(b"\n", 1)
            for part in lines:
                yield from (match[1].strip() for match in _MTLLIB.finditer(part))
            rest = rest[-_CHUNK:]
        yield from (match[1].strip() for match in _MTLLIB.finditer(rest))
