"""The watched folder as it stands: one listing is the truth about all of it, whatever events have said."""

from __future__ import annotations

import errno
import fnmatch
import os
import re
from collections.abc import Container, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from lodpipe.service.discover import STATE
from lodpipe.service.settle import Seen, Signature, note

JUNK = (".*", "*.part", "*.partial", "*.tmp", "*.temp", "*.crdownload", "~$*", "*~", "Thumbs.db", "desktop.ini")
"""Names of files and folders that are nobody's models: hidden, temporary, left by programs."""

_GONE = {errno.ENOENT, errno.ENOTDIR}


class RootGone(Exception):
    """The watched folder cannot be listed."""


@dataclass
class Tree:
    """Every file below `root` that may belong to an asset, by its folder and name, both relative to `root`."""

    root: Path
    """A real path, without links in it."""
    excluded: tuple[Path, ...] = ()
    """Folders that are never looked into, as real paths."""
    ignore: tuple[str, ...] = ()
    """Globs, matched with names and with paths relative to `root`."""
    folders: dict[str, dict[str, Seen]] = field(default_factory=dict)
    problems: dict[str, str] = field(default_factory=dict)
    """Folders that are not looked into, and why: links to folders, and those that could not be listed. What was known
    of the latter stays known."""

    def scan(self, now: float, dirty: Iterable[str] | None = None) -> bool:
        """List all, or the `dirty` folders and what is new below them; whether anything has changed.

        Raises RootGone if the watched folder itself cannot be listed.
        """
        before = self.folders
        self.folders = {} if dirty is None else dict(before)
        old_problems = self.problems
        self.problems = {} if dirty is None else dict(old_problems)
        try:
            for folder in [""] if dirty is None else sorted({_known(folder, before) for folder in dirty}):
                self._list(folder, before, now, deep=dirty is None, again=old_problems)
        except RootGone:
            self.folders, self.problems = before, old_problems
            raise
        return self.folders != before or self.problems != old_problems

    def get(self, path: str) -> Seen | None:
        """The file at a path relative to the root."""
        folder, _, name = path.rpartition("/")
        return self.folders.get(folder, {}).get(name)

    def mark(self, path: str, closed: bool) -> bool:
        """Note whether a file's writer is through with it as it was listed last; whether that is news."""
        folder, _, name = path.rpartition("/")
        seen = self.folders.get(folder, {}).get(name)
        if seen is None or seen.closed == closed:
            return False
        self.folders[folder][name] = seen._replace(closed=closed)
        return True

    def __iter__(self) -> Iterator[str]:
        """The paths of all files, in order."""
        for folder in sorted(self.folders):
            yield from (f"{folder}/{name}" if folder else name for name in sorted(self.folders[folder]))

    def __post_init__(self) -> None:
        patterns = [fnmatch.translate(pattern) for pattern in (*JUNK, *self.ignore)]
        self._ignored = re.compile("|".join(patterns)).match

    def _list(
        self, folder: str, before: dict[str, dict[str, Seen]], now: float, *, deep: bool, again: Container[str]
    ) -> None:
        """List a folder, and the folders in it that are new or are to be tried `again`; all of them if `deep`."""
        todo = [folder]
        while todo:
            here = todo.pop()
            known = before.get(here, {})
            for path in [path for path in self.problems if path == here or _parent(path) == here]:
                del self.problems[path]
            try:
                files, below = self._entries(here, known, now)
            except OSError as error:
                if not here:
                    raise RootGone(f"{error.strerror or error}") from error
                if error.errno in _GONE:
                    self._drop(here)
                else:
                    self.problems[here] = error.strerror or str(error)
                    self._keep(here, before)
                continue
            self.folders[here] = files
            for gone in {f for f in self.folders if _parent(f) == here and f} - set(below):
                self._drop(gone)
            todo += [path for path in below if deep or path not in before or path in again]

    def _entries(self, here: str, known: dict[str, Seen], now: float) -> tuple[dict[str, Seen], list[str]]:
        files: dict[str, Seen] = {}
        below: list[str] = []
        with os.scandir(self.root / here if here else self.root) as entries:
            for entry in entries:
                path = f"{here}/{entry.name}" if here else entry.name
                if self._ignored(entry.name) or self._ignored(path):
                    continue
                try:
                    if entry.is_dir(follow_symlinks=False):
                        if not self._excluded(Path(entry.path)):
                            below.append(path)
                    elif entry.is_file():  # a link counts as what it leads to, as long as that is a file
                        status = entry.stat()
                        signature = Signature(status.st_size, status.st_mtime_ns, status.st_ino)
                        files[entry.name] = note(known.get(entry.name), signature, now)
                    elif entry.is_dir():
                        self.problems[path] = "it is a link to a folder, and links to folders are not followed"
                except OSError:
                    if entry.name in known:
                        files[entry.name] = known[entry.name]
        return files, below

    def _excluded(self, path: Path) -> bool:
        return path in self.excluded or (path / STATE).is_dir()

    def _drop(self, folder: str) -> None:
        for path in [path for path in self.folders if path == folder or path.startswith(folder + "/")]:
            del self.folders[path]

    def _keep(self, folder: str, before: dict[str, dict[str, Seen]]) -> None:
        for path, files in before.items():
            if path == folder or path.startswith(folder + "/"):
                self.folders[path] = files


def _known(folder: str, folders: dict[str, dict[str, Seen]]) -> str:
    """The folder, or the nearest one above it that has been listed: what is left out is not looked into."""
    while folder and folder not in folders:
        folder = _parent(folder)
    return folder


def _parent(folder: str) -> str:
    return folder.rpartition("/")[0]
