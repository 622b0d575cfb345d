"""Ambient occlusion against what is known of simple shapes."""

from __future__ import annotations

import numpy as np

from lodpipe.core.asset import Asset
from lodpipe.core.mesh import Mesh
from lodpipe.geometry.occlusion import Occlusion
from meshes import box, grid

UP = np.array([[0, 0, 1.0]])


def asset_of(*meshes: Mesh) -> Asset:
    return Asset("thing", meshes)


def test_a_plane_sees_the_whole_sky_and_a_box_s_inside_none():
    plane = Occlusion(asset_of(Mesh(*grid(2))), threads=1)
    assert plane.at(0, np.array([[0.5, 0.5, 0.0]]), UP) == 1
    positions, faces = box()
    small = Mesh(np.concatenate([positions * 0.1, [[5, 5, 5]]]), faces)  # what is far makes the box small beside it
    far = Mesh(np.array([[5.0, 5, 5], [5.1, 5, 5], [5, 5.1, 5]]), np.array([[0, 1, 2]], np.int32))
    inside = Occlusion(asset_of(small, far), threads=1)
    assert inside.at(0, np.zeros((1, 3)), UP) == 0


def test_before_a_wall_half_the_sky_is_open():
    """At the foot of a wall that nothing overtops half of the directions, by symmetry, meet it."""
    floor = Mesh(
        np.array([[-9.0, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]]), np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    )
    wall = Mesh(floor.positions[:, [2, 0, 1]], floor.faces)
    sky = Occlusion(asset_of(floor, wall), rays=256, threads=1)
    seen = sky.at(0, np.array([[0.01, 0.3, 0.0], [0.01, -0.2, 0.0]]), np.repeat(UP, 2, axis=0))
    assert np.abs(seen - 0.5).max() < 0.02


def test_the_same_for_any_batch_and_in_any_company(monkeypatch):
    sky = Occlusion(asset_of(Mesh(*box())), threads=1)
    points = np.random.default_rng(0).random((50, 3)) - 0.5
    normals = np.repeat(UP, 50, axis=0)
    whole = sky.at(0, points, normals)
    monkeypatch.setattr("lodpipe.geometry.occlusion.BATCH", 64)
    assert np.array_equal(whole, sky.at(0, points, normals))
    assert np.array_equal(whole[7:9], sky.at(0, points[7:9], normals[7:9]))
