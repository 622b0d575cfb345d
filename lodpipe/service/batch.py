"""`run`: many assets through one chain, one bad one not stopping the others."""

from __future__ import annotations

import dataclasses
import functools
import json
import os
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from lodpipe.config.model import Limits
from lodpipe.service import manifest
from lodpipe.service.chain import Config, Settings, load_chain
from lodpipe.service.discover import Found, find_assets
from lodpipe.service.index import Index
from lodpipe.service.job import REPORT, Job, Outcome, process
from lodpipe.service.pool import run_isolated
from lodpipe.service.publish import Output
from lodpipe.service.recipe import Recipe

Inputs = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]


class Listener(Protocol):
    """Told what happens while a batch runs."""

    def begin(self, total: int, steps: int) -> None:
        """`total` assets are about to go through a chain of `steps` stages."""

    def progress(self, place: str, index: int, name: str, share: float) -> None:
        """An asset is in the stage `name`, the `index`-th, of which a `share` is done."""

    def finished(self, outcome: Outcome) -> None:
        """An asset is through, or has failed."""


class Silent:
    """A listener that says nothing."""

    def begin(self, total: int, steps: int) -> None: ...
    def progress(self, place: str, index: int, name: str, share: float) -> None: ...
    def finished(self, outcome: Outcome) -> None: ...


@dataclass
class Batch:
    """What became of every asset of a run, in the order in which they ended."""

    outcomes: list[Outcome] = field(default_factory=list)

    @property
    def exit_code(self) -> int:
        """0 all fine, 1 an asset failed or is over budget, 3 a bug."""
        return max((outcome.exit_code for outcome in self.outcomes), default=0)

    @property
    def ok(self) -> bool:
        """Whether every asset was processed and is within its budgets."""
        return self.exit_code == 0


def run(
    inputs: Inputs,
    config: Config = "default",
    output: str | os.PathLike[str] = "out",
    *,
    settings: Settings = (),
    plugins: Iterable[str | Path] = (),
    workers: int = 1,
    force: bool = False,
    listener: Listener | None = None,
) -> Batch:
    """Make levels of detail of every asset that `inputs` (files, folders, globs) name, into `output`.

    `config` is a path, a preset's name or the configuration as a mapping; `settings` stand over it. An asset whose
    result is there already, from the same content and configuration, is skipped unless `force`. Several assets, or
    several `workers`, get a fresh process each; a single one is done in this process, unless limits of memory or time
    were set. Raises ConfigError; what is wrong with an asset is an outcome, not an exception.
    """
    listener = listener or Silent()
    settings, plugins = settings if isinstance(settings, Mapping) else tuple(settings), tuple(plugins)
    loaded = load_chain(config, settings, plugins)
    recipe = Recipe.loaded(loaded)
    batch = Batch()
    listed = [inputs] if isinstance(inputs, str | os.PathLike) else list(inputs)
    root = Path(output)
    found, problems = find_assets(listed, root)
    listener.begin(len(found) + len(problems), len(loaded.pipeline.steps))

    index = Index(root)

    def add(outcome: Outcome) -> None:
        batch.outcomes.append(outcome)
        listener.finished(outcome)
        if outcome.folder:
            index.changed()

    for problem in problems:
        add(Outcome(problem.place, "", "failed", "", str(problem)))
    if not found:
        return batch
    place = Output(root)
    place.sweep()
    jobs = []
    for asset in found:
        same = None if force else _published(asset, root, recipe)
        if same:
            place.forget_failure(asset.place)
            add(same)
        else:
            job = job_of(asset, root, recipe, max(1, min(workers, len(found))))
            command = _command(asset, root, config, settings, plugins)
            jobs.append(dataclasses.replace(job, command=command, fresh=force))
    try:
        for outcome in _done(jobs, workers, len(found) > 1, listener.progress):
            add(outcome)
    finally:
        index.settle()
    return batch


def _done(
    jobs: list[Job], workers: int, many: bool, progress: Callable[[str, int, str, float], None]
) -> Iterator[Outcome]:
    if many or workers > 1 or any(_limited(job) for job in jobs):
        yield from run_isolated(
            jobs, workers, lambda job, index, name, share: progress(str(job.place), index, name, share)
        )
        return
    for job in jobs:
        yield process(job, functools.partial(progress, str(job.place)))


def _limited(job: Job) -> bool:
    """Whether somebody cares about limits that only a process of its own can keep for sure."""
    defaults = Limits()
    return (job.limits.memory_gb, job.limits.minutes) != (defaults.memory_gb, defaults.minutes)


def job_of(asset: Found, root: Path, recipe: Recipe, workers: int) -> Job:
    """The job that makes an asset's result in the output folder `root`, `workers` of its kind at a time."""
    return Job(
        path=str(asset.path),
        folder=asset.folder,
        name=asset.name,
        output=str(root),
        config=recipe.config,
        plugins=recipe.plugins,
        threads=threads_for(recipe, workers),
    )


def threads_for(recipe: Recipe, workers: int) -> int:
    """Most threads for one asset when `workers` go side by side; 0 for all cores."""
    shared = max(1, (os.cpu_count() or 1) // workers) if workers > 1 else 0
    return int(recipe.config["threads"]) or shared


def _command(asset: Found, root: Path, config: Config, settings: Settings, plugins: Iterable[str | Path]) -> str:
    """A shell's line that does the same with `asset` again; empty for a configuration that is not in a file."""
    if isinstance(config, Mapping) or isinstance(settings, Mapping):
        return ""
    words = ["lodpipe", "run", str(asset.path), "-c", str(config), "-o", str(root)]
    words += [word for text in settings for word in ("--set", text)]
    words += [word for folder in plugins for word in ("--plugins", str(folder))]
    return shlex.join([*words, "--force"])


def _published(asset: Found, root: Path, recipe: Recipe) -> Outcome | None:
    """The outcome of an asset whose result is there already."""
    folder = root / asset.place
    if not manifest.current(folder, asset.path, recipe):
        return None
    report = json.loads((folder / REPORT).read_text(encoding="utf-8"))
    return Outcome(str(asset.path), str(asset.place), "unchanged", str(folder), report=report)
