"""`report`: how far each level is from the source, and how different it looks."""

from __future__ import annotations

import dataclasses
from typing import Annotated

from pydantic import Field

from lodpipe.core.asset import Asset
from lodpipe.geometry.compare import look_at_levels
from lodpipe.geometry.distance import measure_levels
from lodpipe.geometry.pictures import Setup
from lodpipe.geometry.switch import settle_switches
from lodpipe.geometry.texture import Textures
from lodpipe.io import pixels_of
from lodpipe.stage import Context, Params, stage


class ReportParams(Params):
    """Parameters of `report`."""

    samples: Annotated[int, Field(ge=100, le=10_000_000)] = 50_000
    """Points spread over each surface, in each of the two directions."""
    views: Annotated[int, Field(ge=0, le=1000)] = 6
    """Directions from which each level is compared with the source in pictures; 0: none."""
    size: Annotated[int, Field(ge=16, le=4096)] = 512
    """Pixels along a side of these pictures."""


@stage("report", version=2)
def report(asset: Asset, params: ReportParams, context: Context) -> Asset:
    """Measure each level against the source: distances in % of the diagonal, normals, and what is seen.

    The figures go into `Lod.error` and `Lod.visual`, from where report.json, budgets and `Lod.switch` take them. Stages
    that change levels belong before it.
    """
    if not asset.lods:
        return asset
    parts = 2 if params.views else 1
    figures = measure_levels(
        asset,
        samples=params.samples,
        seed=context.seed,
        threads=context.threads,
        progress=lambda done, total: context.progress(done, parts * total),
    )
    for number, figure in enumerate(figures):
        if figure is None:
            context.warn(f"level {number} has no triangles, so its distance to the source cannot be measured")
    levels = [dataclasses.replace(level, error=figure) for level, figure in zip(asset.lods, figures, strict=True)]
    if params.views:
        seen = look_at_levels(
            asset,
            lambda shown: Textures(pixels_of(shown, context.warn)),
            Setup(views=params.views, size=params.size),
            threads=context.threads,
            cache=context.cache,
            progress=lambda done, total: context.progress(total + done, 2 * total),
        )
        levels = [dataclasses.replace(level, visual=figure) for level, figure in zip(levels, seen, strict=True)]
    return settle_switches(dataclasses.replace(asset, lods=tuple(levels)))
