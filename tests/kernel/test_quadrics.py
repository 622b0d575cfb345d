"""Quadrics as the papers define them."""

from __future__ import annotations

import numpy as np
import pytest

from lodpipe.kernel import WEIGHTINGS, quadrics
from lodpipe.kernel.quadrics import Quadric
from meshes import box, folded
from options import options

UNIT = np.eye(3)


def test_a_plane_quadric_is_the_squared_distance_to_the_plane():
    plane = Quadric.of_plane(np.array([0.6, 0.0, 0.8]), -2.0)
    assert plane.at(np.array([2.0, 7.0, 3.0])) == pytest.approx((1.2 + 2.4 - 2.0) ** 2)
    assert (plane + plane * 2).at(np.array([1.0, 0.0, 0.0])) == pytest.approx(3 * 1.4**2)


def some_face(seed: int, columns: int):
    """A random triangle and attributes at its corners, linear over space."""
    rng = np.random.default_rng(seed)
    corners, slope, start = rng.normal(size=(3, 3)), rng.normal(size=(columns, 3)), rng.normal(size=columns)
    return corners, corners @ slope.T + start, rng


@pytest.mark.parametrize("seed", range(8))
def test_both_attribute_quadrics_vanish_on_the_face_and_only_there(seed):
    corners, values, rng = some_face(seed, columns=3)
    for make in (quadrics.attribute_quadric, quadrics.attribute_quadric_gh98):
        quadric = make(corners, values)
        for at in [*UNIT, rng.dirichlet([1, 1, 1]), np.array([3.0, -1.0, -1.0])]:  # the last: in the plane, outside
            assert quadric.at(np.concatenate([at @ corners, at @ values])) == pytest.approx(0, abs=1e-9)
        assert quadric.at(np.concatenate([UNIT[0] @ corners, UNIT[0] @ values + 1])) > 0.01


@pytest.mark.parametrize("seed", range(8))
def test_gh98_measures_at_right_angles_what_hoppe_measures_along_the_axes(seed):
    """With σ the largest singular value of the attributes' gradients: GH98 ≤ H99 ≤ (1 + σ²) GH98."""
    corners, values, rng = some_face(seed, columns=2)
    steepest = np.linalg.norm(quadrics.gradients(corners, values)[0], 2)
    hoppe, gh98 = quadrics.attribute_quadric(corners, values), quadrics.attribute_quadric_gh98(corners, values)
    for point in rng.normal(size=(50, 5)):
        assert gh98.at(point) <= hoppe.at(point) * (1 + 1e-9)
        assert hoppe.at(point) <= (1 + steepest**2) * gh98.at(point) * (1 + 1e-9)


def test_attributes_that_do_not_change_make_both_quadrics_equal():
    corners, values = some_face(0, columns=2)[0], np.full((3, 2), 0.7)
    hoppe, gh98 = quadrics.attribute_quadric(corners, values), quadrics.attribute_quadric_gh98(corners, values)
    assert np.allclose(hoppe.A, gh98.A) and np.allclose(hoppe.b, gh98.b) and hoppe.c == pytest.approx(gh98.c)


def test_hoppes_rows_for_attributes_are_diagonal():
    """What makes it sparse, and lets every wedge of a vertex have rows of its own."""
    corners, values = some_face(1, columns=3)[:2]
    assert np.array_equal(quadrics.attribute_quadric(corners, values).A[3:, 3:], np.eye(3))
    assert np.abs(np.triu(quadrics.attribute_quadric_gh98(corners, values).A[3:, 3:], 1)).max() > 0.01


def test_the_minimum_falls_back_to_the_segment_and_to_its_middle():
    p, q = np.zeros(3), np.array([1.0, 0.0, 0.0])
    three = [Quadric.of_plane(UNIT[k], -at) for k, at in enumerate((0.3, 0.2, 0.1))]
    everywhere = three[0] + three[1] + three[2]
    assert quadrics.minimise(everywhere, p, q) == pytest.approx([0.3, 0.2, 0.1], abs=1e-3)
    far_off = Quadric.of_plane(UNIT[0], -9.0) + Quadric.of_plane(UNIT[1], 0.0) + Quadric.of_plane(UNIT[2], 0.0)
    assert np.array_equal(quadrics.minimise(far_off, p, q), q)  # its minimum lies at x = 9
    assert quadrics.minimise(three[0], p, q) == pytest.approx([0.3, 0.0, 0.0], abs=1e-3)
    assert np.array_equal(quadrics.minimise(Quadric.of_plane(UNIT[1], 0.0), p, q), [0.5, 0.0, 0.0])
    assert np.array_equal(quadrics.minimise(Quadric.zero(), p, q), [0.5, 0.0, 0.0])


def test_planes_of_a_box_meet_in_its_corners():
    for weighting in WEIGHTINGS:
        setting = options(weighting=weighting, crease_weight=0.0)
        found = quadrics.plane_quadrics(*box(), setting)
        for corner, quadric in zip(box()[0], found, strict=True):
            assert quadric.at(corner) == pytest.approx(0, abs=1e-12)
            assert np.allclose(np.linalg.solve(quadric.A, -quadric.b), corner)


def test_angle_weights_do_not_depend_on_how_a_square_is_cut():
    for quadric in quadrics.plane_quadrics(*box(), options(weighting="area-angle", crease_weight=0.0)):
        assert np.allclose(np.diag(quadric.A), 0.25)  # three right angles; area ½ · π/2 / π for each


@pytest.mark.parametrize(("degrees", "expected"), [(45.0, 0.0), (75.0, 2.5)])
def test_sharp_edges_alone_are_creases(degrees, expected):
    setting = options(weighting="uniform", boundary_weight=0.0, crease_weight=2.5, crease_degrees=60.0)
    positions, faces = folded(2, degrees)
    at_fold = quadrics.plane_quadrics(positions, faces, setting)[4]  # the middle vertex: six faces, two fold edges
    assert at_fold.trace == pytest.approx(6 + 4 * expected)
