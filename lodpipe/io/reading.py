"""One way in: `load` reads an asset of any format."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable
from pathlib import Path

from lodpipe.core.asset import Asset, Lod
from lodpipe.core.errors import AssetError, InvalidMesh, LimitError, LodpipeError
from lodpipe.io.clean import Warn, has_area
from lodpipe.io.limits import DEFAULT, Limits
from lodpipe.io.paths import Folder

#: File extension -> the module and function that read it.
FORMATS = {
    ".glb": "gltf_read:read_gltf",
    ".gltf": "gltf_read:read_gltf",
    ".obj": "obj:read_obj",
    ".ply": "ply:read_ply",
    ".stl": "stl:read_stl",
    ".off": "off:read_off",
}
_MAGIC = {b"glTF": (".glb", ".gltf"), b"ply\n": (".ply",), b"ply\r": (".ply",)}

Reader = Callable[[Folder, Warn], Asset]


def is_asset(path: Path) -> bool:
    """Whether the file name is that of a model that `load` reads."""
    return path.suffix.lower() in FORMATS


def load(path: Path, limits: Limits = DEFAULT) -> Asset:
    """Read the model at `path`, with all files that belong to it.

    What was repaired, left out or missing is in `Asset.warnings`. Raises AssetError for what cannot be read,
    InvalidMesh for a model without any area, LimitError beyond `limits`.
    """
    path = Path(path)
    try:
        return _load(path, limits)
    except LodpipeError as error:
        raise error.at(path.name) from error
    except RecursionError as error:
        raise AssetError("it is nested too deeply", place=path.name) from error
    except MemoryError as error:
        raise LimitError("it does not fit in memory", place=path.name, advice="split the model") from error


def _load(path: Path, limits: Limits) -> Asset:
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise AssetError(f"'{path.suffix}' is not a model format", advice=f"one of {', '.join(FORMATS)} is")
    folder = Folder(path, limits)
    _check_magic(path, suffix)
    warnings: list[str] = []

    def warn(text: str) -> None:
        if text not in warnings:
            warnings.append(text)

    module, _, function = FORMATS[suffix].partition(":")
    read: Reader = getattr(importlib.import_module(f"lodpipe.io.{module}"), function)
    asset = read(folder, warn)
    for image in asset.images:
        if image.problem:
            warn(f"{image.problem}; the material is shown without it")
    if asset.triangles == 0:
        reasons = f" ({'; '.join(warnings)})" if warnings else ""
        raise AssetError(f"no triangles{reasons}", advice="only surfaces made of faces can be simplified")
    limits.check_triangles(asset.triangles)
    if not any(has_area(mesh.positions, mesh.faces) for mesh in asset.meshes if len(mesh.faces)):
        raise InvalidMesh("no area: each triangle has corners at one point or on one line")
    return dataclasses.replace(
        asset,
        lods=(Lod(asset.meshes),),
        path=path,
        members=tuple(folder.members),
        missing=tuple(dict.fromkeys(folder.missing)),
        format=asset.format or suffix[1:],
        warnings=tuple(warnings),
    )


def _check_magic(path: Path, suffix: str) -> None:
    try:
        if not path.is_file():  # opening a pipe would wait for somebody to write
            return
        with path.open("rb") as file:
            start = file.read(4)
    except OSError:
        return  # `Folder` tells what is wrong with it
    for magic, suffixes in _MAGIC.items():
        if start == magic and suffix not in suffixes:
            raise AssetError(f"it is a {suffixes[0][1:].upper()} file", advice=f"rename it to {suffixes[0]}")
