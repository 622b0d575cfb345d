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
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import lodpipe
from lodpipe.core.errors import OutputError
from lodpipe.service.job import BUG_ADVICE, LOG, Failure, Job, Outcome, fail, too_slow
from lodpipe.service.publish import FAILED, Output

GRACE_SECONDS = 5.0
"""What a worker that is over its time gets to notice that itself."""
TAIL_LINES = 30

Report = Callable[[Job, int, str, float], None]
"""Called with the job, the number of stages begun, what is being done and the share of it that is done."""


def run_isolated(jobs: Iterable[Job], workers: int, progress: Report) -> Iterator[Outcome]:
    """Do `jobs` with `workers` at a time, each in a process of its own; outcomes as they come.

    When the caller stops (an exception, or the iterator is closed) the workers are ended and nothing of theirs stays.
    """
    waiting = iter(jobs)
    running: list[_Worker] = []
    with selectors.DefaultSelector() as selector:
        try:
            while True:
                while len(running) < workers and (job := next(waiting, None)) is not None:
                    worker = _Worker(job)
                    running.append(worker)
                    selector.register(worker.events, selectors.EVENT_READ, worker)
                if not running:
                    return
                for key, _ in selector.select(timeout=0.5):
                    key.data.read(progress)
                for worker in [worker for worker in running if worker.ended or worker.late]:
                    running.remove(worker)
                    selector.unregister(worker.events)
                    yield worker.finish()
        finally:
            for worker in running:
                worker.kill()
                worker.close()
            for root in {worker.job.output for worker in running}:
                Output(Path(root)).sweep()


@dataclass
class _Worker:
    """A running process and the line that it writes its news on."""

    job: Job
    process: subprocess.Popen[bytes] = field(init=False)
    events: IO[bytes] = field(init=False)
    printed: IO[bytes] = field(init=False)
    begin: float = field(init=False)
    stage: str = "start"
    outcome: Outcome | None = None
    error: str = ""
    ended: bool = False
    _rest: bytes = b""

    def __post_init__(self) -> None:
        self.begin = time.monotonic()
        self.printed = tempfile.TemporaryFile()  # noqa: SIM115 closed in close, when the process has ended
        receiver, sender = os.pipe()
        os.set_blocking(receiver, False)
        self.events = open(receiver, "rb", buffering=0)  # noqa: SIM115, PTH123 a descriptor, closed in close
        environment = dict(os.environ)
        home = str(Path(lodpipe.__file__).parent.parent)
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, (home, environment.get("PYTHONPATH"))))
        if self.job.threads:
            environment["OMP_NUM_THREADS"] = str(self.job.threads)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "lodpipe.service.worker", str(sender)],
            stdin=subprocess.PIPE,
            stdout=self.printed,
            stderr=self.printed,
            pass_fds=(sender,),
            env=environment,
            start_new_session=True,  # Ctrl-C reaches the parent alone, which then ends the workers
        )
        os.close(sender)
        line = json.dumps(dataclasses.asdict(self.job)) + "\n"
        with contextlib.suppress(BrokenPipeError):  # it died at once: seen as such when its events end
            self._stdin.write(line.encode("ascii"))
            self._stdin.flush()

    @property
    def _stdin(self) -> IO[bytes]:
        if self.process.stdin is None:
            raise OutputError("a worker process has no stdin")
        return self.process.stdin

    @property
    def late(self) -> bool:
        """Whether the job's time is over, and the grace in which the worker should have seen that itself."""
        return time.monotonic() - self.begin > self.job.limits.minutes * 60 + GRACE_SECONDS

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
            elif "outcome" in news:
                self.outcome = Outcome(**news["outcome"])
            else:
                self.error = news["error"]

    def finish(self) -> Outcome:
        """The outcome of a worker that has ended, or that is late and ended now."""
        late = not self.ended
        if late:
            self.kill()
        code = self.process.wait()
        try:
            if self.outcome:
                return self.outcome
            if self.error:
                return Outcome(self.job.path, str(self.job.place), "failed", "", self.error)
            output = Output(Path(self.job.output))
            output.sweep()
            with tempfile.TemporaryDirectory() as folder:
                log = Path(folder) / LOG
                log.write_bytes(self._tail())
                outcome = fail(self.job, output, self._failure(late, code), log=log)
            outcome.seconds = time.monotonic() - self.begin
            return outcome
        finally:
            self.close()

    def kill(self) -> None:
        """End the process and all that it has started, and wait for it."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def _failure(self, late: bool, code: int) -> Failure:
        place = f"{self.job.path}: {self.stage}"
        if late:
            told = too_slow(self.job.limits.minutes)
            return Failure(self.stage, told["cause"], place, told["advice"], "LimitError")
        if code == -signal.SIGKILL:
            cause = "its process was killed from outside, most likely because memory ran out"
            return Failure(self.stage, cause, place, "lower limits.memory_gb or --workers", "Killed")
        folder = Path(self.job.output) / FAILED / self.job.place
        what = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        cause = f"internal error: its process ended unexpectedly ({what})"
        return Failure(self.stage, cause, place, BUG_ADVICE.format(folder=folder), "Crash")

    def _tail(self) -> bytes:
        """The last lines that the process has printed."""
        self.printed.seek(0)
        return b"\n".join(self.printed.read().splitlines()[-TAIL_LINES:]) + b"\n"

    def close(self) -> None:
        """Let go of what the process was connected by."""
        self.events.close()
        self.printed.close()
        with contextlib.suppress(BrokenPipeError):
            self._stdin.close()
