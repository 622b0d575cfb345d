"""The page over all assets of an output folder, kept up to date while results come in."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from lodpipe.reporting.index_page import MARK, NAME, Entry, entry_of, index_html
from lodpipe.service import manifest
from lodpipe.service.discover import STATE
from lodpipe.service.job import REPORT
from lodpipe.service.publish import FAILED

CACHE = "index.json"
"""Rows of reports that have been read, in the state folder: a report is read again only when it has changed."""
PAUSE = 5.0
"""Shortest time between two updates that nobody waits for; and never more than a twentieth of the time goes into it."""


class Index:
    """`index.html` in the output folder `root`."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._next = 0.0
        self._stale = False

    def changed(self) -> None:
        """Something has been published: update, unless that was done just now."""
        self._stale = True
        if time.monotonic() >= self._next:
            self.update()

    def settle(self) -> None:
        """Nothing more comes for the moment: make up for what was left out."""
        if self._stale:
            self.update()

    def update(self) -> None:
        """Write the page anew from what lies in the folder.

        A page that is not ours stays as it is, and a folder that cannot be written only lacks the page: neither may
        fail a run whose results are there.
        """
        self._stale = False
        begin = time.monotonic()
        with contextlib.suppress(OSError), _locked(self.root / STATE):
            if is_ours(self.root / NAME):
                text = index_html(self._entries(), self.root.resolve().name)
                _replace(self.root / NAME, text, self.root / STATE)
        now = time.monotonic()
        self._next = now + max(PAUSE, 20 * (now - begin))

    def _entries(self) -> list[Entry]:
        known = _read(self.root / STATE / CACHE)
        seen: dict[str, Any] = {}
        entries = []
        for folder in asset_folders(self.root):
            try:
                stamp = (folder / REPORT).stat()
            except OSError:
                continue
            inside = folder.relative_to(self.root).as_posix()
            key = [stamp.st_mtime_ns, stamp.st_size, stamp.st_ino]
            row = known.get(inside)
            if row is None or row.get("key") != key:
                report = _read(folder / REPORT)
                place = inside.removeprefix(f"{FAILED}/")
                row = {"key": key, "entry": asdict(entry_of(place, inside, report, _names(folder)))}
            seen[inside] = row
            entries.append(Entry(**row["entry"]))
        if seen != known:
            _replace(self.root / STATE / CACHE, json.dumps(seen), self.root / STATE)
        return entries


def asset_folders(root: Path) -> Iterator[Path]:
    """The folders of published results and of failures below `root`."""
    for top, mark in ((root, manifest.NAME), (root / FAILED, "error.json")):
        for folder, folders, files in os.walk(top):
            if mark in files:
                folders.clear()
                yield Path(folder)
            else:
                folders[:] = sorted(name for name in folders if not name.startswith("."))


def is_ours(path: Path) -> bool:
    """Whether the index page may be written: there is none, or one of ours."""
    if not path.exists():
        return not path.is_symlink()
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return MARK.encode() in file.read(1000)


def _names(folder: Path) -> list[str]:
    data = manifest.read(folder) or {}
    listed = [entry["path"] for entry in data.get("files", ())]
    return listed or [path.name for path in folder.iterdir()]


def _read(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return data if isinstance(data, dict) else {}


def _replace(path: Path, text: str, state: Path) -> None:
    """Write a file so that nobody sees half of it."""
    part = state / f"{path.name}.{os.getpid()}.part"
    part.write_text(text, encoding="utf-8", errors="backslashreplace")
    part.replace(path)


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """One process at a time: the last to look is the last to write."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)
