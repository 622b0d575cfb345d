import limbs
from lodpipe.stage import Context
from lodpipe.stages.importance import ImportanceParams, importance
from lodpipe.stages.segment import SegmentParams, segment
from lodpipe.stages.skeleton import SkeletonParams, skeleton


def test_the_asset_gets_its_importance():
    context = Context()
    asset = skeleton(limbs.asset(limbs.star(4)), SkeletonParams(), context)
    asset = segment(asset, SegmentParams(), context)
    result = importance(asset, ImportanceParams(strength=0.5, saliency=1), context)
    assert len(result.importance.reserved) == 4
    assert result.importance.strength == 0.5
    figures = {m.name: m.value for m in context.measurements}
    assert figures["reserved"] == 4
    assert figures["weight.most"] == 2
    assert not any("importance" in text for text in context.warnings)


def test_without_a_skeleton_it_says_so():
    context = Context()
    result = importance(limbs.asset(limbs.star(2)), ImportanceParams(), context)
    assert result.importance.strength is None
    assert "put `skeleton` and `segment` before it" in context.warnings[0]
