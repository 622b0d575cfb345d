"""A chain of stages, and the runner that leads an asset through it: it times, records and says where an error was."""

from __future__ import annotations

import dataclasses
import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from lodpipe.config.load import Step, bind, resolved
from lodpipe.config.model import Budgets, Config
from lodpipe.config.source import Source
from lodpipe.core.asset import Asset, Lod
from lodpipe.core.cache import Cache
from lodpipe.core.errors import LodpipeError
from lodpipe.core.page import Page
from lodpipe.core.report import LevelReport, Measurement, Report, StageReport
from lodpipe.stage import AnyStage, Context, Progress

StageProgress = Callable[[int, str, float], None]
"""Called with the step's index, its stage's name, and the share of it that is done, 0…1."""

_ERROR_FIGURES = {"mean_error": "mean", "rms_error": "rms", "max_error": "max"}


@dataclass(frozen=True)
class Pipeline:
    """A configuration whose stages have been found and whose parameters have been checked."""

    config: Config
    steps: tuple[Step, ...]

    @classmethod
    def load(cls, source: Source, known_stages: Mapping[str, AnyStage]) -> Pipeline:
        """The configuration in `source`; raises ConfigErrors with a line for each problem."""
        return cls(*bind(source, known_stages))

    def _params(self) -> list[dict[str, Any]]:
        return [step.params.model_dump(mode="json") for step in self.steps]

    def resolved(self) -> dict[str, Any]:
        """All of it as plain data, defaults included; a Source of it loads to the same pipeline."""
        return resolved(self.config)

    def run(
        self,
        asset: Asset,
        output: Path | None = None,
        *,
        scratch: Path | None = None,
        progress: StageProgress = lambda index, name, share: None,
        cancelled: Callable[[], bool] = lambda: False,
        log: logging.Logger | None = None,
        report: Report | None = None,
        results: Results | None = None,
    ) -> tuple[Asset, Report]:
        """Lead `asset` through the chain; the new asset, and what happened.

        `output` is the folder that `export` writes into. A `report` that is given is filled in as the stages end,
        so that its owner has what there is when one of them raises. Stages whose result `results` has are not run
        again. LodpipeErrors come with the asset's and the
        stage's name as their place; `StageFailed` wraps any other exception, which is a bug.
        """
        report = report or Report(asset.name)
        report.asset, report.input = asset.name, str(asset.path or "")
        report.source = describe(asset)
        report.warnings.extend(asset.warnings)
        report.config = self.resolved()
        log = log or logging.getLogger("lodpipe")
        files: dict[int, list[Path]] = {}
        cache = Cache()
        begin_at = 0
        if results and (kept := results.find(self._params(), _values(self.config))):
            asset = dataclasses.replace(kept.asset, path=asset.path, members=asset.members)
            report.page = kept.page
            report.stages += [_kept_part(data) for data in kept.parts]
            begin_at = kept.index + 1
            log.info("kept from an earlier run: %s", ", ".join(part.name for part in report.stages))
        for index, step in enumerate(self.steps[begin_at:], begin_at):
            part = StageReport(step.stage.name, params=step.params.model_dump(mode="json"))
            report.stages.append(part)
            context = _Noticing(
                lods=self.config.targets(),
                seed=self.config.seed,
                threads=self.config.threads,
                output=output,
                scratch=scratch,
                log=log,
                progress=_of_stage(progress, index, step.stage.name),
                cancelled=cancelled,
                cache=cache,
                measurements=part.measurements,
                warnings=part.warnings,
                files=files,
            )
            context.check_cancelled()
            log.info("%s: start", step.stage.name)
            progress(index, step.stage.name, 0.0)
            begin = time.perf_counter()
            try:
                asset = step.stage(asset, step.params, context)
            except LodpipeError as error:
                raise error.at(f"{asset.name}: {step.stage.name}") from error
            except Exception as error:  # known to the runner as a bug, never swallowed
                raise StageFailed(asset.name, step.stage.name, error) from error
            finally:
                part.seconds = time.perf_counter() - begin
            report.page = context.page or report.page
            if results and files:
                results.stop()
            elif results:
                values = {name: value for name, value in _values(self.config).items() if name in context.used}
                results.keep(index, part.params, asset, report.page, dataclasses.asdict(part), values)
            progress(index, step.stage.name, 1.0)
            log.info("%s: done in %.2f s", step.stage.name, part.seconds)
        _finish(report, asset, output, files, self.config.budgets)
        return asset, report


@dataclass(frozen=True)
class Kept:
    """The result of the stages up to `index`, from an earlier run."""

    index: int
    asset: Asset
    page: Page | None
    parts: list[dict[str, Any]]
    """`StageReport` of each of them, as plain data."""


