"""What a run did, as plain data: the runner fills it in, `lodpipe.reporting` shows it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from lodpipe.core.page import Page

SCHEMA_VERSION = 1


@dataclass(frozen=True)
class Measurement:
    """One figure that a stage recorded."""

    name: str
    value: float | int | str
    unit: str = ""


@dataclass
class StageReport:
    """One stage's part: what it was told, how long it took, what it measured and what it warned of."""

    name: str
    params: dict[str, Any] = field(default_factory=dict)
    seconds: float = 0.0
    measurements: list[Measurement] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    kept: bool = False
    """Whether its result was taken from an earlier run; `seconds` are of that one."""
    reason: str = ""
    """Why it ran, where an earlier run's result was there to compare with."""


@dataclass
class LevelReport:
    """One level as `report.json` lists it; docs/output.md lists the fields."""

    level: int
    triangles: int
    vertices: int
    stop_reason: str
    target: dict[str, Any] | None = None
    files: list[str] = field(default_factory=list)
    bytes: int = 0
    error: dict[str, Any] | None = None
    visual: dict[str, Any] | None = None
    switch: dict[str, Any] | None = None
    gpu: dict[str, Any] | None = None


@dataclass
class Report:
    """A whole run over one asset."""

    asset: str
    outcome: str = "ok"
    """ok, warnings, over_budget or failed."""
    input: str = ""
    """The source file as it was named."""
    source: dict[str, Any] = field(default_factory=dict)
    stages: list[StageReport] = field(default_factory=list)
    lods: list[LevelReport] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    files: list[str] = field(default_factory=list)
    """Files of the asset as a whole (all levels in one), relative to its folder."""
    budgets: list[dict[str, Any]] = field(default_factory=list)
    """Each figure that has a budget: level (None: the asset), figure, limit, value, ok."""
    error: dict[str, str] | None = None
    """Of a failed run: stage, cause, place, advice."""
    seconds: float = 0.0
    peak_memory_mb: float | None = None
    versions: dict[str, str] = field(default_factory=dict)
    command: str = ""
    """What does the same again, for a shell; empty if a program asked for it."""
    config: dict[str, Any] = field(default_factory=dict, repr=False)
    """The resolved configuration."""
    images: list[str] = field(default_factory=list)
    """Pictures of the levels, relative to its folder."""
    page: Page | None = field(default=None, repr=False)
    """Material of report.html, which report.json leaves out; None without the stage `report`."""
