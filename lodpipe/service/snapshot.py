"""A job's own copy of an asset: only its members, only from inside its folder, and all of one moment."""

from __future__ import annotations

import hashlib
import json
import os
import stat
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from lodpipe.core.errors import AssetError, LimitError
from lodpipe.io.limits import Limits
from lodpipe.io.needs import Needs, contained, find_needs
from lodpipe.service.recipe import module_environment
from lodpipe.service.settle import Signature

_BLOCK = 1 << 20
_LARGE = 4 << 20
"""Bytes of JSON from which it is looked through in another process, so that this one stays small."""


class Changed(Exception):
    """A file changed, or went away, while it was copied."""


@dataclass(frozen=True)
class Snapshot:
    """The copy, and the entries (path, size, sha256) of its members."""

    path: Path
    """The copy of the asset's own file."""
    entries: tuple[dict[str, Any], ...]
    """The asset's own file first, by its format alone: its name says nothing about its content."""


def needs_of(path: Path, limits: Limits) -> Needs:
    """`find_needs`, whose memory for large files is that of another process."""
    suffix = path.suffix.lower()
    try:
        large = suffix in (".gltf", ".glb") and _json_bytes(path) > _LARGE
    except OSError:
        return Needs()
    if not large:
        return find_needs(path, limits)
    done = subprocess.run(
        [sys.executable, "-m", "lodpipe.service.snapshot", os.fspath(path), json.dumps(asdict(limits))],
        capture_output=True,
        check=False,
        env=module_environment(),
    )
    return Needs(**json.loads(done.stdout)) if done.returncode == 0 else Needs()


def take(root: Path, key: str, needs: Needs, expected: Mapping[str, Signature], into: Path, limits: Limits) -> Snapshot:
    """Copy the asset `key` of the watched folder `root` into the empty folder `into`.

    `expected` has the signature of each member by its path below `root`. Raises Changed if one of them is, was or
    becomes another; AssetError for a file that leads out of `root`; LimitError for too many bytes.
    """
    source = root / key
    home = PurePosixPath(key).parent
    folder = home.name or "input"
    places = {key: f"{folder}/{source.name}"}
    for name in needs.members:
        if place := contained(name, folder):
            places[member_path(key, name)] = place
    total = sum(signature.size for signature in expected.values())
    if total > limits.input_bytes:
        raise LimitError(
            f"its files have {total:,} bytes, more than the limit of {limits.input_bytes:,}",
            place=source.name,
            advice="split the model, or raise limits.input_bytes",
        )
    entries = []
    for path, place in places.items():
        target = into / place
        target.parent.mkdir(parents=True, exist_ok=True)
        digest = _copy(root, path, target, expected[path])
        said = place.removeprefix(f"{folder}/") if path != key else source.suffix.lower()
        entries.append({"path": said, "size": expected[path].size, "sha256": digest})
    for path in places:
        _check(path, os.stat(root / path), expected[path])  # noqa: PTH116 beside os.fstat
    return Snapshot(into / places[key], tuple(entries))


def member_path(key: str, name: str) -> str:
    """The path below the watched folder of what the asset `key` calls `name`."""
    return os.path.normpath(os.path.join(os.path.dirname(key), name))  # noqa: PTH118, PTH120 '..' must be resolved


def _copy(root: Path, path: str, target: Path, expected: Signature) -> str:
    """Copy one file; its SHA-256."""
    try:
        real = (root / path).resolve(strict=True)
        if not real.is_relative_to(root):
            raise AssetError(
                "it is a link that leads out of the watched folder", place=path, advice="copy the file itself"
            )
        handle = os.open(real, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except (FileNotFoundError, NotADirectoryError) as error:
        raise Changed(path) from error
    with os.fdopen(handle, "rb", buffering=0) as source, target.open("xb") as copy:
        _check_opened(handle, root, path)
        _check(path, os.fstat(handle), expected)
        digest = hashlib.sha256()
        while block := source.read(_BLOCK):
            digest.update(block)
            copy.write(block)
            if copy.tell() > expected.size:
                raise Changed(path)
        _check(path, os.fstat(handle), expected)
    return digest.hexdigest()


def _check_opened(handle: int, root: Path, path: str) -> None:
    """A folder on the way may have become a link since it was resolved: what counts is the file that was opened."""
    link = Path(f"/proc/self/fd/{handle}")
    if link.is_symlink() and not link.readlink().is_relative_to(root):
        raise Changed(path)


def _check(path: str, status: os.stat_result, expected: Signature) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise AssetError("it is not a regular file", place=path)
    if Signature(status.st_size, status.st_mtime_ns, status.st_ino) != expected:
        raise Changed(path)


def _json_bytes(path: Path) -> int:
    with path.open("rb") as file:
        head = file.read(16)
    return int.from_bytes(head[12:16], "little") if head[:4] == b"glTF" else path.stat().st_size


if __name__ == "__main__":
    print(json.dumps(asdict(find_needs(Path(sys.argv[1]), Limits(**json.loads(sys.argv[2]))))))
