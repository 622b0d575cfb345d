"""When to look at the watched folder, and at how much of it."""

from __future__ import annotations

import logging
import os
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
        self._closed: dict[str, bool] = {}
        self._everything = True
        self._left_out: dict[str, str] = {}
        self._last = 0.0
        self._spread = 1.0

    def tell(self, folder: str | None, name: str = "", closed: bool = False) -> None:
        """Something has changed in a folder, relative to the watched one; None: nobody knows where. From any thread.

        With the `name` of a file in it: whether its writer has `closed` it. The last word before a look counts.
        """
        with self._lock:
            if folder is None:
                self._everything = True
                self._closed.clear()  # what has been told may not have been all
            else:
                self._dirty.add(folder)
                if name:
                    self._closed[f"{folder}/{name}" if folder else name] = closed
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
            closed, self._closed = self._closed, {}
        if not full and not dirty:
            return False
        if full:
            self._last, self._spread = now, self._clock.jitter(1.0)
        changed, problem = False, self._guard.problem()
        if not problem:
            try:
                changed = tree.scan(now, None if full else dirty)
                changed |= any([tree.mark(path, yes) for path, yes in closed.items()])  # noqa: C419 each of them
                self._tell_left_out(tree)
            except RootGone as error:
                problem = f"the watched folder cannot be listed ({error}); waiting for it to come back"
        if problem != self.problem:
            self.problem = problem
            self._table.set_facts(problem=problem)
            self._log.warning("%s", problem or "the watched folder is there again")
            self._everything = True
        return (changed or full) and not problem

    def _tell_left_out(self, tree: Tree) -> None:
        """Say, in the log and for `status`, which folders are not looked into."""
        if tree.problems == self._left_out:
            return
        for folder, why in tree.problems.items():
            if self._left_out.get(folder) != why:
                self._log.warning("%s: %s; what is in it is not seen", folder, why)
        for folder in self._left_out.keys() - tree.problems.keys():
            self._log.info("%s: it is looked into, or gone", folder)
        self._left_out = dict(tree.problems)
        self._table.set_facts(left_out={_readable(folder): why for folder, why in self._left_out.items()})


def _readable(folder: str) -> str:
    return os.fsencode(folder).decode("utf-8", "backslashreplace")
