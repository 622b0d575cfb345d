"""Closest points, facing surfaces and pictures, against every triangle looked at one by one, and against Open3D."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lodpipe.core.errors import InvalidMesh
from lodpipe.geometry.camera import Camera
from lodpipe.geometry.normals import crease_normals, face_normals
from lodpipe.kernel import surfaces
from lodpipe.kernel.surfaces import TriangleTree, raster
from lodpipe.o3d import RayScene
from meshes import grid, sphere

AXES = (np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), np.array([0, 0, -1.0]))


def rough(seed, level=2):
    """A crumpled sphere of about unit size, with slivers and faces without area."""
    rng = np.random.default_rng(seed)
    positions, faces = sphere(level)
    positions = (positions * rng.uniform(0.2, 0.6, (len(positions), 1))).astype(np.float32)
    positions[rng.integers(len(positions), size=5)] = positions[0]
    return positions, faces, rng


def nearest(points, positions, faces):
    """(P, F) float64 distances of points from triangles, within the triangle's plane and along its edges."""
    p = points.astype(np.float64)[:, None]
    a, b, c = (positions[faces[:, k]].astype(np.float64) for k in range(3))
    n = np.cross(b - a, c - a)
    square = np.einsum("fd,fd->f", n, n)
    with np.errstate(divide="ignore", invalid="ignore"):
        height = np.einsum("pfd,fd->pf", p - a, n) / np.sqrt(square)
    inside = np.broadcast_to(square > 0, height.shape).copy()
    best = np.full(height.shape, np.inf)
    for x, y in ((a, b), (b, c), (c, a)):
        along = y - x
        t = np.einsum("pfd,fd->pf", p - x, along) / np.maximum(np.einsum("fd,fd->f", along, along), 1e-300)
        best = np.minimum(best, np.linalg.norm(p - x - np.clip(t, 0, 1)[..., None] * along, axis=2))
        inside &= np.einsum("pfd,fd->pf", np.cross(along, p - x), n) >= 0
    return np.where(inside, np.abs(height), best)


@settings(max_examples=15)
@given(seed=st.integers(0, 10_000))
def test_the_closest_point_is_that_of_all_triangles(seed):
    positions, faces, rng = rough(seed)
    points = np.concatenate([rng.normal(0, 0.4, (200, 3)), positions[:20]]).astype(np.float32)
    distance, found, face = TriangleTree(positions, faces, 1).closest(points)
    every = nearest(points, positions, faces)
    np.testing.assert_allclose(distance, every.min(axis=1), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(every[np.arange(len(points)), face], distance, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found - points, axis=1), distance, rtol=1e-9, atol=1e-12)


def test_answers_do_not_depend_on_the_order_of_questions_nor_on_threads():
    positions, faces, rng = rough(3, level=4)
    points = np.concatenate([rng.normal(0, 0.4, (3000, 3)), positions, np.zeros((3, 3))]).astype(np.float32)
    order = rng.permutation(len(points))
    tree, two = TriangleTree(positions, faces, 1), TriangleTree(positions, faces, 2)
    for straight, shuffled in zip(tree.closest(points), two.closest(points[order]), strict=True):
        np.testing.assert_array_equal(straight[order], shuffled)


def test_of_equally_near_faces_the_first_counts():
    positions, faces = grid(6)
    doubled = np.concatenate([faces, faces, faces[:, ::-1]])
    _, _, face = TriangleTree(positions.astype(np.float32), doubled).closest(positions.astype(np.float32))
    assert face.max() < len(faces)


def test_many_faces_in_one_place():
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    faces = np.tile(np.array([[0, 1, 2]], np.int32), (5000, 1))
    distance, _, face = TriangleTree(positions, faces).closest(np.array([[0.2, 0.2, 0.5]], np.float32))
    assert (distance[0], face[0]) == (0.5, 0)


def test_closest_points_agree_with_open3d():
    positions, faces, rng = rough(5, level=5)
    points = (positions[rng.integers(len(positions), size=5000)] + rng.normal(0, 0.01, (5000, 3))).astype(np.float32)
    theirs, _ = RayScene(positions, faces).closest(points)
    ours, _, _ = TriangleTree(positions, faces).closest(points)
    np.testing.assert_allclose(ours, np.linalg.norm(theirs.astype(float) - points, axis=1), atol=2e-6)


