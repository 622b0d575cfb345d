"""`report`: how far each level is from the source, and how different it looks."""

from __future__ import annotations

import dataclasses
from typing import Annotated

from pydantic import Field

from lodpipe.core.asset import Asset, VisualFigures
from lodpipe.geometry.compare import look_at_levels
from lodpipe.geometry.distance import measure_levels
from lodpipe.geometry.gpu import gpu_size
from lodpipe.geometry.pictures import Setup
from lodpipe.geometry.switch import settle_switches
from lodpipe.stage import Context, Params, stage
from lodpipe.stages._page import Images, collect


class ReportParams(Params):
    """Parameters of `report`."""

    samples: Annotated[int, Field(ge=100, le=10_000_000)] = 50_000
    """Points spread over each surface, in each of the two directions."""
    views: Annotated[int, Field(ge=0, le=1000)] = 6
    """Directions from which each level is compared with the source in pictures; 0: none."""
    size: Annotated[int, Field(ge=16, le=4096)] = 512
    """Pixels along a side of these pictures."""
    pictures: Annotated[int, Field(ge=0, le=6)] = 2
    """Directions from which report.html shows each level beside the source."""
    models: bool = True
    """Put 3-D models into report.html."""
    texture_size: Annotated[int, Field(ge=16, le=4096)] = 1024
    """Longer side of the textures in these models, in pixels, at most."""


@stage("report", version=3)
def report(asset: Asset, params: ReportParams, context: Context) -> Asset:
    """Measure each level against the source: distances in % of the diagonal, normals, and what is seen.

    The material of report.html is put aside as well (`Context.page`); the job writes it when the chain has ended.
    The figures go into `Lod.error` and `Lod.visual`, from where report.json, budgets and `Lod.switch` take them. Stages
    that change levels belong before it.
    """
    if not asset.lods:
        return asset
    parts = 3 if params.views else 2  # the last is the page
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
    images = Images(params.texture_size, context.warn)
    seen: list[VisualFigures | None] = [None] * len(asset.lods)
    if params.views:
        seen[:] = look_at_levels(
            asset,
            images.textures,
            Setup(views=params.views, size=params.size),
            threads=context.threads,
            cache=context.cache,
            progress=lambda done, total: context.progress(total + done, parts * total),
        )
    levels = tuple(
        dataclasses.replace(level, error=figures[number], visual=seen[number], gpu=gpu_size(asset.at(level)))
        for number, level in enumerate(asset.lods)
    )
    asset = settle_switches(dataclasses.replace(asset, lods=levels))
    context.page = collect(asset, images, context, views=params.pictures, with_models=params.models)
    return asset
