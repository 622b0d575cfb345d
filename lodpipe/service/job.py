"""One asset from file to published folder. A job is plain data: the process that does it binds the functions itself."""

from __future__ import annotations

import dataclasses
import errno
import json
import logging
import platform
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path, PurePosixPath
from typing import Any

from lodpipe import io
from lodpipe.config.model import Limits
from lodpipe.config.source import Source
from lodpipe.core.asset import Asset
from lodpipe.core.errors import LimitError, LodpipeError, OutputError
from lodpipe.core.report import SCHEMA_VERSION, Report
from lodpipe.pipeline import Pipeline, StageFailed
from lodpipe.plugins import find_stages
from lodpipe.reporting.page import write_page
from lodpipe.reporting.report_json import dump_report, report_data
from lodpipe.service import manifest
from lodpipe.service.memory import memory_limit, peak_memory_mb
from lodpipe.service.publish import FAILED, Output
from lodpipe.service.reasons import reasons
from lodpipe.service.recipe import Recipe
from lodpipe.service.results import FOLDER as RESULTS
from lodpipe.service.results import StageResults

REPORT = "report.json"
LOG = "lodpipe.log"
BUG_ADVICE = "this is a bug in lodpipe or a plug-in, please report it with the log in {folder}"

INPUT, AGAIN, PASSING = "input", "again", "passing"
"""Natures of failures: the input's (the same every time), a crash or a limit of time or memory (worth another try),
and trouble of the machine that goes away by itself (no space, busy, a share that is gone)."""

_PASSING_ERRORS = """ENOSPC EDQUOT EBUSY EIO ESTALE EAGAIN EMFILE ENFILE ETXTBSY ETIMEDOUT ENOTCONN EHOSTDOWN
    EHOSTUNREACH ENETDOWN ENETUNREACH EREMOTEIO ENOLCK EROFS"""
PASSING_ERRORS = frozenset(getattr(errno, name) for name in _PASSING_ERRORS.split() if hasattr(errno, name))
RIGHTS = frozenset((errno.EACCES, errno.EPERM))
"""Where results go, these are the machine's fault, not the asset's."""

JobProgress = Callable[[int, str, float], None]
"""Called with the number of stages begun, the name of what is being done, and the share of it that is done."""


@dataclass(frozen=True)
class Job:
    """What a worker needs to know."""

    path: str
    folder: str
    name: str
    output: str
    config: dict[str, Any]
    """The resolved configuration."""
    plugins: tuple[str, ...] = ()
    threads: int = 0
    command: str = ""
    """What a shell needs to do the same again; for the report."""
    read_from: str = ""
    """A copy of the input that is read in its place, while messages tell of `path`."""
    fresh: bool = False
    """Whether results of stages that were kept from earlier runs must not be used."""
    records: tuple[str, ...] = (INPUT, AGAIN, PASSING)
    """Natures of failures that leave a record in `.failed`; the others are told to the caller alone."""

    @classmethod
    def from_data(cls, data: dict[str, Any]) -> Job:
        """The job that `dataclasses.asdict` has made plain data of, JSON included."""
        return cls(**data | {"plugins": tuple(data["plugins"]), "records": tuple(data["records"])})

    @property
    def place(self) -> PurePosixPath:
        """Where the result goes, relative to the output folder."""
        return PurePosixPath(self.folder, self.name)

    @property
    def limits(self) -> Limits:
        """The limits in the configuration."""
        return Limits.model_validate(self.config.get("limits", {}))


@dataclass
class Outcome:
    """What became of a job; plain data."""

    input: str
    place: str
    outcome: str
    """ok, warnings, over_budget, unchanged, failed or bug."""
    folder: str
    """The published folder; of a failed job, the folder with its error.json."""
    message: str = ""
    """One line, of a failed job."""
    seconds: float = 0.0
    nature: str = ""
    """Of a failed job: INPUT, AGAIN or PASSING."""
    report: dict[str, Any] | None = field(default=None, repr=False)

    @property
    def exit_code(self) -> int:
        """0 fine, 1 the asset's or user's fault, 3 a bug."""
        if self.outcome == "bug":
            return 3
        over = self.outcome == "over_budget" or (self.report or {}).get("outcome") == "over_budget"
        return 1 if over or self.outcome == "failed" else 0


