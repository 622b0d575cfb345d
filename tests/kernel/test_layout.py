"""The kernel's functions on UV layouts, against their NumPy references and known answers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lodpipe.core.errors import InvalidMesh
from lodpipe.kernel import layout
from lodpipe.kernel import uv_reference as reference

SQUARE = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]], float)
NONE = np.zeros((0, 2), np.int32)


def random_triangles(seed: int, count: int = 12):
    """Triangles on a coarse lattice: shared corners, shared edges and equal triangles are common."""
    return np.random.default_rng(seed).integers(0, 5, (count, 3, 2)).astype(float)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_charts_are_those_of_the_reference(seed):
    corners = np.random.default_rng(seed).integers(0, 12, (14, 3)).astype(np.int32)
    assert layout.chart_labels(corners).tolist() == reference.chart_labels(corners).tolist()


def test_faces_that_share_one_corner_are_two_charts():
    assert layout.chart_labels(np.array([[0, 1, 2], [0, 3, 4], [4, 3, 5]], np.int32)).tolist() == [0, 1, 1]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000))
def test_common_areas_are_those_of_the_reference(seed):
    uv = random_triangles(seed)
    labels, group = np.arange(len(uv), dtype=np.int32), np.zeros(len(uv), np.int32)
    found = layout.uv_overlaps(uv, labels, group)
    areas = {tuple(pair): area for pair, area in zip(found.charts.tolist(), found.area.sum(axis=1), strict=True)}
    for a in range(len(uv)):
        for b in range(a + 1, len(uv)):
            assert areas.get((a, b), 0.0) == pytest.approx(reference.common_area(uv[a], uv[b]), abs=1e-12)
    lapping = sorted({face for pair in areas for face in pair})
    assert np.flatnonzero(found.faces).tolist() == lapping


def test_opposite_orientations_are_told_apart():
    uv = np.concatenate([SQUARE, SQUARE[:, ::-1]])
    found = layout.uv_overlaps(uv, np.array([0, 0, 1, 1], np.int32), np.zeros(4, np.int32))
    assert found.charts.tolist() == [[0, 1]]
    assert found.area.tolist() == [[0.0, 1.0]]


def test_groups_do_not_overlap_and_touching_is_no_overlap():
    uv = np.concatenate([SQUARE, SQUARE, SQUARE + np.array([1, 0]), SQUARE + np.array([1 - 1e-9, 1])])
    group = np.repeat([0, 1, 0, 0], 2).astype(np.int32)
    found = layout.uv_overlaps(uv, np.repeat(np.arange(4), 2).astype(np.int32), group)
    assert not len(found.charts)
    assert not found.faces.any()


def test_a_limit_on_pairs_is_told():
    uv = np.repeat(SQUARE, 20, axis=0)
    rows = np.zeros(len(uv), np.int32)
    assert layout.uv_overlaps(uv, rows, rows).complete
    assert not layout.uv_overlaps(uv, rows, rows, limit=10).complete


def test_coverage_of_squares_is_exact():
    uv = np.concatenate([SQUARE, SQUARE + np.array([0.5, 0]), SQUARE + np.array([0.75, 0]), SQUARE * 2])
    group = np.array([0] * 6 + [1] * 2, np.int32)
    assert layout.uv_coverage(uv, group) == pytest.approx(np.array([[1.75, 1.0], [4.0, 0.0]]), abs=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_coverage_is_what_points_find(seed):
    uv = random_triangles(seed, 6)
    found = layout.uv_coverage(uv, np.zeros(len(uv), np.int32))[0]
    points = np.random.default_rng(1).random((4000, 2)) * 4
    sides = np.roll(uv, -1, axis=1) - uv
    away = points[:, None, None] - uv
    cross = sides[..., 0] * away[..., 1] - sides[..., 1] * away[..., 0]
    flat = sides[:, 0, 0] * sides[:, 1, 1] == sides[:, 0, 1] * sides[:, 1, 0]
    depth = (((cross >= 0).all(axis=2) | (cross <= 0).all(axis=2)) & ~flat).sum(axis=1)
    assert found / 16 == pytest.approx([(depth > 0).mean(), (depth > 1).mean()], abs=0.04)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000))
def test_gaps_are_those_of_the_reference(seed):
    rng = np.random.default_rng(seed)
    segments, chart = rng.random((9, 2, 2)) * 0.3 + rng.integers(0, 3, (9, 1, 2)), rng.integers(0, 3, 9)
    pairs = [(a, b) for a in range(9) for b in range(a) if chart[a] != chart[b]]
    expected = min([5.0, *(reference.gap(segments[a], segments[b]) for a, b in pairs)])
    found = layout.uv_gaps(segments, chart.astype(np.int32), np.zeros(9, np.int32), 1, 5.0)
    assert found == pytest.approx([expected], abs=1e-12)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.floats(0, 3))
def test_texels_are_those_of_the_reference(seed, reach):
    rng = np.random.default_rng(seed)
    uv = rng.random((5, 3, 2)) * 10
    edges = np.stack([np.repeat(np.arange(5), 3), np.tile(np.arange(3), 5)], axis=1).astype(np.int32)
    found = layout.uv_raster(uv, edges, (-1, -2, 12, 13), reach)
    for y in range(13):
        for x in range(12):
            face, weights = reference.texel(uv, edges, np.array([x - 0.5, y - 1.5]), reach)
            assert found.faces[y, x] == face
            assert found.weights[y, x] == pytest.approx(weights, abs=1e-6)


def test_bands_and_threads_give_the_same_texels():
    uv = np.random.default_rng(3).random((40, 3, 2)) * 300
    edges = np.stack([np.arange(40), np.zeros(40)], axis=1).astype(np.int32)
    whole = layout.uv_raster(uv, edges, (0, 0, 300, 300), 4.0, threads=3)
    for top in (0, 100, 170):
        part = layout.uv_raster(uv, edges, (20, top, 200, 70), 4.0, threads=1)
        assert np.array_equal(part.faces, whole.faces[top : top + 70, 20:220])
        assert np.array_equal(part.weights, whole.weights[top : top + 70, 20:220])
        assert np.array_equal(part.inside, whole.inside[top : top + 70, 20:220])


def test_what_does_not_fit_is_refused():
    with pytest.raises(InvalidMesh, match="not finite"):
        layout.uv_raster(SQUARE * np.nan, NONE, (0, 0, 4, 4))
    with pytest.raises(InvalidMesh, match="cannot be filled"):
        layout.uv_raster(SQUARE, NONE, (0, 0, 0, 4))
    with pytest.raises(InvalidMesh, match="edges point outside"):
        layout.uv_raster(SQUARE, np.array([[2, 0]], np.int32), (0, 0, 4, 4))
    with pytest.raises(InvalidMesh, match="charts and groups must have"):
        layout.uv_overlaps(SQUARE, np.zeros(3, np.int32), np.zeros(2, np.int32))
    with pytest.raises(InvalidMesh, match="numbered from 0"):
        layout.uv_overlaps(SQUARE, np.zeros(2, np.int32), np.array([0, -1], np.int32))


def test_nothing_is_not_an_error():
    nothing, rows = np.zeros((0, 3, 2)), np.zeros(0, np.int32)
    assert len(layout.chart_labels(np.zeros((0, 3), np.int32))) == 0
    assert len(layout.uv_overlaps(nothing, rows, rows).charts) == 0
    assert (layout.uv_raster(nothing, NONE, (0, 0, 2, 2), 1.0).faces == -1).all()
    assert layout.uv_gaps(np.zeros((0, 2, 2)), rows, rows, 0, 1.0).shape == (0,)