class Results(Protocol):
    """Keeps results of stages from run to run; lodpipe.service.results has the rules."""

    def find(self, chain: list[dict[str, Any]], values: dict[str, Any]) -> Kept | None:
        """The result of as many stages as possible of a `chain` (the params of each) under these `values`."""

    def keep(
        self,
        index: int,
        params: dict[str, Any],
        asset: Asset,
        page: Page | None,
        part: dict[str, Any],
        used: dict[str, Any],
    ) -> None:
        """A stage has run; `used` has the values that it has looked at."""

    def stop(self) -> None:
        """A stage has written files: neither it nor what follows can be kept."""


class _Noticing(Context):
    """A context that notices at which values of the configuration a stage looks."""

    def __getattribute__(self, name: str) -> Any:
        if name in ("lods", "seed"):
            self.__dict__.setdefault("_used", set()).add(name)
        return super().__getattribute__(name)

    @property
    def used(self) -> set[str]:
        """Names of the values."""
        found: set[str] = self.__dict__.get("_used", set())
        return found


def _values(config: Config) -> dict[str, Any]:
    """What a stage may look at besides its params, as plain data."""
    return {"lods": [dataclasses.asdict(target) for target in config.targets()], "seed": config.seed}


def _kept_part(data: dict[str, Any]) -> StageReport:
    measurements = [Measurement(**entry) for entry in data["measurements"]]
    return StageReport(**data | {"measurements": measurements, "kept": True})


class StageFailed(Exception):
    """A stage raised something that is nobody's input: a bug in it, or memory that ran out."""

    def __init__(self, asset: str, stage: str, error: BaseException) -> None:
        super().__init__(f"{asset}: {stage}: {type(error).__name__}: {error}")
        self.asset, self.stage, self.error = asset, stage, error


def describe(asset: Asset) -> dict[str, Any]:
    """What the report says of a source: counts, format, the files that it came from."""
    return {
        "file": str(asset.path or ""),
        "format": asset.format,
        "triangles": asset.triangles,
        "vertices": asset.vertices,
        "meshes": len(asset.meshes),
        "instances": len(asset.instances()),
        "materials": len(asset.materials),
        "textures": len(asset.images),
        "animations": len(asset.document.get("animations", ())),
        "skins": len(asset.document.get("skins", ())),
        "files": [path.name for path in asset.members],
    }


def _of_stage(progress: StageProgress, index: int, name: str) -> Progress:
    def report(done: float, total: float) -> None:
        progress(index, name, min(1.0, done / total) if total > 0 else 0.0)

    return report


def _finish(report: Report, asset: Asset, output: Path | None, files: dict[int, list[Path]], budgets: Budgets) -> None:
    levels = asset.lods or (Lod(asset.meshes),)
    report.lods = [_level(number, level, files.get(number, []), output) for number, level in enumerate(levels)]
    report.files = [path.as_posix() for path in files.get(-1, ())]
    report.budgets = _check(budgets, report, _bytes(output, [path for paths in files.values() for path in paths]))
    if not all(entry["ok"] for entry in report.budgets):
        report.outcome = "over_budget"
    elif report.warnings or any(part.warnings for part in report.stages):
        report.outcome = "warnings"


def _level(number: int, level: Lod, files: list[Path], output: Path | None) -> LevelReport:
    target = dataclasses.asdict(level.target) if level.target else {}
    part = LevelReport(
        level=number,
        triangles=level.triangles,
        vertices=level.vertices,
        stop_reason=level.stop_reason,
        target={name: value for name, value in target.items() if value is not None} or None,
        files=[path.as_posix() for path in files],
        bytes=_bytes(output, files),
        switch=dataclasses.asdict(level.switch) if level.switch else None,
        gpu=dataclasses.asdict(level.gpu) if level.gpu else None,
    )
    if level.error:
        part.error = {"unit": "percent_of_diagonal", **dataclasses.asdict(level.error)}
    if level.visual:
        part.visual = level.visual.data()
    return part


def _bytes(output: Path | None, files: list[Path]) -> int:
    """Size on disk; a file that two levels share counts once."""
    return sum((output / path).stat().st_size for path in dict.fromkeys(files)) if output else 0


def _check(budgets: Budgets, report: Report, total: int) -> list[dict[str, Any]]:
    """Every figure that has a budget; one that was not measured, or a level that is not there, is not ok."""
    entries: list[dict[str, Any]] = []

    def add(level: int | None, figure: str, limit: float, value: float | None, reason: str) -> None:
        ok = value is not None and value <= limit
        entry = {"level": level, "figure": figure, "limit": limit, "value": value, "ok": ok}
        entries.append(entry if value is not None else entry | {"value_reason": reason})

    if budgets.bytes is not None:
        add(None, "bytes", budgets.bytes, total, "")
    levels = {part.level: part for part in report.lods}
    for number, budget in sorted(budgets.levels.items()):
        part = levels.get(number)
        for figure, limit in budget.model_dump(exclude_none=True).items():
            if part is None:
                add(number, figure, limit, None, f"there is no level {number}")
            elif figure in _ERROR_FIGURES:
                value = (part.error or {}).get(_ERROR_FIGURES[figure])
                add(number, figure, limit, value, "not measured: the chain has no `report` stage")
            else:
                add(number, figure, limit, getattr(part, figure), "")
    return entries
