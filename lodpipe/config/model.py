"""What a configuration may say besides its stages' own parameters. Each default stands here and nowhere else."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from lodpipe.config.watch import Cache, Part, Watch
from lodpipe.core.asset import Target
from lodpipe.io.limits import DEFAULT as READER

Percent = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=1)]


class Level(Part):
    """One level below the source: what it may have, how far it may be off, or what may be seen of that. Exactly one of
    ratio, triangles, error, and pixels with screen."""

    ratio: Annotated[float, Field(gt=0, le=1)] | None = None
    """Share of the source's triangles."""
    triangles: Count | None = None
    """Number of triangles."""
    error: Percent | None = None
    """Largest distance to the source, in % of its bounding-box diagonal."""

    pixels: Annotated[float, Field(gt=0)] | None = None
    """With `screen`: pixels of difference that may be seen, on a screen of 1080 lines."""
    screen: Annotated[float, Field(gt=0, le=1)] | None = None
    """With `pixels`: share of the screen's height that the model's diagonal takes up."""

    @model_validator(mode="after")
    def _one_target(self) -> Level:
        given = {name for name in type(self).model_fields if getattr(self, name) is not None}
        if (len(given) != 1 and given != {"pixels", "screen"}) or given in ({"pixels"}, {"screen"}):
            names = ", ".join(sorted(given)) or "none"
            raise ValueError(f"must have exactly one of ratio, triangles, error, or pixels and screen (got {names})")
        return self

    @property
    def unseen_height(self) -> float | None:
        """Share of the screen's height up to which less than a pixel may be seen; None for other targets."""
        return None if self.pixels is None or self.screen is None else self.screen / self.pixels

    def target(self) -> Target:
        """The same for stages."""
        return Target(self.ratio, self.triangles, self.error, self.pixels, self.screen)


class Limits(Part):
    """What one asset may need at most; beyond it the asset fails with a clear line."""

    triangles: Count = READER.triangles
    """Triangles in the source."""
    texture_pixels: Count = READER.texture_pixels
    """Pixels of one texture."""
    input_bytes: Count = READER.input_bytes
    """Bytes of all files of one asset."""
    output_bytes: Count = 16 << 30
    """Bytes of all that is written for one asset."""
    memory_gb: Annotated[float, Field(gt=0)] = 8.0
    """Memory for the work on one asset, in GB."""
    minutes: Annotated[float, Field(gt=0)] = 30.0
    """Wall-clock time for one asset."""


class LevelBudget(Part):
    """What one level may have; figures that are left out are not checked."""

    triangles: Count | None = None
    """Triangles."""
    vertices: Count | None = None
    """Vertices, as a GPU sees them."""
    bytes: Count | None = None
    """Size of the level's files, all formats together."""
    mean_error: Percent | None = None
    """Mean distance to the source, in % of its bounding-box diagonal."""
    rms_error: Percent | None = None
    """Root mean square of the distance, same unit."""
    max_error: Percent | None = None
    """Largest (Hausdorff) distance, same unit."""


class Budgets(Part):
    """Pass or fail: an asset over one of these is still written, but its outcome is `over_budget` (exit code 1)."""

    bytes: Count | None = None
    """Size of all the asset's model and texture files together."""
    levels: dict[Annotated[int, Field(ge=0)], LevelBudget] = Field(default_factory=dict)
    """By the level's number, 0 being the source."""


class Config(Part):
    """A whole configuration (chain)."""

    version: Literal[1] = 1
    """Version of this file format."""
    lods: tuple[Level, ...] = ()
    """The levels to make, from fine to coarse. Level 0, the source, is always there and not listed."""
    stages: Annotated[tuple[Any, ...], Field(min_length=1)]
    """The steps, in order: a stage's name, or its name and parameters."""
    limits: Limits = Limits()
    budgets: Budgets = Budgets()
    watch: Watch = Watch()
    cache: Cache = Cache()
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Start of everything random: same seed, same bytes."""
    threads: Annotated[int, Field(ge=0)] = 0
    """Most threads to use for one asset, 0 for all cores. The result does not depend on it."""
    plugins: tuple[str, ...] = ()
    """Folders of plug-in files, relative to this file. A folder `plugins` beside it is found without this."""

    @field_validator("lods")
    @classmethod
    def _fine_to_coarse(cls, lods: tuple[Level, ...]) -> tuple[Level, ...]:
        for kind, sign in (("ratio", -1), ("triangles", -1), ("error", 1), ("unseen_height", -1)):
            values = [getattr(level, kind) for level in lods if getattr(level, kind) is not None]
            for before, after in pairwise(values):
                if sign * (after - before) <= 0:
                    name = "screen / pixels" if kind == "unseen_height" else kind
                    raise ValueError(f"levels must go from fine to coarse ({name} {after:g} follows {before:g})")
        return lods

    def targets(self) -> tuple[Target, ...]:
        """What each level below the source was asked for."""
        return tuple(level.target() for level in self.lods)
