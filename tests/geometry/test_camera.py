"""Cameras and their rays."""

from __future__ import annotations

import numpy as np
import pytest

from lodpipe.core.asset import Asset
from lodpipe.core.mesh import Mesh
from lodpipe.geometry.camera import CARDINAL, Camera, bounding_sphere, views
from lodpipe.geometry.flatten import flatten
from meshes import box, sphere

ALL = slice(None)


@pytest.mark.parametrize("fov", [30.0, 90.0, None])
@pytest.mark.parametrize("direction", [(1, 2, 3), (0, 1, 0), (0, -1, 0), (0, 0, 1)])
def test_a_sphere_just_fits(fov, direction):
    centre, radius = np.array([10.0, -5, 3]), 2.5
    camera = Camera.around(centre, radius, direction, fov=fov, margin=1.0)
    origins, directions = camera.rays(201, 201, ALL, np.zeros(3), 1.0)
    assert np.linalg.norm(directions, axis=1) == pytest.approx(1, abs=1e-5)
    nearest = origins + directions * ((centre - origins) * directions).sum(axis=1, keepdims=True)
    hit = (np.linalg.norm(nearest - centre, axis=1) <= radius).reshape(201, 201)
    assert hit[100, 100]
    assert hit[:, 100].sum() >= 198  # from top to bottom
    assert not hit[0, 0]


def test_right_and_up():
    camera = Camera(np.array([0.0, 0, 5]), np.zeros(3))
    origins, directions = camera.rays(4, 2, ALL, np.zeros(3), 1.0)
    directions = directions.reshape(2, 4, 3)
    np.testing.assert_allclose(origins, np.broadcast_to([0, 0, 5], (8, 3)))
    assert (np.diff(directions[:, :, 0], axis=1) > 0).all()
    assert (directions[0, :, 1] > 0).all()
    assert (directions[1, :, 1] < 0).all()
    rows = camera.rays(4, 2, slice(1, 2), np.zeros(3), 1.0)[1]
    np.testing.assert_array_equal(rows, directions[1])


@pytest.mark.parametrize("fov", [40.0, None])
def test_the_size_of_a_pixel(fov):
    camera = Camera.around(np.zeros(3), 1.0, (0, 0, 1), fov=fov)
    origins, directions = camera.rays(101, 101, ALL, np.zeros(3), 2.0)
    constant, growing = camera.pixel_size(101, 2.0)
    distance = 3.0
    ends = (origins + directions * distance / -directions[:, 2:]).reshape(101, 101, 3)
    assert ends[50, 51, 0] - ends[50, 50, 0] == pytest.approx(constant + growing * distance, rel=1e-4)


def test_each_cardinal_view_sees_one_side_of_a_box():
    """A box of another width, height and depth: its outline tells from where it is seen."""
    size = {"x": 1.0, "y": 2.0, "z": 4.0}
    seen = {"front": "xyz", "back": "xyz", "left": "zyx", "right": "zyx", "top": "xzy", "bottom": "xzy"}
    assert set(CARDINAL) == set(seen)
    for name, (across, up, depth) in seen.items():
        camera = Camera.around(np.zeros(3), 3.0, CARDINAL[name], fov=None)
        right, above, back = camera.axes
        extent = np.array([size["x"], size["y"], size["z"]])
        assert np.abs([right, above, back]) @ extent == pytest.approx([size[across], size[up], size[depth]])
        assert back @ CARDINAL[name] == pytest.approx(1)
    assert np.cross(CARDINAL["top"], CARDINAL["front"]) == pytest.approx(CARDINAL["right"])


def test_the_bounding_sphere():
    asset = Asset("two", (Mesh(sphere(2, radius=2.0)[0] + [7.0, 0, 0], sphere(2)[1]),))
    centre, radius = bounding_sphere(flatten(asset))
    np.testing.assert_allclose(centre, [7, 0, 0])
    assert radius == pytest.approx(2)
    assert bounding_sphere(flatten(Asset("box", (Mesh(*box(1e200)),))))[1] == pytest.approx(np.sqrt(0.75) * 1e200)
    assert bounding_sphere(flatten(Asset("empty", ())))[1] == 1.0


def test_views_are_spread_evenly():
    directions = views(200)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    np.testing.assert_allclose(directions.mean(axis=0), 0, atol=0.01)
    cosines = directions @ directions.T - 2 * np.eye(200)
    nearest = np.degrees(np.arccos(cosines.max(axis=1)))
    assert nearest.min() > 0.7 * nearest.max()
