"""One daemon for each state folder: a lock that the system releases when its owner dies."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from lodpipe.core.errors import OutputError

LOCK = "daemon.lock"


def take_lock(state: Path) -> int:
    """The lock of a state folder, as an open file that holds it. Raises OutputError if another daemon has it."""
    path = state / LOCK
    handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        other = os.read(handle, 32).decode("ascii", "replace").strip()
        os.close(handle)
        raise OutputError(
            f"another daemon works on it (process {other or 'unknown'})",
            place=str(state),
            advice="one daemon for each output folder",
        ) from error
    os.ftruncate(handle, 0)
    os.write(handle, f"{os.getpid()}\n".encode("ascii"))
    return handle


def is_running(state: Path) -> bool:
    """Whether a daemon holds the lock of a state folder."""
    try:
        handle = os.open(state / LOCK, os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # a file system without locks
        return False
    finally:
        os.close(handle)
    return False
