"""An output folder: results are built aside and renamed into place, so that nobody ever sees half of one."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

from lodpipe.core.errors import OutputError
from lodpipe.service import manifest
from lodpipe.service.discover import STATE

FAILED = ".failed"
"""The folder in an output folder that holds what could not be processed."""

_AT_FDCWD, _RENAME_EXCHANGE = -100, 2


class Output:
    """An output folder and the rules by which results get into it. The folder is made if it is not there."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.state = root / STATE
        try:
            self.state.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise _unwritable(root, error) from error

    def sweep(self) -> None:
        """Remove what runs that crashed have left behind, and put back a revision that one was replacing."""
        # only these: to open and close the job table's own files here would release the locks that SQLite holds on them
        for path in sorted([*self.state.glob("tmp-*"), *self.state.glob("old-*")]):
            with _lock(path) as owned:
                if owned is not True:
                    continue
                place = path / "place.txt"
                if path.name.startswith("old-") and place.is_file():
                    target = self.root / place.read_text(encoding="utf-8")
                    if not target.exists() and (path / "revision").is_dir():
                        (path / "revision").rename(target)
                shutil.rmtree(path, ignore_errors=True)

    @contextlib.contextmanager
    def workspace(self) -> Iterator[Path]:
        """A new folder on the same file system, locked while it is in use and gone afterwards."""
        while True:
            try:
                path = Path(tempfile.mkdtemp(prefix="tmp-", dir=self.state))
            except OSError as error:
                raise _unwritable(self.root, error) from error
            with _lock(path) as owned:
                if owned is False or not path.is_dir():
                    continue  # another process has swept it away before it was locked
                try:
                    yield path
                finally:
                    shutil.rmtree(path, ignore_errors=True)
                return

    def check_place(self, place: PurePosixPath) -> None:
        """Raise OutputError if publishing at `place` would remove files that lodpipe did not write."""
        target = self.root / place
        if not target.exists():
            return
        foreign = manifest.foreign_files(target) if target.is_dir() else [""]
        if foreign:
            raise OutputError(
                f"holds what lodpipe did not write ({foreign[0] or 'a file of that name'}"
                f"{f' and {len(foreign) - 1} more' if len(foreign) > 1 else ''})",
                place=str(target),
                advice="move it away, or choose another output folder",
            )

    def publish(self, built: Path, place: PurePosixPath) -> Path:
        """Rename the folder `built` to `place`. What was there until now is removed; a failure's record too."""
        target = self.root / place
        self.check_place(place)
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            for path in (*sorted(built.rglob("*")), built):
                _sync(path)  # a name must not reach the disk before its content does
            self._put(built, target, place)
            _sync(target.parent)
        except OSError as error:
            raise _unwritable(target, error) from error
        self.forget_failure(place)
        return target

    def fail(self, place: PurePosixPath, record: dict[str, Any], files: list[Path], source: Path) -> Path:
        """Publish a failure: ``error.json``, copies of `files`, and a link to the input where links are possible."""
        target = self.root / FAILED / place
        with self.workspace() as folder:
            built = folder / "failed"
            built.mkdir()
            (built / "error.json").write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
            for file in files:
                if file.is_file():
                    shutil.copyfile(file, built / file.name)
            with contextlib.suppress(OSError):  # a file system without links: error.json names the input anyway
                (built / source.name).symlink_to(source.resolve())
            try:
                target.parent.mkdir(parents=True, exist_ok=True)
                self._put(built, target, PurePosixPath(FAILED) / place)
            except OSError as error:
                raise _unwritable(target, error) from error
        return target

    def forget_failure(self, place: PurePosixPath) -> None:
        """Remove the record of an earlier failure of the asset, and the folders that are empty then."""
        target = self.root / FAILED / place
        shutil.rmtree(target, ignore_errors=True)
        for parent in target.parents:
            if parent == self.root:
                break
            with contextlib.suppress(OSError):  # not there, or not empty: then it stays
                parent.rmdir()

    def _put(self, built: Path, target: Path, place: PurePosixPath) -> None:
        if not target.exists():
            built.rename(target)
        elif _exchange(built, target):
            pass  # the old revision stands where the new one was built, and goes with the workspace
        else:
            aside = Path(tempfile.mkdtemp(prefix="old-", dir=self.state))
            with _lock(aside):
                (aside / "place.txt").write_text(str(place), encoding="utf-8")
                target.rename(aside / "revision")
                built.rename(target)
                shutil.rmtree(aside, ignore_errors=True)


def _sync(path: Path) -> None:
    """Have the disk hold a file's content, or a folder's names, before anything else is done."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # file systems that cannot
            raise
    finally:
        os.close(handle)


def _exchange(a: Path, b: Path) -> bool:
    """Swap two folders in one step; False where the system or the file system cannot."""
    if not sys.platform.startswith("linux"):
        return False
    function = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if function is None:
        return False
    return bool(function(_AT_FDCWD, os.fsencode(a), _AT_FDCWD, os.fsencode(b), _RENAME_EXCHANGE) == 0)


@contextlib.contextmanager
def _lock(folder: Path) -> Iterator[bool | None]:
    """Hold the lock of a folder, which the system releases when its owner dies.

    Yields whether it was free, None where the file system has no locks.
    """
    try:
        handle = os.open(folder, os.O_RDONLY)
    except FileNotFoundError:
        yield False
        return
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        except OSError:
            yield None
        else:
            yield True
    finally:
        os.close(handle)


def _unwritable(path: Path, error: OSError) -> OutputError:
    return OutputError(
        f"cannot be written ({error.strerror or error})", place=str(path), advice="see to space and rights"
    )
