"""Coarse rounds, many collapses at once; and values that are taken from the source at the end."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lodpipe.kernel import decimate
from measures import euler, open_edges, spread
from meshes import grid, uv_sphere
from options import options

FAST = options(attribute_cost=False, keep_topology=False, round_share=0.5, chart_column=0, boundary_weight=0.15)
FINE = dataclasses.replace(FAST, round_share=0.1)


@pytest.fixture(scope="module")
def ball():
    smooth = uv_sphere(96, 192, materials=2)
    rough = smooth.positions * (1 + 0.0003 * np.random.default_rng(0).random((len(smooth.positions), 1)))
    return dataclasses.replace(smooth, positions=rough)


def run(ball, targets, setting, **more):
    arrays = {"wedges": ball.wedges, "values": ball.values, "column_weights": [0.0] * ball.values.shape[1], **more}
    return decimate(ball.positions, ball.faces, targets, setting, **arrays).levels


def test_any_number_of_threads_gives_the_same_bytes(ball):
    one, two, three = (run(ball, [9000, 2000], FAST, threads=n) for n in (1, 2, 3))
    for level, *others in zip(one, two, three, strict=True):
        for other in others:
            for name in ("positions", "faces", "wedges", "values", "wedge_source", "face_source"):
                assert getattr(level, name).tobytes() == getattr(other, name).tobytes(), name


def test_nothing_opens_folds_or_runs_over(ball):
    for level in run(ball, [20_000, 9000, 1000], FAST, threads=2):
        assert len(level.faces) in (level.target, level.target - 1) and level.stop == "triangles"
        assert open_edges(level.faces) == 0
        if level.target > 1000:  # coarser levels of this noise have a double face or two, as those of fine rounds do
            assert euler(level.faces) == 2
            a, b, c = (level.positions[level.faces[:, k]] for k in range(3))
            assert (np.einsum("fk,fk->f", np.cross(b - a, c - a), a) > 0).all()
        radius = np.linalg.norm(spread(level.positions, level.faces), axis=1)
        assert radius.min() > 0.985 and radius.max() < 1.01


def test_they_are_nearly_as_good_as_fine_ones(ball):
    def off(setting):
        level = run(ball, [2000], setting)[0]
        return np.abs(np.linalg.norm(spread(level.positions, level.faces), axis=1) - 1.00015).mean()

    assert off(FAST) < 1.1 * off(FINE)


def test_locked_vertices_and_borders_stay():
    positions, faces = grid(60)
    heights = np.random.default_rng(1).random(len(positions)) * 0.002
    positions = positions + np.stack([0 * heights, 0 * heights, heights], axis=1)
    locked = np.random.default_rng(2).random(len(positions)) < 0.02
    setting = dataclasses.replace(FAST, chart_column=None)
    level = decimate(positions, faces, [700], setting, locked=locked).levels[0]
    assert len(level.faces) == 700
    kept = set(level.vertex_source.tolist())
    assert set(np.flatnonzero(locked).tolist()) <= kept
    assert np.abs(spread(level.positions, level.faces)[:, :2]).max() <= 1 + 1e-6


def test_values_from_the_source_are_those_that_the_collapses_would_have_carried(ball):
    """With a record the values are carried through each collapse, without one they are summed over the source."""
    late = run(ball, [1500], FINE)[0]
    carried = run(ball, [1500], dataclasses.replace(FINE, record=True))[0]
    assert late.faces.tobytes() == carried.faces.tobytes() and late.positions.tobytes() == carried.positions.tobytes()
    assert (late.wedge_source == carried.wedge_source).all()
    vertex = np.empty(len(late.wedge_source), np.int32)
    vertex[late.wedges] = late.faces
    inside = np.bincount(vertex)[vertex] == 1  # at seams UVs are kept in their charts, each in its own way
    np.testing.assert_allclose(late.values[inside], carried.values[inside], atol=2e-5)
    assert np.abs(late.values - carried.values).max() < 8 / 1024


def test_what_is_the_same_everywhere_stays_so(ball):
    values = np.concatenate([ball.values, np.full((len(ball.values), 2), [0.1, 1e6], np.float32)], axis=1)
    level = run(ball, [1500], FAST, values=values, column_weights=[0.0] * values.shape[1])[0]
    assert (level.values[:, -2] == np.float32(0.1)).all() and (level.values[:, -1] == np.float32(1e6)).all()


def test_importance_weighs_the_values():
    positions, faces = grid(20)
    ramp = (positions[:, :1] > 0.5).astype(np.float32)
    importance = np.where(positions[:, 0] > 0.5, 100.0, 1.0).astype(np.float32)

    def mean(**more):
        setting = dataclasses.replace(FINE, chart_column=None, boundary_weight=10.0)
        level = decimate(positions, faces, [60], setting, values=ramp, column_weights=[0.0], **more).levels[0]
        middle = np.abs(level.positions[level.faces][..., 0] - 0.5) < 0.1
        return level.values[level.wedges][middle].mean()

    assert mean(importance=importance) > mean() + 0.02


def test_uvs_stay_within_a_gutter_however_many_collapses_there_were(ball):
    """The bound holds against the source's charts: it does not add up."""
    level = run(ball, [300], FAST)[0]
    uv = level.values[level.wedges][..., :2]
    gutter = 4 / 1024 + 1e-6
    assert uv[..., 0].min() > -gutter and uv[..., 0].max() < 1 + gutter