def process(job: Job, progress: JobProgress = lambda index, name, share: None) -> Outcome:
    """Do a job: read, lead through the chain, report, publish. Failures are outcomes, with a record in `.failed`.

    Only KeyboardInterrupt, and a failure to write the record itself (OutputError), come out as exceptions.
    """
    begin = time.monotonic()
    limits = job.limits
    deadline = begin + limits.minutes * 60

    def in_time(index: int, name: str, share: float) -> None:
        if time.monotonic() > deadline:
            raise TooSlow(**too_slow(limits.minutes))
        progress(index, name, share)

    output = Output(Path(job.output))
    report = Report(job.name, input=job.path, command=job.command)
    with output.workspace() as workspace:
        built = workspace / "built"
        built.mkdir()
        log, handler = _log_file(built / LOG)
        try:
            with memory_limit(limits.memory_gb):
                folder = _build(job, output, built, report, in_time, log, handler, begin)
            outcome = Outcome(job.path, str(job.place), report.outcome, str(folder))
        except Exception as error:  # every cause is told apart, recorded and reported in _failure
            failure = Failure.of(job, report, error)
            log.error("%s", failure.message)
            if failure.bug:
                log.error("%s", "".join(traceback.format_exception(error)))
            handler.close()
            report.seconds = time.monotonic() - begin
            outcome = fail(job, output, failure, report, built / LOG)
        finally:
            handler.close()
    outcome.seconds = report.seconds = time.monotonic() - begin
    outcome.report = report_data(report)
    return outcome


def fail(job: Job, output: Output, failure: Failure, report: Report | None = None, log: Path | None = None) -> Outcome:
    """Leave a record of a failure in the output folder, unless the job is not to."""
    report = report or Report(job.name, input=job.path)
    report.outcome, report.error = "failed", failure.data()
    word = "bug" if failure.bug else "failed"
    if failure.nature not in job.records:
        return Outcome(job.path, str(job.place), word, "", failure.message, nature=failure.nature)
    record = {"schema_version": SCHEMA_VERSION, "asset": job.name, "input": job.path, **failure.data()}
    with output.workspace() as workspace:
        path = workspace / REPORT
        dump_report(report, path)
        files = [path, *([log] if log else [])]
        folder = output.fail(job.place, record, files, Path(job.path))
    return Outcome(job.path, str(job.place), word, str(folder), failure.message, nature=failure.nature)


def published_outcome(job: Job) -> Outcome:
    """The outcome of a job that has published its result and could not say so any more."""
    folder = Path(job.output) / job.place
    try:
        report = json.loads((folder / REPORT).read_text(encoding="utf-8"))
        return Outcome(job.path, str(job.place), report["outcome"], str(folder), "", report["seconds"], report=report)
    except (OSError, ValueError, KeyError, TypeError):  # the chain makes no report, or another one
        return Outcome(job.path, str(job.place), "ok", str(folder))


@dataclass(frozen=True)
class Failure:
    """Why a job failed, for people and programs."""

    stage: str
    cause: str
    place: str
    advice: str
    kind: str
    bug: bool = False
    nature: str = INPUT

    @classmethod
    def of(cls, job: Job, report: Report, error: Exception) -> Failure:
        """What an exception means. `report` tells how far the job got."""
        stage = report.stages[-1].name if report.stages else "load"
        if isinstance(error, StageFailed) and isinstance(error.error, MemoryError | RecursionError):
            error = error.error if isinstance(error.error, MemoryError) else error
        if isinstance(error, MemoryError):
            error = LimitError(**too_big(job.limits.memory_gb))
            return cls(stage, error.cause, f"{job.path}: {stage}", error.advice, "LimitError", nature=AGAIN)
        if isinstance(error, LodpipeError):
            inside = error.place
            for name in (Path(job.path).name, job.name):  # the path says it, and says it better
                inside = "" if inside == name else inside.removeprefix(f"{name}: ")
            place = f"{job.path}: {inside}" if inside else job.path
            kind = "LimitError" if isinstance(error, LimitError) else type(error).__name__
            return cls(stage, error.cause, place, error.advice, kind, nature=nature_of(error))
        inner = error.error if isinstance(error, StageFailed) else error
        folder = Path(job.output) / FAILED / job.place
        cause = f"internal error: {type(inner).__name__}: {inner}"
        advice = BUG_ADVICE.format(folder=folder)
        nature = PASSING if nature_of(inner) == PASSING else AGAIN
        return cls(stage, cause, f"{job.path}: {stage}", advice, type(inner).__name__, bug=True, nature=nature)

    @property
    def message(self) -> str:
        """One line."""
        return str(LodpipeError(self.cause, place=self.place, advice=self.advice))

    def data(self) -> dict[str, str]:
        """For error.json and report.json."""
        return {name: str(value) for name, value in dataclasses.asdict(self).items() if name not in ("bug", "nature")}


