"""`segment`: the source cut into main bodies and branches."""

from __future__ import annotations

from dataclasses import replace

from lodpipe.core.asset import Asset
from lodpipe.core.errors import InvalidMesh
from lodpipe.core.skeleton import PARTS
from lodpipe.geometry.segment import segment as segment_of
from lodpipe.stage import Context, Params, stage


class SegmentParams(Params):
    """Parameters of `segment`: it has none."""


@stage("segment")
def segment(asset: Asset, params: SegmentParams, context: Context) -> Asset:
    """Cut the source along its skeleton into main bodies and branches, for the stages that come after it."""
    if asset.skeleton is None:
        raise InvalidMesh("there is no skeleton to cut along", advice="put `skeleton` before `segment` in the chain")
    found = segment_of(asset, asset.skeleton)
    context.record("segments", len(found.names))
    context.record("branches", int((found.kind == PARTS.index("branch")).sum()))
    return replace(asset, segments=found)
