"""Jobs in fresh processes, a few at a time: whatever happens in one of them, the others go on."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from threading import Event
from typing import IO, Any

from lodpipe.core.errors import OutputError
from lodpipe.service.job import AGAIN, BUG_ADVICE, LOG, Failure, Job, Outcome, fail, too_big, too_slow
from lodpipe.service.memory import resident_gb
from lodpipe.service.publish import FAILED, Output
from lodpipe.service.recipe import module_environment

GRACE_SECONDS = 5.0
"""What a worker that is over its time gets to notice that itself."""
TERM_SECONDS = 2.0
"""What it, and the programs that it has started, get to end by themselves when they are asked to."""
LOOK_SECONDS = 1.0
"""Between two looks at a worker's memory."""
BASE_GB = 0.5
"""What a worker has before its job begins, at most."""
STOP_SECONDS = 0.25
"""Longest time until a job that is to stop does."""
TAIL_LINES, TAIL_BYTES = 30, 1 << 16

Report = Callable[[Job, int, str, float], None]
"""Called with the job, the number of stages begun, what is being done and the share of it that is done."""


def run_isolated(jobs: Iterable[Job], workers: int, progress: Report) -> Iterator[Outcome]:
    """Do `jobs` with `workers` at a time, each in a process of its own; outcomes as they come.

    When the caller stops (an exception, or the iterator is closed) the workers are ended and nothing of theirs stays.
    """
    waiting = iter(jobs)
    running: list[Worker] = []
    with selectors.DefaultSelector() as selector:
        try:
            while True:
                while len(running) < workers and (job := next(waiting, None)) is not None:
                    worker = Worker(job.threads)
                    worker.assign(job)
                    running.append(worker)
                    selector.register(worker.events, selectors.EVENT_READ, worker)
                if not running:
                    return
                for key, _ in selector.select(timeout=0.5):
                    key.data.read(progress)
                for worker in [worker for worker in running if worker.over]:
                    running.remove(worker)
                    selector.unregister(worker.events)
                    yield worker.finish()
        finally:
            for worker in running:
                worker.kill()
                worker.close()
            for root in {worker.job.output for worker in running}:
                Output(Path(root)).sweep()


def run_one(job: Job, progress: Report, worker: Worker | None = None, stop: Event | None = None) -> Outcome | None:
    """Do one job in a process of its own (`worker`, if one is waiting); None when `stop` was set before it ended."""
    worker = worker or Worker(job.threads)
    try:
        worker.assign(job)
        with selectors.DefaultSelector() as selector:
            selector.register(worker.events, selectors.EVENT_READ)
            while not worker.over:
                if stop is not None and stop.is_set():
                    return None
                if selector.select(timeout=STOP_SECONDS):
                    worker.read(progress)
        return worker.finish()
    finally:
        if worker.process.poll() is None:
            worker.kill()
            worker.close()
            Output(Path(job.output)).sweep()


