"""One daemon for each state folder and each output folder: locks that the system releases when their owner dies."""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
import time
from pathlib import Path

from lodpipe.core.errors import OutputError

LOCK = "daemon.lock"
_LOOKS, _LOOK_SECONDS = 5, 0.05
"""`is_running` holds the lock for a moment: so often it is tried again before it counts as another daemon's."""


class NoLocks(OutputError):
    """The file system has none."""


def take_lock(folder: Path) -> int:
    """The lock in `folder`, as an open file that holds it.

    Raises OutputError if another daemon has it, NoLocks if the file system cannot lock.
    """
    path = folder / LOCK
    try:
        handle = os.open(path, os.O_RDONLY | os.O_CREAT, 0o644)  # nothing is kept open for writing for months
    except OSError as error:
        raise OutputError(f"cannot be written ({error.strerror})", place=str(path), advice="see to rights") from error
    try:
        for look in range(_LOOKS):
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError as error:
                if look == _LOOKS - 1:
                    raise OutputError(
                        f"another daemon works on it ({_owner(handle)})",
                        place=str(folder),
                        advice="one daemon for each output folder and each state folder",
                    ) from error
                time.sleep(_LOOK_SECONDS)
            except OSError as error:
                raise NoLocks(
                    f"cannot be locked ({error.strerror})", place=str(path), advice="see --state: it wants a local disk"
                ) from error
        with contextlib.suppress(OSError):  # a full disk: only the message for the next one is the poorer for it
            path.write_text(f"{os.getpid()} {socket.gethostname()}\n", encoding="ascii", errors="replace")
    except BaseException:
        os.close(handle)
        raise
    return handle


def _owner(handle: int) -> str:
    number, _, host = os.read(handle, 300).decode("ascii", "replace").strip().partition(" ")
    return f"process {number or 'unknown'}{f' on {host}' if host not in ('', socket.gethostname()) else ''}"


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
