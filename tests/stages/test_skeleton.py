import limbs
import meshes
from lodpipe.core.mesh import Mesh
from lodpipe.stage import Context
from lodpipe.stages.skeleton import SkeletonParams, skeleton


def test_the_asset_gets_its_skeleton_and_the_report_its_figures():
    asset, context = limbs.asset(limbs.star(3)), Context()
    result = skeleton(asset, SkeletonParams(), context)
    assert asset.skeleton is None
    assert result.skeleton.count("end") == 3
    assert result.fingerprint() != asset.fingerprint()
    figures = {m.name: m.value for m in context.measurements}
    assert figures == {"ends": 3, "joints": 1, "components": 1, "loops": 0}
    assert context.warnings == []


def test_notes_become_warnings_once():
    context = Context()
    skeleton(limbs.asset(Mesh(*meshes.grid(4))), SkeletonParams(), context)
    assert context.warnings == ["skeleton: open: 1 border loop taken as closed"]
