"""Results of stages, kept from run to run: a change late in the chain does not redo what comes before it.

A result is named by a hash of all that it depends on: the content of the inputs, the code of lodpipe, and of every
stage up to it the version, the parameters and those values of the configuration that it has looked at (levels, seed).
So nothing in here can be out of date; what is not used any more is the first to go when there is no more room.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import os
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any, BinaryIO

import lodpipe
from lodpipe.core.asset import Asset
from lodpipe.core.page import Page
from lodpipe.pipeline import Kept
from lodpipe.service import store

FOLDER = "cache"


class StageResults:
    """The results in a folder, as one run over one asset sees them; implements `lodpipe.pipeline.Results`."""

    def __init__(
        self,
        folder: Path,
        limit: int,
        min_seconds: float,
        origin: Any,
        stages: Iterable[Any],
        *,
        fresh: bool = False,
    ) -> None:
        """`origin` is plain data that names the input's content; `stages` has for each step its name and version.

        With `fresh`, results are kept but none is used.
        """
        self._fresh = fresh
        self._folder, self._limit, self._min_seconds = folder, limit, min_seconds
        self._stages = list(stages)
        self._key = _hash([_code(), origin])
        self._pending: list[tuple[str, Any]] = []
        self._cost = 0.0
        self._broken = False

    def find(self, chain: list[dict[str, Any]], values: dict[str, Any]) -> Kept | None:
        """The latest stage of `chain` (each with its params) whose result is there, and all that came before it."""
        key, parts, best = self._key, [], None
        if self._fresh:
            return None
        for index, params in enumerate(chain):
            step = self._step(key, index, params)
            used = self._read(f"{step}.used")
            if used is None:
                break
            key = _hash([step, {name: values[name] for name in used}])
            part = self._read(f"{key}.part")
            if part is None:
                break
            parts.append(part)
            if (self._folder / f"{key}.asset").is_file():
                best = (index, key)
        if best is None:
            return None
        index, key = best
        try:
            path = self._folder / f"{key}.asset"
            asset, page = store.read(path.read_bytes())
            os.utime(path)  # used last
        except (OSError, ValueError):
            with contextlib.suppress(OSError):
                path.unlink()
            return None
        self._key = key
        return Kept(index, asset, page, parts[: index + 1])

    def keep(
        self,
        index: int,
        params: dict[str, Any],
        asset: Asset,
        page: Page | None,
        part: dict[str, Any],
        used: dict[str, Any],
    ) -> None:
        """A stage has run. `used` has the values of the configuration that it has looked at."""
        if self._broken:
            return
        step = self._step(self._key, index, params)
        self._key = _hash([step, used])
        self._pending += [(f"{step}.used", sorted(used)), (f"{self._key}.part", part)]
        self._cost += part["seconds"]
        if self._cost < self._min_seconds:
            return
        try:
            self._folder.mkdir(exist_ok=True)
            self._write(f"{self._key}.asset", lambda file: store.write(file, (asset, page)))
            for name, data in self._pending:
                text = json.dumps(data).encode("ascii")
                self._write(name, lambda file, text=text: file.write(text))
            self._make_room()
        except store.CannotStore:
            return
        except OSError:  # no room: the run does not need it
            self._broken = True
            return
        self._pending.clear()
        self._cost = 0.0

    def stop(self) -> None:
        """A stage has written files: neither it nor what follows is kept."""
        self._broken = True

    def _step(self, key: str, index: int, params: dict[str, Any]) -> str:
        return _hash([key, self._stages[index], params])

    def _read(self, name: str) -> Any:
        try:
            return json.loads((self._folder / name).read_bytes())
        except (OSError, ValueError):
            return None

    def _write(self, name: str, put: Any) -> None:
        handle, aside = tempfile.mkstemp(prefix=".", dir=self._folder)
        try:
            file: BinaryIO
            with os.fdopen(handle, "wb") as file:
                put(file)
            Path(aside).rename(self._folder / name)
        except BaseException:
            with contextlib.suppress(OSError):
                Path(aside).unlink()
            raise

    def _make_room(self) -> None:
        files = []
        for entry in os.scandir(self._folder):
            with contextlib.suppress(OSError):
                status = entry.stat()
                files.append((status.st_mtime_ns, status.st_size, entry.path))
        total = sum(size for _, size, _ in files)
        for _, size, path in sorted(files):
            if total <= self._limit:
                break
            with contextlib.suppress(OSError):
                Path(path).unlink()
                total -= size


def _hash(data: Any) -> str:
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode("ascii")).hexdigest()[:40]


@functools.cache
def _code() -> str:
    """Digest of lodpipe's own files, by name, size and time: results of other code are not taken."""
    home = Path(lodpipe.__file__).parent
    found = []
    for path in sorted(home.rglob("*")):
        if path.suffix in (".py", ".so", ".pyd"):
            status = path.stat()
            found.append([path.relative_to(home).as_posix(), status.st_size, status.st_mtime_ns])
    native = getattr(sys.modules.get("lodpipe.kernel._native"), "__file__", None)  # elsewhere in a working tree
    if native:
        status = Path(native).stat()
        found.append(["native", status.st_size, status.st_mtime_ns])
    return _hash(found)
