"""File events of the system. They only wake the scanner, which looks for itself; without them it looks more often."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from watchdog.observers.api import BaseObserver

SILENT = (
    "nfs",
    "nfs4",
    "cifs",
    "smb3",
    "smbfs",
    "9p",
    "afs",
    "ceph",
    "glusterfs",
    "lustre",
    "vboxsf",
    "prl_fs",
    "virtiofs",
)
"""File systems on which changes made elsewhere give no events here; all of FUSE (`fuse.sshfs` …) as well."""


class Dirty(Protocol):
    """Told of changes, from a thread of the watcher."""

    def __call__(self, folder: str | None, name: str = "", closed: bool = False) -> None:
        """Something changed in a folder, relative to the watched one; None: look everywhere.

        Of the file `name` in it, whether its writer has `closed` it.
        """


def file_system(path: Path, mounts: str | None = None) -> str:
    """The type of the file system that `path` is on, from `/proc/self/mountinfo` (or its text); '' where unknown."""
    if mounts is None:
        try:
            mounts = Path("/proc/self/mountinfo").read_text(encoding="utf-8", errors="surrogateescape")
        except OSError:
            return ""
    best, kind = "", ""
    real = os.fspath(path.resolve())
    for line in mounts.splitlines():
        before, _, after = line.partition(" - ")
        fields = before.split()
        if len(fields) < 5 or not after:
            continue
        point = fields[4].encode("latin-1", "backslashreplace").decode("unicode_escape", "replace")
        inside = real == point or real.startswith(point.rstrip("/") + "/")
        if inside and len(point) >= len(best):
            best, kind = point, after.split()[0]
    return kind


def is_silent(kind: str) -> bool:
    """Whether a file system of that type gives no events for what others do."""
    return kind in SILENT or kind == "fuse" or kind.startswith("fuse.")


class Watcher:
    """One observer of the watched folder, made again only when it has died or the folder is another one."""

    def __init__(self, root: Path, dirty: Dirty, log: logging.Logger, mode: str = "auto") -> None:
        self._root, self._dirty, self._log = root, dirty, log
        self._observer: BaseObserver | None = None
        self._inode = -1
        kind = file_system(root)
        self.wanted = mode == "on" or (mode == "auto" and not is_silent(kind))
        if not self.wanted:
            why = f"{kind} gives none" if mode == "auto" else "watch.events is off"
            log.info("no file events (%s): the folder is listed instead", why)
        self._warnings = _Warnings(dirty, log)
        logging.getLogger("watchdog").addHandler(self._warnings)

    @property
    def works(self) -> bool:
        """Whether events come: the observer and each of its threads live, and the folder is the one it looks at."""
        if self._observer is None or not self._observer.is_alive():
            return False
        emitters = list(self._observer.emitters)
        return bool(emitters) and all(emitter.is_alive() for emitter in emitters) and self._inode == _inode(self._root)

    def check(self) -> bool:
        """See to it that events come, where they are wanted; whether they do."""
        if not self.wanted:
            return False
        if self.works:
            return True
        if self._observer is not None:
            self._log.warning("the watcher of file events has ended; making another")
        self.stop()
        try:
            self._start()
        except OSError as error:  # the limit of inotify watches, the folder gone
            self._observer = None
            self._log.debug("no file events (%s): the folder is listed instead", error)
            return False
        self._dirty(None)  # what happened meanwhile
        return True

    def _start(self) -> None:
        from watchdog import events
        from watchdog.observers import Observer

        root, dirty = os.fspath(self._root), self._dirty

        class Handler(events.FileSystemEventHandler):
            def on_any_event(self, event: events.FileSystemEvent) -> None:
                closed = isinstance(event, events.FileClosedEvent)
                for path, whole in ((event.src_path, closed), (event.dest_path, True)):
                    if not path:
                        continue
                    folder, name = os.path.split(os.fsdecode(path))
                    inside = os.path.relpath(folder, root)
                    if inside != ".." and not inside.startswith("../"):
                        dirty("" if inside == "." else inside, "" if event.is_directory else name, whole)

        kinds: list[type[events.FileSystemEvent]] = [
            events.FileCreatedEvent,
            events.FileModifiedEvent,
            events.FileClosedEvent,
            events.FileMovedEvent,
            events.FileDeletedEvent,
            events.DirCreatedEvent,
            events.DirMovedEvent,
            events.DirDeletedEvent,
        ]
        self._inode = _inode(self._root)
        observer = Observer()
        observer.schedule(Handler(), root, recursive=True, event_filter=kinds)
        observer.start()
        self._observer = observer

    def stop(self) -> None:
        """End it."""
        if self._observer is not None:
            self._observer.stop()
            self._observer.join(timeout=5)
            self._observer = None

    def close(self) -> None:
        """End it for good."""
        self.stop()
        logging.getLogger("watchdog").removeHandler(self._warnings)


class _Warnings(logging.Handler):
    """Whatever watchdog warns of (lost events above all), the answer is to look everywhere."""

    def __init__(self, dirty: Dirty, log: logging.Logger) -> None:
        super().__init__(logging.WARNING)
        self._dirty, self._log = dirty, log

    def emit(self, record: logging.LogRecord) -> None:
        self._log.warning("%s; the whole folder is listed", record.getMessage())
        self._dirty(None)


def _inode(path: Path) -> int:
    try:
        return path.stat().st_ino
    except OSError:
        return 0