class TooSlow(LimitError):
    """A job over its time."""


def nature_of(error: BaseException | None) -> str:
    """The nature of a failure, from the exception and what lies behind it."""
    if isinstance(error, TooSlow):
        return AGAIN
    seen: list[BaseException] = []
    passing = PASSING_ERRORS | RIGHTS if isinstance(error, OutputError) else PASSING_ERRORS
    while error is not None and error not in seen:  # `raise error from error` makes a circle
        if isinstance(error, OSError) and error.errno in passing:
            return PASSING
        seen.append(error)
        error = error.__cause__ or error.__context__
    return INPUT


def too_slow(minutes: float) -> dict[str, str]:
    """Cause and advice of a job over its time."""
    cause = f"took longer than the limit of {minutes:g} minutes"
    return {"cause": cause, "advice": "raise limits.minutes, or simplify the model first"}


def too_big(memory_gb: float) -> dict[str, str]:
    """Cause and advice of a job over its memory."""
    cause = f"needs more memory than the limit of {memory_gb:g} GB"
    return {"cause": cause, "advice": "raise limits.memory_gb, or split the model"}


def versions() -> dict[str, str]:
    """Versions of what a result depends on."""
    found = {"python": platform.python_version()}
    for package in ("lodpipe", "numpy", "open3d", "open3d-cpu"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def _build(
    job: Job,
    output: Output,
    built: Path,
    report: Report,
    progress: JobProgress,
    log: logging.Logger,
    handler: logging.Handler,
    begin: float,
) -> Path:
    output.check_place(job.place)
    stages = find_stages(Path(folder) for folder in job.plugins)
    pipeline = Pipeline.load(Source("config", job.config), stages)
    report.versions = versions()
    progress(0, "load", 0.0)
    read = _load(job, pipeline, log)
    scratch = built.parent / "scratch"
    scratch.mkdir()
    recipe = Recipe.of(pipeline)
    inputs = manifest.inputs_of(read)
    again = reasons(manifest.read(output.root / job.place), inputs, recipe)
    run = dataclasses.replace(pipeline, config=pipeline.config.model_copy(update={"threads": job.threads}))
    run.run(
        read,
        built,
        scratch=scratch,
        progress=lambda index, name, share: progress(index + 1, name, share),
        log=log,
        report=report,
        results=_results(job, output, recipe, [read.name, inputs, sorted(read.missing)]),
    )
    for part, reason in zip(report.stages, again, strict=True):
        part.reason = "" if part.kept else reason
        if part.reason:
            log.info("%s ran again: %s", part.name, part.reason)
    progress(len(pipeline.steps), "publish", 0.0)
    log.info("outcome: %s", report.outcome)
    handler.close()
    report.seconds = time.monotonic() - begin
    report.peak_memory_mb = peak_memory_mb()
    write_page(report, built)
    dump_report(report, built / REPORT)
    _check_size(built, pipeline.config.limits.output_bytes)
    manifest.write(built, read, recipe, str(job.place), report.outcome, report.versions)
    return output.publish(built, job.place)


def _results(job: Job, output: Output, recipe: Recipe, origin: list[Any]) -> StageResults | None:
    cache = recipe.config["cache"]
    limit = int(cache["gb"] * 1e9)
    if not limit:
        return None
    return StageResults(output.state / RESULTS, limit, cache["min_seconds"], origin, recipe.stages, fresh=job.fresh)


def _load(job: Job, pipeline: Pipeline, log: logging.Logger) -> Asset:
    limits = pipeline.config.limits
    bounds = io.Limits(triangles=limits.triangles, texture_pixels=limits.texture_pixels, input_bytes=limits.input_bytes)
    log.info("load: %s", job.path)
    asset = dataclasses.replace(io.load(Path(job.read_from or job.path), bounds), name=job.name, path=Path(job.path))
    for warning in asset.warnings:
        log.warning("load: %s", warning)
    log.info("load: %s triangles, %s vertices", asset.triangles, asset.vertices)
    return asset


def _check_size(folder: Path, limit: int) -> None:
    total = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    if total > limit:
        raise LimitError(
            f"the result has {total:,} bytes, more than the limit of {limit:,}",
            advice="raise limits.output_bytes, or ask for fewer levels or formats",
        )


def _log_file(path: Path) -> tuple[logging.Logger, logging.FileHandler]:
    """A logger of this job's own, known to nobody else, and its file."""
    handler = logging.FileHandler(path, encoding="utf-8", errors="backslashreplace")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    log = logging.Logger("lodpipe", logging.INFO)
    log.addHandler(handler)
    return log, handler
