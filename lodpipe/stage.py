"""The stage protocol: what a stage is given, what it may do, and the decorator that names it.

The contract, stated once. The input asset is never changed (dataclasses are frozen, arrays read-only): a stage
returns a new one. No clock, environment, network or global state; files are read by `lodpipe.io` before the chain
and written by the `export` stage alone, into `Context.output`. Same asset, params and seed give the same bytes.
Wrong input raises `InvalidMesh`; a target that cannot be reached is a recorded stop reason, not an exception.
Time, progress and error places are the runner's business.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar, cast, get_type_hints

import numpy as np
from pydantic import BaseModel, ConfigDict

from lodpipe.core.asset import Asset, Target
from lodpipe.core.cache import Cache
from lodpipe.core.errors import Cancelled
from lodpipe.core.page import Page
from lodpipe.core.report import Measurement


class Params(BaseModel):
    """Parameters of a stage: frozen, and unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


class Progress(Protocol):
    """Called with how much is done, out of how much."""

    def __call__(self, done: float, total: float) -> None: ...


@dataclass
class Context:
    """What a stage may use besides its asset and its params."""

    lods: tuple[Target, ...] = ()
    """The levels that the configuration asks for, level 0 (the source) left out."""
    seed: int = 0
    threads: int = 0
    """Upper bound on threads, 0 for all cores; results never depend on it."""
    output: Path | None = None
    """The folder in which this asset's files are built; renamed into place when the chain has ended."""
    scratch: Path | None = None
    log: logging.Logger = field(default_factory=lambda: logging.getLogger("lodpipe"))
    progress: Progress = lambda done, total: None
    cancelled: Callable[[], bool] = lambda: False
    cache: Cache = field(default_factory=Cache)
    """What stages of this run can use again: reference pictures, search structures."""
    measurements: list[Measurement] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    files: dict[int, list[Path]] = field(default_factory=dict)
    """Files written for each level, relative to `output`; key −1: files of the asset as a whole."""
    page: Page | None = None
    """Material of report.html, if this stage has made it."""

    @property
    def rng(self) -> np.random.Generator:
        """A new generator, the same at every call for the same seed."""
        return np.random.default_rng(self.seed)

    def record(self, name: str, value: float | int | str, unit: str = "") -> None:
        """Put a figure into this stage's part of the report."""
        self.measurements.append(Measurement(name, value, unit))

    def warn(self, text: str) -> None:
        """Put a warning into this stage's part of the report, once."""
        if text not in self.warnings:
            self.warnings.append(text)
            self.log.warning(text)

    def check_cancelled(self) -> None:
        """Raise Cancelled if the work should stop."""
        if self.cancelled():
            raise Cancelled("cancelled")


P = TypeVar("P", bound=Params)
StageFunction = Callable[[Asset, P, Context], Asset]


@dataclass(frozen=True)
class Stage(Generic[P]):
    """A named stage; calling it calls the function as it was written."""

    name: str
    params: type[P]
    function: StageFunction[P]
    version: int = 1
    """Raised whenever the same input would give other output: cached results of older versions are not used."""
    origin: str = "built in"
    """Where it comes from: built in, an entry point's distribution, or a plug-in's file."""

    def __call__(self, asset: Asset, params: P, context: Context) -> Asset:
        return self.function(asset, params, context)

    @property
    def summary(self) -> str:
        """First line of the function's docstring."""
        return (self.function.__doc__ or "").strip().partition("\n")[0]


AnyStage = Stage[Any]


def stage(name: str, *, version: int = 1) -> Callable[[StageFunction[P]], Stage[P]]:
    """Make a `Stage` of ``(asset, params, context) -> asset``; the params type comes from its annotation."""

    def decorate(function: StageFunction[P]) -> Stage[P]:
        params = get_type_hints(function)["params"]
        return Stage(name=name, params=cast("type[P]", params), function=function, version=version)

    return decorate
