"""Stage `decimate`: makes every level of the asset."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field

from lodpipe.core.asset import Asset
from lodpipe.geometry.decimate import AttributeWeights, decimate_asset
from lodpipe.geometry.flatten import flatten
from lodpipe.kernel import QuadricOptions
from lodpipe.stage import Context, Params, stage

Weight = Annotated[float, Field(ge=0)]
DEFAULTS = QuadricOptions()

#: What held when a level has more triangles than asked for.
REASONS = {
    "topology": "further collapses would change the topology (see `may_relax`)",
    "flip": "further collapses would turn faces over",
    "seams": "further collapses would tear UV seams or borders between materials (see `collapse: full`)",
    "locked": "the remaining vertices are locked",
    "last": "nothing would be left",
}


class DecimateParams(Params):
    """Parameters of `decimate`."""

    metric: Literal["quadric", "visual"] = "quadric"
    """What decides: `quadric`, squared distance to the planes that were merged; `visual`, what is seen: light counts,
    too, and each level is fitted to the source."""
    collapse: Literal["full", "half"] = "full"
    """`full` puts the merged vertex where the error is least; `half` keeps only vertices of the source."""
    placement: Literal["optimal", "midpoint"] = "optimal"
    """Where a full collapse puts the merged vertex."""
    weighting: Literal["area", "area-angle", "uniform"] = "area"
    """What each face's plane weighs."""
    attributes: bool = DEFAULTS.attribute_cost
    """Whether UVs, normals and colours steer; if not they are carried all the same."""
    uv_weight: Weight = AttributeWeights.uv
    """1 prices a texture that slips by a length like a surface that is off by it."""
    normal_weight: Weight = AttributeWeights.normal
    """1 prices a normal that is off by 1 like a surface that is off by the level's mean edge length."""
    color_weight: Weight = AttributeWeights.color
    """The same for vertex colours."""
    boundary_weight: Weight = DEFAULTS.boundary_weight
    """How strongly open borders are held."""
    seam_weight: Weight = DEFAULTS.seam_weight
    """How strongly UV seams and borders between materials are held."""
    crease_weight: Weight = DEFAULTS.crease_weight
    """How strongly sharp edges are held."""
    crease_degrees: float = Field(DEFAULTS.crease_degrees, ge=0, le=180)
    """Turn of the surface from which an edge is sharp."""
    pair_distance: float = Field(0.0, ge=0, le=100)
    """Parts nearer than this may be joined, in % of the bounding box's diagonal; 0: only along edges."""
    keep_topology: bool = DEFAULTS.keep_topology
    """Keep holes and handles, and a manifold one, for as long as the target can be reached that way."""
    may_relax: bool = DEFAULTS.may_relax
    """Give `keep_topology` up when the target cannot be reached otherwise."""
    round_share: float = Field(DEFAULTS.round_share, gt=0, le=1)
    """Share of the vertices considered at a time: smaller is nearer to the best order, larger is faster."""


@stage("decimate")
def decimate(asset: Asset, params: DecimateParams, context: Context) -> Asset:
    """Levels of detail by quadric error decimation, one budget for the whole asset."""
    for mesh in asset.meshes:
        if mesh.keep_reason:
            context.warn(f"mesh '{mesh.name}' is not simplified: {mesh.keep_reason}")
    levels = decimate_asset(
        asset,
        context.lods,
        QuadricOptions(
            placement="endpoint" if params.collapse == "half" else params.placement,
            weighting=params.weighting,
            boundary_weight=params.boundary_weight,
            seam_weight=params.seam_weight,
            crease_weight=params.crease_weight,
            crease_degrees=params.crease_degrees,
            pair_distance=params.pair_distance / 100 * flatten(asset).diagonal if params.pair_distance else 0.0,
            attribute_cost=params.attributes,
            keep_topology=params.keep_topology,
            may_relax=params.may_relax,
            round_share=params.round_share,
        ),
        weights=AttributeWeights(params.uv_weight, params.normal_weight, params.color_weight),
        metric=params.metric,
        threads=context.threads,
        progress=context.progress,
        cancelled=context.cancelled,
    )
    for number, level in enumerate(levels[1:], 1):
        context.record(f"lod{number}.triangles", level.triangles)
        if level.stop_reason not in ("target", "error", "kept meshes"):
            context.warn(f"level {number} stopped at {level.triangles} triangles: {REASONS[level.stop_reason]}")
        if level.relaxed:
            context.warn(f"level {number} could only be reached by changing the topology")
    return replace(asset, lods=levels)
