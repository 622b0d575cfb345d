"""What becomes of files when their work is done: inputs after success, results whose input has gone."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import tempfile
from collections.abc import Collection
from pathlib import Path

from lodpipe.service import manifest
from lodpipe.service.publish import Output
from lodpipe.service.table import Row

DONE_FOLDER, ARCHIVE = ".done", ".archive"
"""Hidden folders in the output folder: inputs that `on_success: move` has moved, results that were archived."""


def after_success(root: Path, output: Output, row: Row, place: str, shared: Collection[str], how: str) -> str:
    """Move or delete the files of an asset whose result is at `place`; why they were left alone, or ''.

    The result is read again and compared with its manifest first; a file that has changed since it was taken stays,
    and so does one that another asset needs (`shared`).
    """
    if manifest.whole(output.root / place) is None:
        return f"the result in {place} is not as it was written"
    mine = [path for path in row.members if path not in shared]
    for path in mine:
        try:
            status = os.stat(root / path)  # noqa: PTH116 the same fields as in the listing
        except OSError as error:
            return f"{path}: {error.strerror}"
        if [status.st_size, status.st_mtime_ns, status.st_ino] != row.signature.get(path):
            return f"{path} has changed since"
    try:
        for path in mine:
            if how == "move":
                _move(root / path, output.root / DONE_FOLDER / path)
            else:
                (root / path).unlink()
    except OSError as error:
        return f"{error.filename}: {error.strerror}"
    return ""


def archive(output: Output, place: str) -> None:
    """Move the result at `place` out of the way."""
    target = output.root / ARCHIVE / place
    number = 1
    while target.exists():
        number += 1
        target = output.root / ARCHIVE / f"{place}-{number}"
    with contextlib.suppress(FileNotFoundError):
        target.parent.mkdir(parents=True, exist_ok=True)
        (output.root / place).rename(target)


def _move(source: Path, target: Path) -> None:
    """Move a file, also to another file system; it is gone from its place only when it is whole in the other."""
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        source.rename(target)
        return
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
    handle, name = tempfile.mkstemp(prefix=".", dir=target.parent)
    copy = Path(name)
    try:
        with os.fdopen(handle, "wb") as file, source.open("rb") as original:
            shutil.copyfileobj(original, file)
            file.flush()
            os.fsync(file.fileno())
        shutil.copystat(source, copy)
        if copy.stat().st_size != source.stat().st_size:
            raise OSError(errno.EIO, "the copy is not whole", str(source))
        copy.rename(target)
    except BaseException:
        copy.unlink(missing_ok=True)
        raise
    source.unlink()
