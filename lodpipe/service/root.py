"""Whether the watched folder is really there: an unmounted share must not look like a folder that was emptied."""

from __future__ import annotations

import contextlib
import os
import stat
import uuid
from pathlib import Path

from lodpipe.service.table import JobTable

MARKER = ".lodpipe-root"
"""A hidden file that the daemon leaves in the watched folder, where it may, to know it again."""


class RootGuard:
    """Knows the watched folder by its marker, or by its device and inode where no marker can be left."""

    def __init__(self, root: Path, table: JobTable) -> None:
        self.root = root
        self.table = table

    def problem(self) -> str:
        """Why the folder cannot be the one that was watched before; empty if it is."""
        try:
            status = os.stat(self.root)  # noqa: PTH116 follows the same rules as the listing
        except OSError as error:
            return f"the watched folder cannot be reached ({error.strerror}); waiting for it to come back"
        device = [status.st_dev, status.st_ino]
        known = self.table.fact("root_id")
        if known is None:
            self._settle(device)
            return ""
        marker = self._marker()
        if marker == known or device == self.table.fact("root_device"):
            if device != self.table.fact("root_device") or (not marker and self.table.fact("root_marked")):
                self._settle(device, known)
            return ""
        if not self.table.fact("root_marked") and not self._empty():
            self._settle(device, known)
            return ""
        return (
            "the watched folder is another one than before (is its share mounted?); waiting for it to come back;"
            " `lodpipe resume` takes it as it is"
        )

    def accept(self) -> None:
        """Take the folder as it is now."""
        self.table.set_facts(root_id=None)

    def _settle(self, device: list[int], known: str | None = None) -> None:
        there = self._marker()
        name = known or there or uuid.uuid4().hex  # another daemon may watch the same folder, for another output
        marked = there == name
        if not marked:
            with contextlib.suppress(OSError):  # a folder that may only be read
                with os.fdopen(self._open(os.O_WRONLY | os.O_CREAT | os.O_TRUNC), "w", encoding="ascii") as file:
                    file.write(name + "\n")
                marked = True
        self.table.set_facts(root_id=name, root_device=device, root_marked=marked)

    def _marker(self) -> str:
        try:
            with os.fdopen(self._open(os.O_RDONLY), encoding="ascii") as file:
                return file.read(100).strip()
        except (OSError, ValueError):
            return ""

    def _open(self, how: int) -> int:
        """The marker's descriptor. Whoever may drop files may have put a link or a pipe of that name there."""
        handle = os.open(self.root / MARKER, how | os.O_NOFOLLOW | os.O_NONBLOCK, 0o644)
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            os.close(handle)
            raise OSError("it is not a regular file")
        return handle

    def _empty(self) -> bool:
        try:
            with os.scandir(self.root) as entries:
                return next(entries, None) is None
        except OSError:
            return True
