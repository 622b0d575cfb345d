"""`skeleton`: the curve skeleton of the source."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field

from lodpipe.core.asset import Asset
from lodpipe.geometry.skeleton import SkeletonOptions
from lodpipe.geometry.skeleton import skeleton as skeleton_of
from lodpipe.stage import Context, Params, stage

DEFAULTS = SkeletonOptions()


class SkeletonParams(Params):
    """Parameters of `skeleton`."""

    method: Literal["geodesic", "dcg"] = DEFAULTS.method
    """`geodesic`: level sets of a distance along the surface; `dcg`: balls that a repulsive force puts inside."""
    distance: Literal["dijkstra", "heat"] = DEFAULTS.distance
    """`dijkstra`: shortest paths along edges; `heat`: smoother and slower, needs the package potpourri3d."""
    sources: Literal["single", "multi"] = DEFAULTS.sources
    """`single`: distances from one end of the model; `multi`: with branches that it misses, as fins and ears."""
    levels: Annotated[int, Field(ge=2, le=400)] | Literal["formula", "adaptive"] = DEFAULTS.levels
    """Level sets for each component: a number, max distance / (2 · mean edge), or following the local edge length."""
    least_branch: float = Field(DEFAULTS.least_branch, ge=0, le=100)
    """Shorter branches are pruned, in % of the component's diagonal."""


@stage("skeleton")
def skeleton(asset: Asset, params: SkeletonParams, context: Context) -> Asset:
    """Find the curve skeleton of the source: limbs, joints, loops, for each connected component."""
    found = skeleton_of(asset, SkeletonOptions(**params.model_dump()), context.threads)
    for name in ("end", "joint"):
        context.record(f"{name}s", found.count(name))
    context.record("components", len(found.components))
    context.record("loops", sum(part.cycle_rank for part in found.components))
    notes = Counter(note for part in found.components for note in part.notes)
    for note, times in list(notes.items())[:MOST_NOTES]:
        context.warn(f"skeleton: {note}" + (f" ({times} components)" if times > 1 else ""))
    if len(notes) > MOST_NOTES:
        context.warn(f"skeleton: {len(notes) - MOST_NOTES} more notes of this kind")
    return replace(asset, skeleton=found)


MOST_NOTES = 5
