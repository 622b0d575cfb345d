"""The stages and their parameters for people."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

from lodpipe.reporting.table import table

WIDTH = 100


def stage_list(stages: Sequence[Mapping[str, Any]]) -> list[str]:
    """A line for each stage."""
    rows = [(stage["name"], stage["origin"], stage["summary"]) for stage in stages]
    return [*table(("stage", "origin", "what it does"), rows, indent=0), "", "lodpipe stages NAME lists its parameters"]


def stage_lines(stage: Mapping[str, Any]) -> list[str]:
    """All about one stage."""
    lines = [f"{stage['name']} ({stage['origin']}, version {stage['version']})", ""]
    lines += [line for part in stage["doc"].split("\n\n") for line in (*textwrap.wrap(part, WIDTH), "")]
    for param in stage["params"]:
        lines.append(f"  {param['name']}: {param['type']} = {param['default']}")
        lines += textwrap.wrap(param["doc"], WIDTH, initial_indent="      ", subsequent_indent="      ")
    return lines if stage["params"] else [*lines, "  It has no parameters."]
