"""The least-squares fit of a level: equal to the slow form, nearer to the source, within its guards."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lodpipe import kernel
from lodpipe.kernel import fit_reference
from measures import areas, spread
from meshes import bumpy, grid, islands, seam_cylinder, terrain
from options import options


def made(positions, faces, target, wedges=None, values=None, **changes):
    values = np.ascontiguousarray(positions, np.float32) if values is None else values
    wedges = faces if wedges is None else wedges
    result = kernel.decimate(
        positions,
        faces,
        [target],
        options(follow=True, attribute_cost=False, keep_topology=False, **changes),
        wedges=wedges,
        values=values,
        column_weights=[0.0] * values.shape[1],
    )
    return wedges, values, result.levels[0]


def test_equal_to_the_slow_form():
    positions, faces = bumpy(3, 0.05)
    wedges, values, level = made(positions, faces, 60)
    fast = kernel.fit(positions, faces, wedges, values, level, 1500)
    slow = fit_reference.fit(positions, faces, wedges, values, level, 1500, moves=2)
    assert np.abs(fast.positions - level.positions).max() > 0.01  # there was something to do
    np.testing.assert_allclose(fast.positions, slow.positions, atol=2e-3)
    np.testing.assert_allclose(fast.values, slow.values, atol=2e-3)


def test_values_alone_are_equal_to_1e_5():
    positions, faces = bumpy(2, 0.02)
    wedges, values, level = made(positions, faces, 40)
    fast = kernel.fit(positions, faces, wedges, values, level, 1500, moves=0)
    slow = fit_reference.fit(positions, faces, wedges, values, level, 1500, moves=0)
    np.testing.assert_array_equal(fast.positions, level.positions)
    np.testing.assert_allclose(fast.values, slow.values, atol=1e-4)
    assert np.median(np.abs(fast.values - slow.values)) < 1e-5


def gap(positions, faces, level):
    """Mean distance of points on the source to the level's faces."""
    points = spread(positions, faces, 2000)
    hit, weights = fit_reference.nearest(points, points, level.positions, level.faces)
    seen = hit >= 0
    found = np.einsum("nk,nkd->nd", weights, level.positions[level.faces[hit]])
    return np.linalg.norm(points[seen] - found[seen], axis=1).mean()


def test_the_surface_comes_nearer():
    positions, faces = bumpy(4, 0.03)
    wedges, values, level = made(positions, faces, 120)
    fitted = kernel.fit(positions, faces, wedges, values, level, 5000)
    assert gap(positions, faces, fitted) < 0.9 * gap(positions, faces, level)
    assert (fitted.vertex_source == -1).all()


def test_a_flat_open_sheet_stays_flat_and_keeps_its_outline():
    positions, faces = grid(16)
    wedges, values, level = made(positions, faces, 20)
    fitted = kernel.fit(positions, faces, wedges, values, level, 2000)
    assert np.abs(fitted.positions[:, 2]).max() < 1e-6
    np.testing.assert_allclose(fitted.positions.min(axis=0), positions.min(axis=0), atol=1e-3)
    np.testing.assert_allclose(fitted.positions.max(axis=0), positions.max(axis=0), atol=1e-3)
    np.testing.assert_allclose(fitted.values, fitted.positions, atol=1e-4)  # linear: reproduced


def test_texture_coordinates_stay_within_their_chart_and_a_gutter():
    tube = seam_cylinder(48, 24, tiles=1.0)
    wedges, values, level = made(tube.positions, tube.faces, 60, tube.wedges, tube.values)
    fitted = kernel.fit(tube.positions, tube.faces, wedges, values, level, 3000, chart_column=0)
    before, after = values[:, :2], fitted.values[:, :2]
    room = 8 / 1024 + 1e-6  # the decimation's gutter and the fit's
    assert (after >= before.min(axis=0) - room).all() and (after <= before.max(axis=0) + room).all()


@pytest.mark.parametrize("threads", [2, 3])
def test_any_number_of_threads_gives_the_same_bytes(threads):
    positions, faces = bumpy(6, 0.05)
    wedges, values, level = made(positions, faces, 6000)
    one, many = (kernel.fit(positions, faces, wedges, values, level, 60_000, threads=t) for t in (1, threads))
    for a, b in zip(dataclasses.astuple(one), dataclasses.astuple(many), strict=True):
        assert a.tobytes() == b.tobytes() if isinstance(a, np.ndarray) else a == b


def test_no_face_turns_over():
    positions, faces = terrain(24, 0.4)
    wedges, values, level = made(positions, faces, 40)
    fitted = kernel.fit(positions, faces, wedges, values, level, 500, moves=5)
    corners = np.stack([level.positions[level.faces], fitted.positions[fitted.faces]])
    before, after = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    assert np.abs(corners[1] - corners[0]).max() > 0.01
    assert (np.einsum("fd,fd->f", before, after) > 0).all()


