"""Time as the daemon sees it, so that tests can be its master."""

from __future__ import annotations

import contextlib
import os
import random
import select
import time


class Clock:
    """The system's clocks."""

    def monotonic(self) -> float:
        """Seconds that never go back; for waiting."""
        return time.monotonic()

    def time(self) -> float:
        """Seconds since 1970; for what is written down."""
        return time.time()

    def jitter(self, seconds: float) -> float:
        """About `seconds`, so that many daemons do not look at one share at the same moment."""
        return seconds * random.uniform(0.9, 1.1)


class Waker:
    """Lets any thread, and any signal handler, end the daemon's wait (a pipe: writing to it needs no lock)."""

    def __init__(self) -> None:
        self._read, self._write = os.pipe()
        os.set_blocking(self._read, False)
        os.set_blocking(self._write, False)

    def wake(self) -> None:
        """End the wait that goes on, or the next one."""
        with contextlib.suppress(BlockingIOError, OSError):  # full: it is awake; closed: nobody waits
            os.write(self._write, b".")

    def wait(self, seconds: float) -> bool:
        """Wait until woken, at most so long; whether it was woken."""
        ready, _, _ = select.select([self._read], [], [], max(0.0, seconds))
        if ready:
            os.read(self._read, 1 << 16)
        return bool(ready)

    def close(self) -> None:
        """Let go of the pipe."""
        os.close(self._read)
        os.close(self._write)
