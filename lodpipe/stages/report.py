"""`report`: how far each level is from the source."""

from __future__ import annotations

import dataclasses
from typing import Annotated

from pydantic import Field

from lodpipe.core.asset import Asset
from lodpipe.geometry.distance import measure_levels
from lodpipe.geometry.switch import settle_switches
from lodpipe.stage import Context, Params, stage


class ReportParams(Params):
    """Parameters of `report`."""

    samples: Annotated[int, Field(ge=100, le=10_000_000)] = 50_000
    """Points spread over each surface, in each of the two directions."""


@stage("report")
def report(asset: Asset, params: ReportParams, context: Context) -> Asset:
    """Measure each level against the source: mean, RMS and largest distance in % of the diagonal, normals.

    The figures go into `Lod.error`, from where report.json, budgets and `Lod.switch` take them. Stages that change
    levels belong before it.
    """
    if not asset.lods:
        return asset
    figures = measure_levels(
        asset, samples=params.samples, seed=context.seed, threads=context.threads, progress=context.progress
    )
    for number, figure in enumerate(figures):
        if figure is None:
            context.warn(f"level {number} has no triangles, so its distance to the source cannot be measured")
    levels = [dataclasses.replace(level, error=figure) for level, figure in zip(asset.lods, figures, strict=True)]
    return settle_switches(dataclasses.replace(asset, lods=tuple(levels)))
