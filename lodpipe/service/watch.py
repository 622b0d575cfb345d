"""`watch`: the daemon as a process. It owns the lock, the threads, the signals and the waiting."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import sqlite3
import threading
import time
import uuid
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

from lodpipe.core.errors import ConfigError, LodpipeError, OutputError
from lodpipe.service.clock import Clock, Waker
from lodpipe.service.daemon import Daemon
from lodpipe.service.discover import STATE
from lodpipe.service.executors import Settings, find_executor
from lodpipe.service.hooks import Hooks
from lodpipe.service.http import StatusServer
from lodpipe.service.index import Index
from lodpipe.service.intake import Taken
from lodpipe.service.lock import NoLocks, take_lock
from lodpipe.service.notify import notify, watchdog_seconds
from lodpipe.service.pool import end_orphan
from lodpipe.service.publish import Output
from lodpipe.service.recipe import Recipe, read_recipe
from lodpipe.service.table import FAILED, RUNNING, JobTable
from lodpipe.service.watcher import Watcher, file_system, is_silent

IDLE_SECONDS = 1.0
"""Longest wait: how soon commands, signals of other kinds and a changed configuration are seen."""
SHORTEST_SECONDS, BUSY_SHARE = 0.05, 0.2
"""Between two looks, however many events come; and the share of the time that looking at a large folder may take."""
CONFIG_SECONDS = 2.0
DISK_SECONDS, TOLD_SECONDS = 1.0, 60.0
"""After a look that a full disk has spoilt: until the next, and until the log is told again."""
MISHAPS = 10
"""How many bugs in a row, without one look at the folder that goes well, are too many."""
STOP_SECONDS = 10.0


@dataclass(frozen=True)
class Request:
    """What the user asked for."""

    drop: Path
    output: Path
    config: str = "default"
    settings: tuple[str, ...] = ()
    plugins: tuple[str, ...] = ()
    state: Path | None = None
    """The folder of the job table; None: `.lodpipe` in the output folder."""
    once: bool = False


@dataclass
class _Signals:
    """What signals have asked for."""

    stop: int = 0
    reload: bool = False
    _before: dict[int, Any] = field(default_factory=dict)

    def install(self, wake: Callable[[], None]) -> None:
        def handle(number: int, frame: FrameType | None) -> None:
            if number == signal.SIGHUP:
                self.reload = True
            else:
                self.stop += 1
            wake()

        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
                self._before[number] = signal.signal(number, handle)

    def remove(self) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)


def watch(request: Request, log: logging.Logger) -> int:
    """Run the daemon until a signal ends it, or with `once` until nothing is left to do; the exit code.

    Raises LodpipeError for what is wrong before it has begun.
    """
    drop, out = request.drop, request.output
    check_apart(drop, out)
    recipe = read_recipe(request.config, request.settings, request.plugins)
    output = Output(out)
    state = request.state or out / STATE
    try:
        state.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot be made ({error.strerror})", place=str(state)) from error
    with contextlib.ExitStack() as held:
        held.callback(os.close, take_lock(state))
        if not state.samefile(output.state):  # two daemons with two job tables would replace each other's results
            try:
                held.callback(os.close, take_lock(output.state))
            except NoLocks as error:
                log.warning("%s; see to it yourself that no other daemon publishes there", error)
        remote = is_silent(file_system(state))
        table = JobTable(state, create=True, journal="truncate" if remote else "wal")
        if remote:
            log.warning("%s is on a network drive: put the job table on a local disk with --state", state)
        if table.set_aside:
            log.error("the job table was damaged; it is kept as %s and made anew", table.set_aside)
        if not drop.is_dir() and table.fact("root_id") is None:
            raise OutputError("there is no such folder", place=str(drop), advice="make it, or mount its share")
        process = _Process(request, recipe, output, table, state, log)
        try:
            return process.run()
        finally:
            process.close()
            table.close()


def check_apart(drop: Path, output: Path) -> None:
    """Raise OutputError if results would become inputs. (An output folder in the watched one is left out of it.)"""
    if drop.resolve().is_relative_to(output.resolve()):
        raise OutputError(
            f"lies in the output folder {output}", place=str(drop), advice="results would be taken as inputs"
        )


class _Process:
    """The parts of a running daemon."""

    def __init__(
        self, request: Request, recipe: Recipe, output: Output, table: JobTable, state: Path, log: logging.Logger
    ) -> None:
        self.request, self.table, self.log = request, table, log
        self.clock, self.waker, self.signals = Clock(), Waker(), _Signals()
        self.intake = ThreadPoolExecutor(2, "beside")  # copies assets, writes the index
        for row in table.rows("state = ?", (RUNNING,)):
            if end_orphan(row.pid, row.pid_start):
                log.warning("%s: ended a worker that the last daemon left behind", row.key)
        output.sweep()
        owner = f"{os.getpid()}-{uuid.uuid4().hex[:8]}"
        table.set_facts(
            pid=os.getpid(),
            owner=owner,
            started=time.time(),
            drop=str(request.drop),
            config=request.config,
            config_problem="",
            problem="",
        )
        self.daemon = Daemon(
            request.drop.resolve(),
            output,
            table,
            recipe,
            clock=self.clock,
            submit=self._submit,
            wake=self.waker.wake,
            log=log,
            owner=owner,
            once=request.once,
        )
        watch = self.daemon.watch
        self._made_of = (watch.executor, watch.scheduler, watch.port)
        self.daemon.executor = find_executor(watch.executor)(
            Settings(watch.workers, self.daemon.threads, watch.scheduler), self.daemon
        )
        self.watcher = Watcher(self.daemon.root, self.daemon.dirty, log, watch.events)
        self.hooks = Hooks(state, watch, log)
        self.server = StatusServer(state, output.root, watch.port) if watch.port is not None else None
        table.set_facts(address=self.server.address if self.server else "")
        self._config_stamp = _stamp(recipe)
        self._config_looked = self.clock.monotonic()
        self._deadline = float("inf")
        self._told: dict[str, str] = {}
        self.index = Index(output.root)
        self._indexed = 0
        self._indexing: Future[None] = Future()
        self._indexing.set_result(None)

    def _submit(self, work: Callable[[], Taken], then: Callable[[Taken], None]) -> None:
        self.intake.submit(work).add_done_callback(lambda future: then(future.result()))

    def run(self) -> int:
        """The loop."""
        self.signals.install(self.waker.wake)
        places = f"{self.request.drop} → {self.request.output}"
        self.log.info("watching %s%s", places, f", status on {self.server.address}" if self.server else "")
        notify("READY=1", f"STATUS=watching {places}")
        every, last_ping, mishaps = watchdog_seconds(), 0.0, 0
        told, told_at = "", 0.0
        while True:
            now = self.clock.monotonic()
            self.daemon.polls(not self.watcher.check())
            if self.signals.reload or self._config_changed(now):
                self._reload()
            if self.signals.stop and self._stopped(now):
                return 0
            try:
                due = self.daemon.tick()
                mishaps, told = 0, ""
            except Exception as error:  # a full disk, or a bug: the assets and the table are what they were
                mishaps += 1
                expected = isinstance(error, sqlite3.OperationalError | OSError | LodpipeError)
                if not expected and mishaps > MISHAPS:
                    raise
                if not expected or str(error) != told or now >= told_at + TOLD_SECONDS:
                    told, told_at = str(error), now
                    self.log.error(
                        "%s: %s; going on", type(error).__name__, error, exc_info=None if expected else error
                    )
                self._recover()
                due = now
                time.sleep(DISK_SECONDS)  # whatever wakes it: there is nothing that it could do at once
            self.hooks.look()
            self._tell_problems()
            self._update_index()
            if self.request.once and (self.daemon.finished or self.daemon.problem):
                return self._verdict()
            if every and now - last_ping >= every:
                last_ping = now
                notify("WATCHDOG=1")
            took = self.clock.monotonic() - now
            time.sleep(min(IDLE_SECONDS, max(SHORTEST_SECONDS, took * (1 / BUSY_SHARE - 1))))
            self.waker.wait(min(due - self.clock.monotonic(), IDLE_SECONDS))

    def _update_index(self) -> None:
        """The page over all results, written beside the loop: it may have much to read."""
        if not self._indexing.done():
            return
        if self.daemon.outcomes != self._indexed:
            self._indexed = self.daemon.outcomes
            self._indexing = self.intake.submit(self.index.changed)
        elif not self.daemon.busy:
            self._indexing = self.intake.submit(self.index.settle)

    def _tell_problems(self) -> None:
        problems = dict(self.daemon.executor.problems) if self.daemon.executor else {}
        for machine, why in problems.items():
            if self._told.get(machine) != why:
                self.log.warning("no jobs for %s: it %s", machine, why)
        self._told = problems

    def _recover(self) -> None:
        try:
            self.daemon.recover()
        except (sqlite3.OperationalError, OSError, LodpipeError):  # the next look meets the same, and tells
            return

    def _verdict(self) -> int:
        if self.daemon.problem:
            raise OutputError(self.daemon.problem, place=str(self.request.drop))
        left = {state: count for state, count in self.table.counts().items() if count}
        self.log.info(
            "nothing is left to do: %s", ", ".join(f"{n} {state}" for state, n in left.items()) or "no assets"
        )
        return 1 if left.get(FAILED) or left.get("queued") else 0

    def _stopped(self, now: float) -> bool:
        """After a signal: whether it is time to go."""
        if not self.daemon.draining:
            self.daemon.draining = True
            self._deadline = now + self.daemon.watch.drain_s
            notify("STOPPING=1", "STATUS=finishing what runs")
            self.log.info("stopping: what runs may take %g s more; a second signal ends it", self.daemon.watch.drain_s)
        if self.signals.stop > 1 or now >= self._deadline:
            self.daemon.stop_jobs()
        return not self.daemon.running or now >= self._deadline + STOP_SECONDS

    def _config_changed(self, now: float) -> bool:
        if now - self._config_looked < CONFIG_SECONDS:
            return False
        self._config_looked = now
        return _stamp(self.daemon.recipe) != self._config_stamp

    def _reload(self) -> None:
        """Read the configuration again; a bad one is told, and the old one stays."""
        self.signals.reload = False
        self._config_stamp = _stamp(self.daemon.recipe)
        notify("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1000}")
        try:
            recipe = read_recipe(self.request.config, self.request.settings, self.request.plugins)
        except ConfigError as error:
            self.table.set_facts(config_problem=str(error))
            self.log.error("the new configuration is not valid, the old one stays: %s", error)
        else:
            self.daemon.apply(recipe)
            watch = self.daemon.watch
            self.hooks.watch = watch
            if self.daemon.executor:
                self.daemon.executor.resize(watch.workers)
            if (watch.executor, watch.scheduler, watch.port) != self._made_of:
                self.log.warning("another executor, scheduler or port takes a restart")
            self._config_stamp = _stamp(recipe)
            self.table.set_facts(config_problem="")
            self.log.info("the configuration was read again")
        notify("READY=1")

    def close(self) -> None:
        """End everything that was begun."""
        self.signals.remove()
        self.watcher.close()
        if self.daemon.executor:
            self.daemon.executor.close()
        self.intake.shutdown(cancel_futures=True)
        if self.daemon.outcomes:
            self.index.update()
        try:
            self.daemon.last_news()
        except (sqlite3.Error, LodpipeError) as error:
            self.log.error("the last news could not be written: %s", error)
        self.daemon.close()
        self.hooks.close()
        if self.server:
            self.server.close()
        self.waker.close()
        with contextlib.suppress(sqlite3.Error):  # a full disk
            self.table.set_facts(pid=0, address="")
        self.log.info("stopped")


def _stamp(recipe: Recipe) -> list[tuple[str, int, int]]:
    """What tells that the configuration or a plug-in has been edited, or that there is a new one."""
    files = [*recipe.files, *(str(path) for folder in recipe.plugins for path in sorted(Path(folder).glob("*.py")))]
    found = []
    for name in dict.fromkeys(files):
        try:
            status = os.stat(name)  # noqa: PTH116 many names, plain text
        except OSError:
            continue
        found.append((name, status.st_mtime_ns, status.st_size))
    return found
