"""`manifest.json`: what a published folder was made from and what it holds; written last."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from lodpipe.core.asset import Asset
from lodpipe.service.recipe import Recipe

NAME = "manifest.json"
VERSION = 2
"""Of manifest and output layout; part of the fingerprint."""


def write(folder: Path, asset: Asset, recipe: Recipe, place: str, outcome: str, versions: dict[str, str]) -> None:
    """Describe the folder as it stands; `asset` is the one that was read, with its members."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file() and path != folder / NAME]
    inputs = inputs_of(asset)
    data = {
        "manifest_version": VERSION,
        "asset": asset.name,
        "output": place,
        "outcome": outcome,
        "fingerprint": fingerprint(inputs, recipe),
        "inputs": inputs,
        "missing": sorted(asset.missing),
        "config": recipe.config,
        "stages": list(recipe.stages),
        "versions": versions,
        "files": [_entry(path, folder) for path in files],
    }
    (folder / NAME).write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")


def inputs_of(asset: Asset) -> list[dict[str, Any]]:
    """Path (relative to the asset's folder), size and sha256 of every file that was read, the asset's own first."""
    home = asset.members[0].parent if asset.members else Path()
    return [_entry(path, home) for path in asset.members]


def fingerprint(inputs: Iterable[dict[str, Any]], recipe: Recipe) -> str:
    """Hex digest of everything that the result depends on: inputs, configuration, stages and their versions."""
    content = {
        "version": VERSION,
        "inputs": sorted((entry["path"], entry["size"], entry["sha256"]) for entry in inputs),
        **recipe.influence,
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def current(folder: Path, source: Path, recipe: Recipe) -> dict[str, Any] | None:
    """The manifest in `folder` if a run over `source` would publish the same again, else None.

    The inputs have the same content, nothing that was missing has turned up, the configuration and the stages are
    the same, and every published file is as it was written.
    """
    data = whole(folder)
    if data is None:
        return None
    try:
        inputs = list(data["inputs"])
        if not inputs or source.name != inputs[0]["path"]:
            return None
        if any((source.parent / name).exists() for name in data["missing"]):
            return None
        if [_entry(source.parent / entry["path"], source.parent) for entry in inputs] != inputs:
            return None
        if data["fingerprint"] != fingerprint(inputs, recipe):
            return None
    except (KeyError, TypeError, ValueError, OSError):  # damaged by hand, or a file is gone: not the same
        return None
    return data


def whole(folder: Path) -> dict[str, Any] | None:
    """The manifest in `folder` if every published file is as it was written, else None."""
    data = read(folder)
    if data is None or data.get("manifest_version") != VERSION:
        return None
    try:
        files = list(data["files"])
        return data if [_entry(folder / entry["path"], folder) for entry in files] == files else None
    except (KeyError, TypeError, ValueError, OSError):
        return None


def read(folder: Path) -> dict[str, Any] | None:
    """The manifest in a folder; None where there is none that can be read."""
    try:
        data = json.loads((folder / NAME).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return data if isinstance(data, dict) else None


def foreign_files(folder: Path) -> list[str]:
    """Files in `folder` that its manifest does not list: somebody else's. An empty folder is nobody's."""
    data = read(folder) or {}
    listed = {entry.get("path") for entry in data.get("files", ()) if isinstance(entry, dict)} | (
        {NAME} if data else set()
    )
    names = (path.relative_to(folder).as_posix() for path in sorted(folder.rglob("*")) if not path.is_dir())
    return [name for name in names if name not in listed]


def _entry(path: Path, root: Path) -> dict[str, Any]:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        size = file.tell()
    return {"path": _relative(path, root), "size": size, "sha256": digest}


def _relative(path: Path, root: Path) -> str:
    for base in (root, root.resolve()):
        if path.is_relative_to(base):
            return path.relative_to(base).as_posix()
    return path.as_posix()
