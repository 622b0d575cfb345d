"""The stages that lodpipe brings. One explicit table; each stage is a module of its own name."""

from lodpipe.stage import AnyStage
from lodpipe.stages.bake import bake
from lodpipe.stages.decimate import decimate
from lodpipe.stages.export import export
from lodpipe.stages.importance import importance
from lodpipe.stages.repair_uv import repair_uv
from lodpipe.stages.report import report
from lodpipe.stages.segment import segment
from lodpipe.stages.skeleton import skeleton

BUILTIN: dict[str, AnyStage] = {
    stage.name: stage for stage in (repair_uv, skeleton, segment, importance, decimate, bake, report, export)
}