@settings(max_examples=15)
@given(seed=st.integers(0, 10_000))
def test_the_nearest_surface_that_faces_the_same_way(seed):
    positions, faces, rng = rough(seed)
    points = rng.normal(0, 0.3, (150, 3)).astype(np.float32)
    normals = rng.normal(size=(150, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    reach = rng.uniform(0, 0.8, 150)
    found = TriangleTree(positions, faces, 1).facing(points, normals, reach)
    a, b, c = (positions[faces[:, k]].astype(np.float64) for k in range(3))
    product = normals @ np.cross(b - a, c - a).T
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.einsum("pfd,fd->pf", a - points.astype(np.float64)[:, None], np.cross(b - a, c - a)) / product
    met = points.astype(np.float64)[:, None] + t[..., None] * normals[:, None]
    inside = product > 0
    for x, y in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("pfd,fd->pf", np.cross(y - x, met - x), np.cross(b - a, c - a)) >= 0
    away = np.where(inside, np.abs(t), np.inf)
    expected = np.where(away.min(axis=1) <= reach, away.argmin(axis=1), -1)
    assert (found == expected).mean() > 0.99  # but for lines that meet an edge
    assert (expected >= 0).any()


def test_what_a_tree_refuses():
    positions, faces = grid(2)
    with pytest.raises(InvalidMesh, match="not finite"):
        TriangleTree(positions * np.nan, faces)
    with pytest.raises(InvalidMesh, match="outside"):
        TriangleTree(positions, faces + np.int32(5))
    empty = TriangleTree(positions, faces[:0])
    with pytest.raises(ValueError, match="no closest points"):
        empty.closest(positions)
    assert empty.facing(positions, positions, positions[:, 0]).tolist() == [-1] * len(positions)


@pytest.mark.parametrize("fov", [None, 40.0])
def test_a_drawn_picture_is_what_rays_meet(fov):
    positions, faces, _ = rough(1, level=4)
    camera = Camera.around(np.zeros(3), 0.7, (0.3, 0.4, 1.0), fov=fov)
    size = camera.height / 2 if fov is None else np.tan(np.radians(fov / 2))
    right, up, back = camera.axes
    view = positions, faces, (camera.position, right, up, -back), float(size), fov is not None, (90, 120)
    ours = raster(*view, slice(10, 80))
    origins, directions = camera.rays(120, 90, slice(10, 80), np.zeros(3), 1.0)
    scene = RayScene(positions, faces)
    theirs = scene.cast(origins, directions)
    same = ours.faces == theirs.faces
    assert same.mean() > 0.999
    hit = same & (ours.faces >= 0)
    assert hit.mean() > 0.3
    np.testing.assert_allclose(ours.distance[hit], theirs.distance[hit], rtol=1e-5)
    assert np.quantile(np.abs(ours.uv[hit] - theirs.uv[hit]), 0.999) < 1e-3
    # and the next surface behind what was met first
    behind = np.where(hit, ours.distance + np.float32(1e-4), np.float32(np.inf))
    second = raster(*view, slice(10, 80), behind=behind)
    rays = np.flatnonzero(hit)
    below = scene.cast(origins[rays] + directions[rays] * behind[rays, None], directions[rays])
    assert (second.faces[rays] == below.faces).mean() > 0.999
    assert (second.faces[~hit] == -1).all()


def test_nothing_shines_through_between_two_faces():
    """Edges that run exactly through pixels' centres, and all others."""
    for turn in (0.0, 0.3, np.pi / 4, 1.1):
        positions, faces = grid(32)
        positions = (positions - [0.5, 0.5, 1.0]) * [2.2, 2.2, 1.0]
        spun = positions @ np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
        hits = raster(spun.astype(np.float32), faces, AXES, 0.75, False, (64, 64), slice(None))
        assert (hits.faces >= 0).all()


def test_a_vertex_beside_the_eye_takes_real_rays():
    positions, faces = sphere(2)
    assert raster(positions.astype(np.float32), faces, AXES, 0.5, True, (8, 8), slice(None)) is None
    assert raster(positions.astype(np.float32), faces, AXES, 0.5, False, (8, 8), slice(None)) is not None


def test_a_vertex_of_very_many_creased_faces_takes_no_time():
    count = 40_000
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    rim = np.stack([np.cos(angle), np.sin(angle), np.where(np.arange(count) % 2, 1.0, 3.0)], axis=1)
    positions = np.concatenate([[[0.0, 0, 0]], rim])
    ring = np.arange(count)
    faces = np.stack([0 * ring, 1 + ring, 1 + (ring + 1) % count], axis=1).astype(np.int32)
    normals = crease_normals(positions, faces, 60.0)
    assert np.einsum("fd,fd->f", normals[:, 0], face_normals(positions, faces)).min() > 0.4


def test_normals_of_faces():
    positions, faces, _ = rough(7)
    faces[3] = faces[3, 0]
    expected = face_normals(positions, faces)
    np.testing.assert_allclose(surfaces.face_normals(positions, faces), expected, atol=1e-6)
    assert not expected[3].any()
