"""Normals from triangles, smooth but for creases."""

from __future__ import annotations

import numpy as np
import pytest

from lodpipe.geometry.normals import crease_normals, face_normals
from meshes import box, grid, sphere


def slow_crease_normals(positions, faces, angle):
    """The definition, corner by corner."""
    flat = face_normals(positions, faces)
    result = np.zeros((len(faces), 3, 3))
    for f in range(len(faces)):
        for k in range(3):
            for other in range(len(faces)):
                for j in range(3):
                    if faces[other, j] != faces[f, k] or flat[f] @ flat[other] < np.cos(np.radians(angle)) - 1e-9:
                        continue
                    p, q, r = positions[faces[other, [j, (j + 1) % 3, (j + 2) % 3]]]
                    cosine = (q - p) @ (r - p) / np.linalg.norm(q - p) / np.linalg.norm(r - p)
                    result[f, k] += np.arccos(np.clip(cosine, -1, 1)) * flat[other]
    return result / np.linalg.norm(result, axis=2, keepdims=True)


def test_a_cube_keeps_its_edges():
    positions, faces = box()
    normals = crease_normals(positions, faces)
    np.testing.assert_allclose(normals, np.repeat(face_normals(positions, faces)[:, None], 3, axis=1), atol=1e-6)


def test_a_cube_under_a_wide_angle_is_smooth():
    positions, faces = box()
    np.testing.assert_allclose(
        crease_normals(positions, faces, angle=100), (positions / np.sqrt(0.75))[faces], atol=1e-6
    )


def test_a_sphere_is_smooth():
    positions, faces = sphere(4)
    np.testing.assert_allclose(crease_normals(positions, faces), positions[faces], atol=0.01)


@pytest.mark.parametrize("angle", [20.0, 45.0, 80.0])
def test_the_quick_way_agrees_with_the_definition(angle):
    rng = np.random.default_rng(4)
    positions, faces = sphere(2)
    positions = positions * rng.uniform(0.7, 1.3, (len(positions), 1))
    np.testing.assert_allclose(
        crease_normals(positions, faces, angle), slow_crease_normals(positions, faces, angle), atol=1e-5
    )


def test_faces_without_area_do_no_harm():
    positions, faces = grid(2)
    faces = np.concatenate([faces, [[0, 0, 1], [3, 4, 5]]]).astype(np.int32)
    normals = crease_normals(positions, faces)
    np.testing.assert_allclose(normals[:8], np.broadcast_to([0, 0, 1], (8, 3, 3)), atol=1e-6)
    assert np.isfinite(normals).all()
