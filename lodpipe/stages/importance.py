"""`importance`: which vertices matter to the decimator."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field

from lodpipe.core.asset import Asset
from lodpipe.geometry.importance import ImportanceOptions, with_attribute
from lodpipe.geometry.importance import importance as importance_of
from lodpipe.geometry.parts import PartRule
from lodpipe.stage import Context, Params, stage

Share = Annotated[float, Field(ge=0, le=1)]
Direction = tuple[float, float, float]


class PartParams(Params):
    """What is asked of a part."""

    pin: bool = False
    """Neither move nor remove its vertices."""
    weight: Annotated[float, Field(gt=0, le=1e4)] = 1.0
    """Multiplies its vertices' weights."""
    keep: Share | None = None
    """Share of its triangles that it keeps at every level that has room for them; 1 pins it."""


class ImportanceParams(Params):
    """Parameters of `importance`."""

    strength: Share | Literal["auto"] = "auto"
    """How much skeleton and reserved vertices count at levels of few triangles; `auto`: more the fewer they are."""
    visibility: Share = 0.0
    """How much vertices that few directions see lose."""
    saliency: Annotated[float, Field(ge=0, le=100)] = 0.0
    """How much vertices gain where the surface's curvature stands out."""
    painted: str | None = None
    """Attribute with painted weights: a colour (red protects, blue reduces, grey is neutral), or a number."""
    parts: dict[str, PartParams] = Field(default_factory=dict)
    """What is asked of parts: segments (`main`, `branch2`), kinds (`branch`), node types (`end`), nodes, materials."""
    attribute: bool = False
    """Write it out: every level carries the vertex attribute `_IMPORTANCE`, a number from 0.01 up; 1 is neutral."""
    cameras: tuple[Direction, ...] = ()
    """Directions from which the model will be seen; none: from all round."""


@stage("importance")
def importance(asset: Asset, params: ImportanceParams, context: Context) -> Asset:
    """Weigh the source's vertices by skeleton, visibility, saliency and painted weights, for `decimate`."""
    values = params.model_dump(exclude={"parts", "attribute"})
    values["strength"] = None if params.strength == "auto" else params.strength
    if asset.skeleton is None or asset.segments is None:
        context.warn("importance without a skeleton: put `skeleton` and `segment` before it to keep branches")
    rules = {name: PartRule(**rule.model_dump()) for name, rule in params.parts.items()}
    found = importance_of(asset, ImportanceOptions(**values, parts=rules))
    context.record("reserved", len(found.reserved), "branches")
    low = min((float(w.min()) for w in found.weight if len(w)), default=1.0)
    high = max((float(w.max()) for w in found.weight if len(w)), default=1.0)
    context.record("weight.least", low)
    context.record("weight.most", high)
    asset = replace(asset, importance=found)
    return with_attribute(asset) if params.attribute else asset