class Worker:
    """A fresh process that does one job, and the line that it writes its news on.

    It may be made before its job is known: it then loads the `modules`, and waits.
    """

    def __init__(self, threads: int = 0, modules: Iterable[str] = ()) -> None:
        self.stage = "start"
        self.outcome: Outcome | None = None
        self.error: dict[str, Any] = {}
        self.modules: list[str] = []
        """What a job has loaded, once it is through."""
        self.ended = False
        self._job: Job | None = None
        self._begin = time.monotonic()
        self._rest = b""
        self._bloated = False
        self._looked = 0.0
        self._printed = tempfile.TemporaryFile()  # noqa: SIM115 closed in close, when the process has ended
        receiver, sender = os.pipe()
        os.set_blocking(receiver, False)
        self.events: IO[bytes] = open(receiver, "rb", buffering=0)  # noqa: SIM115, PTH123 a descriptor, closed in close
        environment = module_environment()
        if threads:
            environment["OMP_NUM_THREADS"] = str(threads)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "lodpipe.service.worker", str(sender), *modules],
            stdin=subprocess.PIPE,
            stdout=self._printed,
            stderr=self._printed,
            pass_fds=(sender,),
            env=environment,
            start_new_session=True,  # Ctrl-C reaches the parent alone, which then ends the workers
        )
        os.close(sender)

    def assign(self, job: Job) -> None:
        """Give the process its job. Its time begins to run."""
        self._job = job
        self._begin = time.monotonic()
        line = json.dumps(dataclasses.asdict(job)) + "\n"
        with contextlib.suppress(BrokenPipeError):  # it died at once: seen as such when its events end
            self._stdin.write(line.encode("ascii"))
            self._stdin.flush()

    @property
    def job(self) -> Job:
        """What it does."""
        if self._job is None:
            raise OutputError("a worker process has no job yet")
        return self._job

    @property
    def _stdin(self) -> IO[bytes]:
        if self.process.stdin is None:
            raise OutputError("a worker process has no stdin")
        return self.process.stdin

    @property
    def over(self) -> bool:
        """Whether it has ended, or must be ended."""
        return self.ended or self.late or self.bloated

    @property
    def late(self) -> bool:
        """Whether the job's time is over, and the grace in which the worker should have seen that itself."""
        return time.monotonic() - self._begin > self.job.limits.minutes * 60 + GRACE_SECONDS

    @property
    def bloated(self) -> bool:
        """Whether the process has more memory than its own limit should have let it have."""
        if not self._bloated and time.monotonic() - self._looked >= LOOK_SECONDS:
            self._looked = time.monotonic()
            self._bloated = resident_gb(self.process.pid) > self.job.limits.memory_gb * 1.1 + BASE_GB
        return self._bloated

    def read(self, progress: Report) -> None:
        """Take in what the worker has written."""
        chunk = self.events.read(1 << 16)
        if chunk is None:
            return
        if not chunk:
            self.ended = True
            return
        *lines, self._rest = (self._rest + chunk).split(b"\n")
        for line in lines:
            news: dict[str, Any] = json.loads(line)
            if "progress" in news:
                index, self.stage, share = news["progress"]
                progress(self.job, index, self.stage, share)
            elif "modules" in news:
                self.modules = news["modules"]
            elif "outcome" in news:
                self.outcome = Outcome(**news["outcome"])
            else:
                self.error = news["error"]

    def finish(self) -> Outcome:
        """The outcome of a worker that has ended, or that is over a limit and ended now."""
        late = not self.ended
        if late:
            self.kill()
        code = self.process.wait()
        try:
            if self.outcome:
                return self.outcome
            if self.error:
                return Outcome(self.job.path, str(self.job.place), "failed", "", **self.error)
            output = Output(Path(self.job.output))
            output.sweep()
            with tempfile.TemporaryDirectory() as folder:
                log = Path(folder) / LOG
                log.write_bytes(self._tail())
                outcome = fail(self.job, output, self._failure(late, code), log=log)
            outcome.seconds = time.monotonic() - self._begin
            return outcome
        finally:
            self.close()

    def kill(self) -> None:
        """End the process and all that it has started: ask (SIGTERM), wait a little, make sure (SIGKILL)."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGTERM)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(TERM_SECONDS)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def _failure(self, late: bool, code: int) -> Failure:
        place = f"{self.job.path}: {self.stage}"
        if self._bloated or late:
            limits = self.job.limits
            told = too_big(limits.memory_gb) if self._bloated else too_slow(limits.minutes)
            return Failure(self.stage, told["cause"], place, told["advice"], "LimitError", nature=AGAIN)
        if code == -signal.SIGKILL:
            cause = "its process was killed from outside, most likely because memory ran out"
            return Failure(self.stage, cause, place, "lower limits.memory_gb or --workers", "Killed", nature=AGAIN)
        folder = Path(self.job.output) / FAILED / self.job.place
        what = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        cause = f"internal error: its process ended unexpectedly ({what})"
        return Failure(self.stage, cause, place, BUG_ADVICE.format(folder=folder), "Crash", nature=AGAIN)

    def _tail(self) -> bytes:
        """The last lines that the process has printed."""
        self._printed.seek(max(0, self._printed.seek(0, os.SEEK_END) - TAIL_BYTES))
        return b"\n".join(self._printed.read().splitlines()[-TAIL_LINES:]) + b"\n"

    def close(self) -> None:
        """Let go of what the process was connected by."""
        self.events.close()
        self._printed.close()
        with contextlib.suppress(BrokenPipeError):
            self._stdin.close()


def process_start(pid: int) -> int:
    """When a process began, in the system's ticks: with it, its id means one process for ever. 0 where unknown."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
        return 0 if fields[0] == "Z" else int(fields[19])
    except (OSError, IndexError, ValueError):
        return 0


def end_orphan(pid: int, start: int) -> bool:
    """End a worker whose parent is gone, if it still runs; whether it did."""
    if not pid or not start or process_start(pid) != start:
        return False
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signal.SIGKILL)
    end = time.monotonic() + GRACE_SECONDS
    while process_start(pid) == start and time.monotonic() < end:
        time.sleep(0.01)  # it is not our child: nothing tells when it is gone
    return True
