import numpy as np

import limbs
import lodpipe
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


def test_as_an_attribute_that_levels_carry_on():
    context = Context()
    asset = segment(skeleton(limbs.asset(limbs.star(4)), SkeletonParams(), context), SegmentParams(), context)
    plain = importance(asset, ImportanceParams(), context)
    result = importance(asset, ImportanceParams(attribute=True), context)
    assert plain.meshes == asset.meshes
    (mesh,), weights = result.meshes, result.importance
    expected = (weights.weight[0] * weights.extreme[0])[mesh.faces]
    assert np.array_equal(mesh.attributes["_IMPORTANCE"][mesh.wedges][:, :, 0], expected)
    assert mesh.attributes["_IMPORTANCE"].max() == 100
    (low,) = lodpipe.decimate(result, 0.1).meshes
    assert 1 <= low.attributes["_IMPORTANCE"].min() < low.attributes["_IMPORTANCE"].max() <= 100.001
