"""`report`: the figures of each level, and the switches that follow from them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lodpipe.core.asset import Asset, ErrorFigures, Lod
from lodpipe.core.material import Image, Material
from lodpipe.core.mesh import Mesh, Primitive
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
    result = report(sheets(0.01, 0.1), ReportParams(samples=2000, views=0), context)
    assert result.lods[0].error == ErrorFigures(0.0, 0.0, 0.0, 0.0)
    for level, height in ((1, 0.01), (2, 0.1)):
        error = result.lods[level].error
        expected = 100 * height / np.sqrt(2)  # of the source's diagonal
        assert (error.mean, error.rms, error.max) == pytest.approx((expected,) * 3, rel=1e-4)
        pixels = error.max / 100 * result.lods[level].switch.screen_coverage * SCREEN_HEIGHT
        assert pixels == pytest.approx(1.0)
    assert context.warnings == []


def test_what_is_seen_of_a_lifted_sheet():
    result = report(sheets(0.01, 0.1), ReportParams(samples=500, views=4, size=64), Context())
    source, near, far = (level.visual for level in result.lods)
    assert (source.psnr, source.reasons["psnr"], source.silhouette_iou) == (None, "the pictures are equal", 1.0)
    assert near.psnr > far.psnr
    assert near.silhouette_iou > far.silhouette_iou
    assert far.data()["views"] == 4


def test_no_views_no_pictures():
    result = report(sheets(0.1), ReportParams(samples=500, views=0), Context())
    assert [level.visual for level in result.lods] == [None, None]


def test_a_broken_texture_is_told_of_once():
    source = sheets(0.1)
    uv = np.zeros((9, 2), np.float32)
    textured = (Primitive(0, ("TEXCOORD_0",)),)
    plain = [level.meshes[0] for level in source.lods]
    meshes = [Mesh(m.positions, m.faces, attributes={"TEXCOORD_0": uv}, primitives=textured) for m in plain]
    source = Asset(
        "sheet",
        (meshes[0],),
        (Material({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}),),
        (Image(b"\x89PNG\r\n\x1a\n broken", uri="skin.png", width=4, height=4),),
        {"textures": [{"source": 0}]},
        lods=tuple(Lod((mesh,)) for mesh in meshes),
    )
    context = Context()
    result = report(source, ReportParams(samples=500, views=2, size=32), context)
    assert [level.visual.views for level in result.lods] == [2, 2]
    assert len(context.warnings) == 1
    assert "skin.png" in context.warnings[0]


def test_the_same_figures_every_time_and_with_any_threads():
    source = sheets(0.1)
    tilted = Mesh(source.meshes[0].positions + [[0, 0, 0.1 * x] for x in range(9)], source.meshes[0].faces)
    source = dataclasses.replace(source, lods=(*source.lods, Lod((tilted,))))
    params = ReportParams(samples=500, views=2, size=32)
    once = [report(source, params, Context(threads=n)).lods[2] for n in (1, 1, 2)]
    assert once[0].error == once[1].error == once[2].error
    assert once[0].visual == once[1].visual == once[2].visual
    assert report(source, params, Context(seed=1)).lods[2].error != once[0].error


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
