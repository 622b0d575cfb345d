import pytest

import limbs
from lodpipe.core.errors import InvalidMesh
from lodpipe.stage import Context
from lodpipe.stages.segment import SegmentParams, segment
from lodpipe.stages.skeleton import SkeletonParams, skeleton


def test_the_asset_gets_its_segments():
    asset, context = limbs.asset(limbs.star(4)), Context()
    result = segment(skeleton(asset, SkeletonParams(), context), SegmentParams(), context)
    assert len(result.segments.names) == 5
    assert {m.name: m.value for m in context.measurements}["branches"] == 4


def test_without_a_skeleton_it_says_what_to_do():
    with pytest.raises(InvalidMesh, match="put `skeleton` before `segment`"):
        segment(limbs.asset(limbs.star(2)), SegmentParams(), Context())
