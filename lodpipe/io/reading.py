"""One way in: `load` reads an asset of any format."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

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
#: How files begin that are no models, or models in a wrapping; what they are, and what helps.
_OTHERS = {
    b"\x1f\x8b": ("compressed with gzip", "unpack it first"),
    b"PK\x03\x04": ("a ZIP archive", "unpack it first"),
    b"version https://git-lfs": ("a Git LFS pointer, not the file itself", "fetch it with git lfs pull"),
    b"<!doctype html": ("a web page", "download the model again"),
    b"<html": ("a web page", "download the model again"),
    b"Kaydara FBX": ("an FBX file", f"convert it to one of {', '.join(FORMATS)}"),
    b"BLENDER": ("a Blender file", "export it as .glb"),
    b"\x89PNG": ("a PNG image", "give the model that uses it"),
    b"\xff\xd8\xff": ("a JPEG image", "give the model that uses it"),
}
LARGEST = 1e60
"""Coordinates beyond this are refused: their squares and products would leave float64."""
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
        error.advice = error.advice or "check it in a 3-D program, or export it again"
        raise error.at(path.name) from error
    except RecursionError as error:
        advice = "the file is damaged: copy or export it again"
        raise AssetError("it is nested too deeply", place=path.name, advice=advice) from error
    except MemoryError as error:
        raise LimitError("it does not fit in memory", place=path.name, advice="split the model") from error


def _load(path: Path, limits: Limits) -> Asset:
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise AssetError(f"'{path.suffix}' is not a model format", advice=f"one of {', '.join(FORMATS)} is")
    folder = Folder(path, limits)
    _check_magic(path, suffix)
    warnings: dict[str, None] = {}

    def warn(text: str) -> None:
        warnings[text] = None

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
    largest = max(float(np.abs(mesh.positions).max(initial=0.0)) for mesh in asset.meshes)
    if largest > LARGEST:
        raise AssetError(
            f"it has coordinates of {largest:.0e}", advice=f"scale it down: up to {LARGEST:.0e} is possible"
        )
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
            start = file.read(32)
    except OSError:
        return  # `Folder` tells what is wrong with it
    for magic, suffixes in _MAGIC.items():
        if start[:4] == magic and suffix not in suffixes:
            raise AssetError(f"it is a {suffixes[0][1:].upper()} file", advice=f"rename it to {suffixes[0]}")
    for magic, (what, advice) in _OTHERS.items():
        if start.lower().startswith(magic.lower()):
            raise AssetError(f"it is {what}", advice=advice)
