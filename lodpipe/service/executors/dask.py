"""`dask`: jobs on the workers of a Dask cluster (https://distributed.dask.org); `pip install 'lodpipe[dask]'`.

Each job runs in a process of its own beside the Dask worker that has the task, so that a job which hangs, crashes or
holds the interpreter for minutes is nothing to that worker. A worker that dies has its task given to another one by
the scheduler. The task's key is the content's fingerprint: the same work is never submitted twice at a time. The job
table stays the truth; the cluster may be stopped at any moment.
"""

from __future__ import annotations

import dataclasses
import os
import socket
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lodpipe.core.errors import ConfigError, LodpipeError
from lodpipe.service.executors import Listener, Settings
from lodpipe.service.job import AGAIN, PASSING, Job, Outcome, nature_of, versions
from lodpipe.service.pool import run_one

if TYPE_CHECKING:
    from distributed import Future

TOPIC = "lodpipe"
LOOK_SECONDS = 2.0
PROGRESS_SECONDS = 1.0
CONNECT_SECONDS = 15.0


class DaskExecutor:
    """A client of a scheduler. Takes as many jobs at a time as the fitting workers have threads."""

    def __init__(self, settings: Settings, listener: Listener) -> None:
        if not settings.scheduler:
            raise ConfigError("the executor dask needs watch.scheduler", advice="tcp://host:8786")
        try:
            from distributed import Client
        except ImportError as error:
            raise ConfigError("Dask is not installed", advice="pip install 'lodpipe[dask]'") from error
        try:
            self._client = Client(settings.scheduler, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            advice = "start it with `dask scheduler`, or mend watch.scheduler"
            raise ConfigError(f"no scheduler answers at {settings.scheduler} ({error})", advice=advice) from error
        self._listener = listener
        self._mine = _comparable(versions())
        self._fit: dict[str, int] = {}
        self.problems: dict[str, str] = {}
        """Workers that get no jobs, and why."""
        self._futures: dict[str, Future[Any]] = {}
        self._client.subscribe_topic(TOPIC, self._heard)
        self._closed = threading.Event()
        self._look()
        self._thread = threading.Thread(target=self._keep_looking, name="dask workers", daemon=True)
        self._thread.start()

    @property
    def slots(self) -> int:
        """Threads of the workers that have our versions."""
        return sum(self._fit.values())

    def resize(self, workers: int) -> None:
        """The cluster says how many there are."""

    def start(self, key: str, job: Job, content: str) -> None:
        """Submit a job to the workers that fit."""
        future = self._client.submit(
            run_remote,
            dataclasses.asdict(job),
            key,
            key=f"lodpipe-{content}",
            workers=list(self._fit) or None,
            allow_other_workers=False,
            pure=False,
        )
        self._futures[key] = future
        future.add_done_callback(lambda done: self._ended(key, done, job))

    def stop(self, key: str) -> None:
        """Cancel a job: its worker notices, and ends the process."""
        if future := self._futures.get(key):
            future.cancel()

    def prepare(self) -> None:
        """Nothing: the workers run."""

    def rest(self) -> None:
        """Nothing."""

    def process_of(self, key: str) -> int:
        """None on this machine."""
        return 0

    def close(self) -> None:
        """Cancel what runs, and leave the cluster as it is."""
        self._closed.set()
        for key in list(self._futures):
            self.stop(key)
        self._thread.join(timeout=LOOK_SECONDS + 1)
        self._client.close(timeout=5)

    def _keep_looking(self) -> None:
        while not self._closed.wait(LOOK_SECONDS):
            try:
                self._look()
            except (OSError, ValueError, TimeoutError):  # the scheduler is away: it may come back
                self._fit = {}

    def _look(self) -> None:
        """Which workers there are, and whether they would give the same results."""
        found = {address: int(said["nthreads"]) for address, said in self._client.scheduler_info(-1)["workers"].items()}
        new = [address for address in found if address not in self._fit and address not in self.problems]
        theirs = self._client.run(remote_versions, workers=new, on_error="return") if new else {}
        for address, said in theirs.items():
            if isinstance(said, Exception):
                self.problems[address] = f"has no lodpipe that answers ({said})"
            elif different := [
                f"{name} {said.get(name, 'none')} instead of {version}"
                for name, version in self._mine.items()
                if said.get(name) != version
            ]:
                self.problems[address] = f"has {', '.join(different)}"
        self.problems = {address: why for address, why in self.problems.items() if address in found}
        self._fit = {address: threads for address, threads in found.items() if address not in self.problems}

    def _heard(self, event: tuple[float, Any]) -> None:
        said = event[1]
        if isinstance(said, dict) and said.get("key") in self._futures:
            self._listener.progress(said["key"], said["step"], said["stage"], said["share"])

    def _ended(self, key: str, future: Future[Any], job: Job) -> None:
        outcome: Outcome | None = None
        if future.status == "finished":
            said = future.result()
            outcome = Outcome(**said) if said is not None else None
        elif future.status == "error":  # its workers died under it, again and again
            message = f"{job.path}: the cluster gave it up: {future.exception()}"
            outcome = Outcome(job.path, str(job.place), "failed", "", message, nature=AGAIN)
        self._futures.pop(key, None)
        future.release()
        self._listener.ended(key, outcome)


def remote_versions() -> dict[str, str]:
    """What a worker has of what a result depends on."""
    return _comparable(versions())


def _comparable(found: dict[str, str]) -> dict[str, str]:
    return found | {"python": ".".join(found["python"].split(".")[:2])}


def run_remote(data: dict[str, Any], key: str) -> dict[str, Any] | None:
    """The task: do the job in a process beside this worker; its outcome as plain data, None if it was cancelled."""
    from distributed import get_worker

    worker = get_worker()
    task = worker.get_current_task()
    job = Job.from_data(data)
    if not Path(job.read_from or job.path).exists():
        message = f"{job.path}: {job.read_from} cannot be seen on {socket.gethostname()}: OUT must be on a shared path"
        return dataclasses.asdict(Outcome(job.path, str(job.place), "failed", "", message, nature=PASSING))
    threads = job.threads or max(1, (os.cpu_count() or 1) // worker.state.nthreads)
    last: list[Any] = ["", 0.0]

    def progress(job: Job, step: int, stage: str, share: float) -> None:
        now = time.monotonic()
        if stage != last[0] or now - last[1] >= PROGRESS_SECONDS:
            last[:] = [stage, now]
            worker.log_event(TOPIC, {"key": key, "step": step, "stage": stage, "share": share})

    stop, over = threading.Event(), threading.Event()

    def watch() -> None:
        while not over.wait(0.25):
            state = worker.state.tasks.get(task)
            if state is None or state.state not in ("executing", "long-running"):
                stop.set()  # cancelled, or given to somebody else

    threading.Thread(target=watch, daemon=True).start()
    try:
        outcome = run_one(dataclasses.replace(job, threads=threads), progress, stop=stop)
    except LodpipeError as error:  # its record could not be written
        outcome = Outcome(job.path, str(job.place), "failed", "", str(error), nature=nature_of(error))
    finally:
        over.set()
    return None if outcome is None else dataclasses.asdict(outcome)
