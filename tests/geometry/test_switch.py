"""Screen coverages and distances: when a level's error is too small to be seen."""

from __future__ import annotations

import dataclasses
import math
from itertools import pairwise

import numpy as np
import pytest

from chains import asset
from lodpipe.core.asset import ErrorFigures, Lod, Switch
from lodpipe.geometry.switch import SCREEN_HEIGHT, coverages, settle_switches


def with_levels(*estimates: float, measured: float | None = None):
    figure = None if measured is None else ErrorFigures(0.0, 0.0, measured)
    source = asset()
    levels = [Lod(source.meshes), *(Lod(source.meshes, estimate=e, error=figure) for e in estimates)]
    return dataclasses.replace(source, lods=tuple(levels))


def shares(settled):
    return [level.switch.screen_coverage for level in settled.lods]


def test_the_error_covers_one_pixel_where_the_level_takes_over():
    settled = settle_switches(with_levels(0.5, 2.0))
    assert settled.lods[0].switch == Switch(1.0, 0.0)
    for level in settled.lods[1:]:
        pixels = level.estimate / 100 * level.switch.screen_coverage * SCREEN_HEIGHT
        assert pixels == pytest.approx(1.0)


def test_the_distance_is_where_the_diagonal_takes_that_share_of_60_degrees():
    level = settle_switches(with_levels(1.0)).lods[1]
    diagonal = math.sqrt(3)
    seen = diagonal / (2 * level.switch.distance * math.tan(math.radians(30)))
    assert seen == pytest.approx(level.switch.screen_coverage)


def test_what_was_measured_goes_before_the_estimate():
    assert shares(settle_switches(with_levels(0.5, measured=4.0))) == shares(settle_switches(with_levels(4.0)))


@pytest.mark.parametrize("estimates", [(0.0, 0.0, 0.0), (5.0, 1.0), (math.nan, 1.0), (1.0, math.inf), (1e-9, 1e9)])
def test_coverages_always_fall_strictly(estimates):
    values = coverages(settle_switches(with_levels(*estimates)).lods)
    assert len(values) == len(estimates) + 1
    assert values[-1] == 0.0
    assert all(np.isfinite(values))
    assert all(a > b or a == b == 0 for a, b in pairwise(values))


def test_what_is_settled_stays():
    once = settle_switches(with_levels(1.0))
    later = dataclasses.replace(
        once, lods=tuple(dataclasses.replace(level, error=ErrorFigures(9, 9, 9)) for level in once.lods)
    )
    assert shares(settle_switches(later)) == shares(once)
    assert settle_switches(later) is later


def test_without_levels_nothing_happens():
    source = asset()
    assert settle_switches(source) is source
