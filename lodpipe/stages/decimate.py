"""Stage `decimate`: makes every level of the asset."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field

from lodpipe.core.asset import Asset, Lod
from lodpipe.core.errors import AssetError, LimitError
from lodpipe.geometry.decimate import decimate_asset
from lodpipe.geometry.flatten import flatten
from lodpipe.geometry.joined import AttributeWeights, Unseen
from lodpipe.geometry.pictures import Gallery, Setup
from lodpipe.geometry.strip import without_uvs
from lodpipe.geometry.surface import image_index
from lodpipe.geometry.texture import U8, Textures
from lodpipe.geometry.trials import WAYS
from lodpipe.geometry.visible import Sight
from lodpipe.io import decode_image, pixels_of
from lodpipe.kernel import QuadricOptions
from lodpipe.kernel.similarity import SimilarityOptions
from lodpipe.stage import Context, Params, stage

Weight = Annotated[float, Field(ge=0)]
DEFAULTS = QuadricOptions()
SIMILARITY = SimilarityOptions()

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

    metric: Literal["quadric", "visual", "ray", "texture_deviation", "image"] = "quadric"
    """What decides. `quadric`: squared distance to the planes that were merged. `visual`: what is seen: light counts,
    too, and each level is fitted to the source. Slower, to study and compare: `ray` (what rays from round the region
    see change), `texture_deviation` (how far points of equal UV move), `image` (what 20 pictures show)."""
    collapse: Literal["full", "half"] = "full"
    """`full` puts the merged vertex where the error is least; `half` keeps only vertices of the source."""
    placement: Literal["optimal", "midpoint"] = "optimal"
    """Where a full collapse puts the merged vertex."""
    weighting: Literal["area", "area-angle", "uniform"] = "area"
    """What each face's plane weighs."""
    uvs: Literal["kept", "free"] = "kept"
    """`free`: levels have no UVs and vertex colours (and normals with `visual` alone), whose seams then do not hold the
    surface back: for chains in which `bake` follows, which gives them new ones."""
    attributes: bool = DEFAULTS.attribute_cost
    """Whether UVs, normals and colours steer; if not they are carried all the same."""
    uv_weight: Weight = AttributeWeights.uv
    """1 prices a texture that slips by a length like a surface that is off by it."""
    normal_weight: Weight = AttributeWeights.normal
    """1 prices a normal that is off by 1 like a surface that is off by the level's mean edge length."""
    color_weight: Weight = AttributeWeights.color
    """The same for vertex colours."""
    motion_weight: Weight = AttributeWeights.motion
    """Skinned and morphing meshes: 1 prices a vertex that is off in their poses like one that is off at rest; 0: only
    the rest pose counts."""
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
    reference: Literal["original", "previous"] = SIMILARITY.reference
    """`ray`, `texture_deviation`: compare with the source, or with the mesh just before the collapse."""
    correspondence: Literal["scene", "uv"] = SIMILARITY.correspondence
    """`ray`: which triangles of the source a ray can meet: those near it, or those with the UVs of the region."""
    views: int = Field(SIMILARITY.views, ge=1, le=256)
    """`ray`: viewpoints on the hemisphere over a region."""
    penalty: Literal["constant", "view"] = SIMILARITY.penalty
    """`ray`: what a ray costs that meets one of the two meshes only: its difference to grey, or more from above."""
    spacing: float = Field(SIMILARITY.spacing, ge=0.05, le=100)
    """`ray`: distance of sample points, in √(2 · mean area of the source's triangles)."""
    image_size: int = Field(SIMILARITY.image_size, ge=16, le=4096)
    """`image`: width and height of the pictures."""
    trials: int = Field(1, ge=1, le=len(WAYS))
    """`visual`: in how many ways, with other prices for light, texture and seams, each level is made; pictures tell
    which one looks most like the source. Each takes as long as the first."""
    round_share: float = Field(DEFAULTS.round_share, gt=0, le=1)
    """Share of the vertices considered at a time: smaller is nearer to the best order, larger is faster."""


def _sight(asset: Asset, context: Context) -> Unseen | None:
    """What judges targets in pixels, if there are any: by the pictures that `report` compares by default."""
    if all(target.pixels is None for target in context.lods):
        return None
    textures = Textures(pixels_of(asset, context.warn))
    return Sight(Gallery(asset, Setup(), textures, threads=context.threads, cache=context.cache)).of


@stage("decimate")
def decimate(asset: Asset, params: DecimateParams, context: Context) -> Asset:
    """Levels of detail by quadric error decimation, one budget for the whole asset."""
    for mesh in asset.meshes:
        if mesh.keep_reason:
            context.warn(f"mesh '{mesh.name}' is not simplified: {mesh.keep_reason}")
    source = asset
    if params.uvs == "free":
        asset = without_uvs(asset, normals=params.metric == "visual")  # which fits them to the source
    similarity = _similarity(params)
    if similarity and asset.importance is not None and (asset.importance.pinned or asset.importance.shares):
        context.warn(f"`metric: {params.metric}` does not know pinned parts or shares of parts; they are left out")
    options = similarity or _quadric(asset, params)
    pixels = _pixels(asset, context) if similarity or params.metric == "visual" else {}
    levels = decimate_asset(
        asset,
        context.lods,
        options,
        weights=AttributeWeights(params.uv_weight, params.normal_weight, params.color_weight, params.motion_weight),
        metric="visual" if params.metric == "visual" else "quadric",
        pixels=pixels,
        unseen=_sight(asset, context),
        trials=params.trials,
        threads=context.threads,
        progress=context.progress,
        cancelled=context.cancelled,
    )
    for number, level in enumerate(levels[1:], 1):
        context.record(f"lod{number}.triangles", level.triangles)
        if level.stop_reason not in ("target", "error", "pixels", "kept meshes"):
            context.warn(f"level {number} stopped at {level.triangles} triangles: {REASONS[level.stop_reason]}")
        if level.relaxed:
            context.warn(f"level {number} could only be reached by changing the topology")
    return replace(source, lods=(Lod(source.meshes), *levels[1:]))


def _quadric(asset: Asset, params: DecimateParams) -> QuadricOptions:
    return QuadricOptions(
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
    )


def _similarity(params: DecimateParams) -> SimilarityOptions | None:
    if params.metric == "quadric" or params.metric == "visual":
        return None
    return SimilarityOptions(
        metric=params.metric,
        collapse=params.collapse,
        reference=params.reference,
        correspondence=params.correspondence,
        views=params.views,
        penalty=params.penalty,
        spacing=params.spacing,
        image_size=params.image_size,
        keep_topology=params.keep_topology,
        may_relax=params.may_relax,
    )


def _pixels(asset: Asset, context: Context) -> dict[int, U8]:
    """The images that materials use as base colour, decoded; those that cannot be are told."""
    used = set()
    for material in asset.materials:
        ref = material.base_color_texture
        if ref is not None:
            used.add(image_index(asset.document["textures"][ref.texture]))
    pixels = {}
    for index in sorted(i for i in used if i is not None):
        try:
            pixels[index] = decode_image(asset.images[index])
        except (AssetError, LimitError) as error:
            context.warn(f"{error}: the material's factor colour stands in for it")
    return pixels
