"""Where jobs run. An executor is a plug-in: a factory named in the entry-point group `lodpipe.executors`."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Protocol

from lodpipe.config.problems import did_you_mean
from lodpipe.core.errors import ConfigError
from lodpipe.service.job import Job, Outcome

ENTRY_POINTS = "lodpipe.executors"


class Listener(Protocol):
    """Told what happens to jobs; may be called from any thread."""

    def progress(self, key: str, step: int, stage: str, share: float) -> None:
        """A job is in its `step`-th stage, of which a `share` is done."""

    def ended(self, key: str, outcome: Outcome | None) -> None:
        """A job is through; None: it was stopped, or its machine is lost, and nothing is known of it."""


class Executor(Protocol):
    """Runs each job once, in a process of its own that keeps the job's limits (`lodpipe.service.pool.run_one`)."""

    @property
    def slots(self) -> int:
        """How many jobs it takes at a time; may change."""

    problems: dict[str, str]
    """Machines that get no jobs, and why."""

    def resize(self, workers: int) -> None:
        """`watch.workers` has another value now."""

    def start(self, key: str, job: Job, content: str) -> None:
        """Begin a job; `content` is the same for jobs that would publish the same."""

    def stop(self, key: str) -> None:
        """End a job that was started. `ended` is still called."""

    def prepare(self) -> None:
        """Work is coming: what is slow to start may be started now."""

    def rest(self) -> None:
        """No work is coming: what only waits may be ended."""

    def process_of(self, key: str) -> int:
        """The process id of a running job on this machine; 0 where there is none."""

    def close(self) -> None:
        """End everything."""


@dataclass(frozen=True)
class Settings:
    """What an executor is made from."""

    workers: int = 1
    threads: int = 0
    """Most threads for each job, 0 for all cores."""
    scheduler: str = ""
    """Address, for those that have one."""


class Factory(Protocol):
    """Makes an executor. Raises LodpipeError if it cannot run here."""

    def __call__(self, settings: Settings, listener: Listener) -> Executor: ...


def find_executor(name: str) -> Factory:
    """The factory of that name: `local`, `dask`, or one that an installed package has. Raises ConfigError."""
    if name == "local":
        from lodpipe.service.executors.local import LocalExecutor

        return LocalExecutor
    if name == "dask":
        from lodpipe.service.executors.dask import DaskExecutor

        return DaskExecutor
    points = {point.name: point for point in entry_points(group=ENTRY_POINTS)}
    if name not in points:
        raise ConfigError(f"there is no executor '{name}'{did_you_mean(name, ['local', 'dask', *points])}")
    try:
        factory: Factory = points[name].load()
        return factory
    except Exception as error:  # whatever a package does while it is imported, the user gets one line
        raise ConfigError(f"the executor '{name}' cannot be loaded: {type(error).__name__}: {error}") from error
