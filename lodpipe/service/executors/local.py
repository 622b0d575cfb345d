"""`local`: each job in a fresh process on this machine. The next one waits ready while there is work."""

from __future__ import annotations

import threading

from lodpipe.core.errors import LodpipeError
from lodpipe.service.executors import Listener, Settings
from lodpipe.service.job import AGAIN, Job, Outcome, nature_of
from lodpipe.service.pool import Worker, run_one


class LocalExecutor:
    """A thread for each running job, which feeds and watches the job's process."""

    def __init__(self, settings: Settings, listener: Listener) -> None:
        self.problems: dict[str, str] = {}
        self._workers_at_once = settings.workers
        self._settings, self._listener = settings, listener
        self._stops: dict[str, threading.Event] = {}
        self._workers: dict[str, Worker] = {}
        self._spares: list[Worker] = []
        self._modules: list[str] = ["lodpipe.stages"]
        self._threads: dict[str, threading.Thread] = {}

    @property
    def slots(self) -> int:
        """How many jobs run at a time."""
        return self._workers_at_once

    def resize(self, workers: int) -> None:
        """From now on so many."""
        self._workers_at_once = workers

    def start(self, key: str, job: Job, content: str) -> None:
        """Begin a job, in a process that waits for one if there is any."""
        worker = self._spare() or Worker(job.threads)
        stop = self._stops[key] = threading.Event()
        self._workers[key] = worker
        thread = self._threads[key] = threading.Thread(
            target=self._run, args=(key, job, worker, stop), name=f"job {key!r}", daemon=True
        )
        thread.start()

    def stop(self, key: str) -> None:
        """End a job that was started."""
        if key in self._stops:
            self._stops[key].set()

    def prepare(self) -> None:
        """Have as many processes ready as there are free slots, at least one."""
        wanted = max(1, self.slots - len(self._workers))
        self._spares = [worker for worker in self._spares if worker.process.poll() is None]
        while len(self._spares) < wanted:
            self._spares.append(Worker(self._settings.threads, self._modules))

    def rest(self) -> None:
        """End the processes that wait for a job."""
        for worker in self._spares:
            worker.kill()
            worker.close()
        self._spares.clear()

    def process_of(self, key: str) -> int:
        """The process id of a running job."""
        worker = self._workers.get(key)
        return worker.process.pid if worker else 0

    def close(self) -> None:
        """End everything, and wait for it."""
        for stop in list(self._stops.values()):
            stop.set()
        for thread in list(self._threads.values()):
            thread.join()
        self.rest()

    def _spare(self) -> Worker | None:
        while self._spares:
            worker = self._spares.pop(0)
            if worker.process.poll() is None:
                return worker
            worker.close()
        return None

    def _run(self, key: str, job: Job, worker: Worker, stop: threading.Event) -> None:
        outcome: Outcome | None
        try:
            outcome = run_one(
                job, lambda job, step, stage, share: self._listener.progress(key, step, stage, share), worker, stop
            )
        except LodpipeError as error:  # its record could not be written
            outcome = Outcome(job.path, str(job.place), "failed", "", str(error), nature=nature_of(error))
        except Exception as error:  # a bug here must not lose the job
            message = f"{job.path}: internal error: {type(error).__name__}: {error}"
            outcome = Outcome(job.path, str(job.place), "bug", "", message, nature=AGAIN)
        self._modules = worker.modules or self._modules
        for known in (self._stops, self._workers, self._threads):
            known.pop(key, None)
        self._listener.ended(key, outcome)