def test_what_was_exact_stays_to_the_last_bit():
    """A level that the source's samples lie on already: a flat sheet with linear values."""
    positions, faces = grid(16)
    wedges, values, level = made(positions, faces, 20)
    fitted = kernel.fit(positions, faces, wedges, values, level, 2000)
    np.testing.assert_array_equal(fitted.positions, level.positions)
    np.testing.assert_array_equal(fitted.values, level.values)
    np.testing.assert_array_equal(fitted.vertex_source, level.vertex_source)


def test_samples_follow_importance():
    positions, faces = bumpy(4, 0.05)
    wedges, values, level = made(positions, faces, 60)
    upper = np.where(positions[:, 2] > 0, 1.0, 1e-3).astype(np.float32)
    even = kernel.fit(positions, faces, wedges, values, level, 3000)
    fitted = kernel.fit(positions, faces, wedges, values, level, 3000, importance=upper)
    above = positions[faces][:, :, 2].min(axis=1) > 0.3
    assert gap(positions, faces[above], fitted) < gap(positions, faces[above], even)


def test_degenerate_input_and_stray_wedges():
    positions, faces = bumpy(2)
    flat = np.vstack([faces, faces[:3][:, [0, 1, 1]]]).astype(np.int32)
    for p in (positions, positions * [1, 1, 0], positions * 0, positions * 1e150, positions * 1e-150):
        wedges, values, level = made(p, flat, 30, values=np.ones((len(p), 2), np.float32))
        fitted = kernel.fit(p, flat, wedges, values, level, 100, chart_column=0)
        assert np.isfinite(fitted.positions).all() and np.isfinite(fitted.values).all()
    charts = islands(*bumpy(2))
    wedges, values, level = made(charts.positions, charts.faces, 20, charts.wedges, charts.values)
    fitted = kernel.fit(charts.positions, charts.faces, wedges, values, level, 400, chart_column=0)
    assert areas(fitted.positions, fitted.faces).min() > 0


def test_a_hub_of_very_many_faces():
    """More than the walk goes round and a row is searched for: samples come by the rim, and nothing is lost."""
    turn = np.linspace(0, 2 * np.pi, 2001)[:-1]
    rim = np.stack([np.cos(turn), np.sin(turn), 0.1 * np.sin(40 * turn)], axis=1)
    positions = np.vstack([[[0.0, 0.0, 0.3]], rim])
    following = np.arange(2000) % 2000 + 1
    faces = np.stack([np.zeros(2000), following, np.roll(following, -1)], axis=1).astype(np.int32)
    wedges, values, level = made(positions, faces, 1200)
    assert np.bincount(level.faces.ravel()).max() > 1000
    fitted = kernel.fit(positions, faces, wedges, values, level, 20_000)
    assert gap(positions, faces, fitted) <= gap(positions, faces, level)
    np.testing.assert_allclose(fitted.values, fitted.positions, atol=0.02)


def test_samples_that_lose_their_face():
    """Few samples on rough surfaces: some have no face that looks their way after a move, and stay out."""
    for seed in range(12):
        positions, faces = bumpy(2)
        positions = positions + np.random.default_rng(seed).normal(0, 0.3, positions.shape)
        wedges, values, level = made(positions, faces, max(len(faces) // 4, 4))
        fitted = kernel.fit(positions, faces, wedges, values, level, 30 + 10 * seed, moves=4)
        assert np.isfinite(fitted.positions).all() and np.isfinite(fitted.values).all()


def test_without_values_positions_are_fitted_alone():
    positions, faces = bumpy(4, 0.03)
    wedges, values, level = made(positions, faces, 120, values=np.empty((len(positions), 0), np.float32))
    fitted = kernel.fit(positions, faces, wedges, values, level, 5000)
    assert gap(positions, faces, fitted) < 0.9 * gap(positions, faces, level)


def test_it_stops_when_told():
    positions, faces = bumpy(3)
    wedges, values, level = made(positions, faces, 100)
    same = kernel.fit(positions, faces, wedges, values, level, 500, go_on=lambda: False)
    np.testing.assert_array_equal(same.positions, level.positions)


def test_seams_hold_their_place_and_the_rest_moves():
    """A seam that was put aside comes back, unless it is told to stay."""
    tube = seam_cylinder(48, 24, tiles=1.0)
    wedges, values, level = made(tube.positions, tube.faces, 300, tube.wedges, tube.values)
    at_seam = np.hypot(tube.positions[:, 0] - 1, tube.positions[:, 1]) < 1e-9
    rows = np.unique(level.vertex_to[at_seam])
    level.positions[rows, 1] += 0.03

    def back(held):
        fitted = kernel.fit(tube.positions, tube.faces, wedges, values, level, 20_000, held=held)
        step = fitted.positions - level.positions
        return -step[rows, 1].mean(), np.abs(np.delete(step, rows, axis=0)).max()  # the seam runs along z

    free, told = back(None), back(np.where(at_seam, 1000, 0).astype(np.float32))
    assert free[0] > 5e-3 > 1e-4 > abs(told[0])
    assert told[1] > 0
    assert back(np.zeros(len(tube.positions), np.float32)) == free
