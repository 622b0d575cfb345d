"""When to look at the watched folder, and at how much of it."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from lodpipe.config.watch import Watch
from lodpipe.service.clock import Clock
from lodpipe.service.root import RootGuard
from lodpipe.service.scan import RootGone, Tree
from lodpipe.service.table import JobTable


class Lookout:
    """Collects what has been told of changes, and lists the folder when it is time."""

    def __init__(
        self, guard: RootGuard, table: JobTable, clock: Clock, wake: Callable[[], None], log: logging.Logger
    ) -> None:
        self.polling = False
        """Whether no events come, so that listing is all there is."""
        self.problem = ""
        """Why the folder cannot be looked at."""
        self._guard, self._table, self._clock, self._wake, self._log = guard, table, clock, wake, log
        self._lock = threading.Lock()
        self._dirty: set[str] = set()
        self._everything = True
        self._last = 0.0
        self._spread = 1.0

    def tell(self, folder: str | None) -> None:
        """Something has changed in a folder, relative to the watched one; None: nobody knows where. From any thread."""
        with self._lock:
            if folder is None:
                self._everything = True
            elif folder in self._dirty:
                return
            else:
                self._dirty.add(folder)
        self._wake()

    def accept(self) -> None:
        """Take the folder as it is now, though it is another one."""
        self._guard.accept()
        self.tell(None)

    def due(self, watch: Watch) -> float:
        """When all of it is to be listed next, as monotonic time."""
        return self._last + self._spread * (watch.poll_s if self.polling or self.problem else watch.rescan_s)

    def look(self, now: float, tree: Tree, watch: Watch) -> bool:
        """List what is to be listed; whether the assets must be compared with what is known of them."""
        with self._lock:
            full = self._everything or now >= self.due(watch)
            dirty, self._dirty, self._everything = self._dirty, set(), False
        if not full and not dirty:
            return False
        if full:
            self._last, self._spread = now, self._clock.jitter(1.0)
        changed, problem = False, self._guard.problem()
        if not problem:
            try:
                changed = tree.scan(now, None if full else dirty)
            except RootGone as error:
                problem = f"the watched folder cannot be listed ({error}); waiting for it to come back"
        if problem != self.problem:
            self.problem = problem
            self._table.set_facts(problem=problem)
            self._log.warning("%s", problem or "the watched folder is there again")
            self._everything = True
        return (changed or full) and not problem
