"""The kernel's options as tests want them: every one set here, so that better defaults change no test."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from lodpipe.kernel import QuadricOptions

SET = QuadricOptions(
    placement="optimal",
    weighting="area",
    boundary_weight=10.0,
    seam_weight=1.0,
    crease_weight=0.1,
    crease_degrees=60.0,
    pair_distance=0.0,
    attribute_cost=True,
    keep_topology=True,
    may_relax=True,
    flip_degrees=78.0,
    round_share=1 / 16,
    max_error=None,
    keep_last=False,
    chart_column=None,
    record=False,
)


def options(**changes: Any) -> QuadricOptions:
    """`SET`, but for the fields named."""
    return replace(SET, **changes)
