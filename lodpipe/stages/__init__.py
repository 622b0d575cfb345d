"""The stages that lodpipe brings. One explicit table; each stage is a module of its own name."""

from lodpipe.stage import AnyStage
from lodpipe.stages.decimate import decimate
from lodpipe.stages.export import export
from lodpipe.stages.report import report

BUILTIN: dict[str, AnyStage] = {stage.name: stage for stage in (decimate, report, export)}
