"""`report`: the figures of each level, and the switches that follow from them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lodpipe.core.asset import Asset, ErrorFigures, Lod
from lodpipe.core.mesh import Mesh
from lodpipe.geometry.switch import SCREEN_HEIGHT
from lodpipe.stage import Context
from lodpipe.stages.report import ReportParams, report
from meshes import grid


def sheets(*heights: float) -> Asset:
    """A unit square, and levels that are the same square lifted by some height."""
    meshes = [Mesh(*grid(2, height)) for height in (0.0, *heights)]
    return Asset("sheet", (meshes[0],), lods=tuple(Lod((mesh,)) for mesh in meshes))


def test_a_lifted_sheet_is_off_by_its_height():
    context = Context()
    result = report(sheets(0.01, 0.1), ReportParams(samples=2000), context)
    assert result.lods[0].error == ErrorFigures(0.0, 0.0, 0.0, 0.0)
    for level, height in ((1, 0.01), (2, 0.1)):
        error = result.lods[level].error
        expected = 100 * height / np.sqrt(2)  # of the source's diagonal
        assert (error.mean, error.rms, error.max) == pytest.approx((expected,) * 3, rel=1e-4)
        pixels = error.max / 100 * result.lods[level].switch.screen_coverage * SCREEN_HEIGHT
        assert pixels == pytest.approx(1.0)
    assert context.warnings == []


def test_the_same_figures_every_time_and_with_any_threads():
    source = sheets(0.1)
    tilted = Mesh(source.meshes[0].positions + [[0, 0, 0.1 * x] for x in range(9)], source.meshes[0].faces)
    source = dataclasses.replace(source, lods=(*source.lods, Lod((tilted,))))
    once = [report(source, ReportParams(samples=500), Context(threads=n)).lods[2].error for n in (1, 1, 2)]
    assert once[0] == once[1] == once[2]
    assert report(source, ReportParams(samples=500), Context(seed=1)).lods[2].error != once[0]


def test_a_level_without_triangles_is_warned_of():
    source = sheets()
    empty = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    context = Context()
    result = report(dataclasses.replace(source, lods=(*source.lods, Lod((empty,)))), ReportParams(), context)
    assert result.lods[1].error is None
    assert context.warnings == ["level 1 has no triangles, so its distance to the source cannot be measured"]


def test_without_levels_nothing_happens():
    source = dataclasses.replace(sheets(), lods=())
    assert report(source, ReportParams(), Context()) is source
