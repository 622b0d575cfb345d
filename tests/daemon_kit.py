"""Daemons for tests: one whose clock, threads and workers are the test's, and one in a process of its own."""

from __future__ import annotations

import io as text_io
import json
import logging
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from chains import CHAIN, plugin_folder
from lodpipe.service import control
from lodpipe.service.chain import load_chain
from lodpipe.service.clock import Clock
from lodpipe.service.daemon import Daemon
from lodpipe.service.job import Job, Outcome, process
from lodpipe.service.publish import Output
from lodpipe.service.recipe import Recipe
from lodpipe.service.table import JobTable, Row

REPO = Path(__file__).parents[1]


class HandClock(Clock):
    """Goes when it is pushed."""

    def __init__(self) -> None:
        self.now = 1000.0

    def monotonic(self) -> float:
        return self.now

    def time(self) -> float:
        return 1e9 + self.now

    def jitter(self, seconds: float) -> float:
        return seconds


class HandExecutor:
    """Holds jobs until the test does them, in its own process."""

    def __init__(self, slots: int = 1) -> None:
        self.slots = slots
        self.jobs: dict[str, Job] = {}
        self.started: list[str] = []
        self.stopped: list[str] = []
        self.daemon: Daemon | None = None

    def start(self, key: str, job: Job, content: str) -> None:
        self.jobs[key] = job
        self.started.append(key)

    def stop(self, key: str) -> None:
        self.stopped.append(key)
        del self.jobs[key]
        self.daemon.ended(key, None)

    def prepare(self) -> None: ...
    def rest(self) -> None: ...
    def close(self) -> None: ...

    def process_of(self, key: str) -> int:
        return 0

    def finish(self, key: str, outcome: Outcome | None = None) -> Outcome:
        """Do a job for real, or end it with `outcome`."""
        outcome = outcome or process(self.jobs[key])
        del self.jobs[key]
        self.daemon.ended(key, outcome)
        return outcome

    def end_badly(self, key: str, nature: str, message: str = "it went wrong") -> None:
        """End a job as if its process had gone wrong."""
        job = self.jobs[key]
        self.finish(key, Outcome(job.path, str(job.place), "failed", "", message, nature=nature))


class World:
    """A drop folder, an output folder and a daemon between them."""

    def __init__(self, root: Path, chain: dict[str, Any] | None = None, *, once: bool = False, **watch: Any) -> None:
        self.root, self.drop, self.out = root, root / "drop", root / "out"
        self.drop.mkdir(exist_ok=True)
        self.chain = dict(chain or CHAIN)
        self.watch = watch
        self.once = once
        self.clock = HandClock()
        self.said = text_io.StringIO()
        self.start()

    def recipe(self) -> Recipe:
        return Recipe.loaded(load_chain(self.chain | {"watch": self.watch}, (), [plugin_folder(self.root)]))

    def start(self) -> None:
        """As a process that has just begun; also after one that was killed."""
        self.output = Output(self.out)
        self.table = JobTable(self.output.state, create=True)
        self.executor = HandExecutor(self.watch.get("workers", 1))
        log = logging.Logger("test")
        log.addHandler(logging.StreamHandler(self.said))
        self.output.sweep()
        self.daemon = Daemon(
            self.drop.resolve(),
            self.output,
            self.table,
            self.recipe(),
            clock=self.clock,
            submit=lambda work, then: then(work()),
            wake=lambda: None,
            log=log,
            owner="test",
            once=self.once,
        )
        self.daemon.executor = self.executor
        self.executor.daemon = self.daemon

    def kill(self) -> None:
        """What `kill -9` leaves: nothing is said, nothing is tidied, but locks and files are let go."""
        for key in list(self.daemon._running):
            self.daemon._running[key][0].release()  # the system would free the lock; the sweep then removes the copy
        self.daemon.close()
        self.table.close()

    def look(self, seconds: float = 0.0) -> None:
        """Let time go by, look at the whole folder, and do what follows at once."""
        self.clock.now += seconds
        self.daemon.dirty(None)
        self.daemon.tick()
        self.daemon.tick()

    def settle(self) -> None:
        """Let everything in the folder come to rest and be queued or started."""
        self.look()
        self.look(self.daemon.watch.settle_s)

    def work(self) -> list[str]:
        """Do all there is to do; the inputs of the jobs, in order."""
        before = len(self.executor.started)
        self.settle()
        while self.executor.jobs:
            self.executor.finish(next(iter(self.executor.jobs)))
            self.daemon.tick()
            self.daemon.tick()
            if not self.executor.jobs:
                self.settle()
        return self.executor.started[before:]

    def row(self, key: str) -> Row:
        """What the table says."""
        row = self.table.row(key)
        assert row is not None, f"{key} is not in the table"
        return row

    def states(self) -> dict[str, str]:
        return {row.key: row.state for row in self.table.rows()}

    def manifest(self, place: str) -> dict[str, Any]:
        return json.loads((self.out / place / "manifest.json").read_text())


def until(condition: Callable[[], object], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it took too long"
        time.sleep(0.05)


class Running:
    """`lodpipe watch` in a process of its own."""

    def __init__(self, root: Path, chain: dict | None = None, *options: str, **environment: str) -> None:
        self.root, self.drop, self.out, self.state = root, root / "drop", root / "out", root / "out" / ".lodpipe"
        self.drop.mkdir(exist_ok=True)
        plugin_folder(root)
        self.config = root / "chain.yaml"
        self.write_config(chain or {})
        self.command = [sys.executable, "-m", "lodpipe", "watch", str(self.drop), "-c", str(self.config)]
        self.command += ["-o", str(self.out), "--plugins", str(root / "stages_for_tests"), "--log", "json", *options]
        self.environment = os.environ | environment
        self.log = root / "log"
        self.start()

    def write_config(self, more: dict) -> None:
        watch = {"settle_s": 0.2} | more.pop("watch", {})
        aside = self.config.with_suffix(".new")
        aside.write_text(json.dumps(CHAIN | more | {"watch": watch}))
        aside.rename(self.config)

    def start(self) -> None:
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(self.command, cwd=REPO, env=self.environment, stderr=log)

    def says(self, text: str) -> bool:
        assert self.process.poll() is None or text in self.log.read_text(), self.log.read_text()
        return text in self.log.read_text()

    def states(self) -> dict[str, str]:
        return {asset["input"]: asset["state"] for asset in control.status(self.state)["assets"]}

    def end(self) -> None:
        self.process.kill()
        self.process.wait()
