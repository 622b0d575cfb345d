from __future__ import annotations

import numpy as np

from lodpipe.io.clean import directions, drop_doubles, face_cross, has_area, vertex_normals
from meshes import box, sphere


def test_only_exact_doubles_go() -> None:
    faces = np.array([[0, 1, 2], [1, 2, 0], [0, 2, 1], [0, 1, 2], [3, 3, 4], [3, 3, 4]])
    owner = np.array([0, 0, 0, 1, 0, 0])
    said: list[str] = []
    keep = drop_doubles(faces, owner, "m", said.append)
    assert keep.tolist() == [0, 2, 3, 4, 5], "turned over, of another primitive, and without area: all stay"
    assert said == ["m: 1 face that are exact doubles of others left out"]


def test_normals_of_a_box_and_of_a_line() -> None:
    points, faces = box()
    normals = vertex_normals(points, faces)
    assert np.array_equal(np.sign(normals), np.sign(points)) and np.allclose(np.linalg.norm(normals, axis=1), 1)
    flat = vertex_normals(points, np.array([[0, 0, 1]]))
    assert np.array_equal(flat, np.tile([0, 0, 1], (8, 1)))


def test_areas_at_any_scale() -> None:
    points, faces = sphere(2)
    for scale in (1e-150, 1.0, 1e150):
        assert has_area(points * scale, faces)
        cross = face_cross(points * scale + 5 * scale, faces)
        assert np.isfinite(cross).all() and (np.einsum("fk,fk->f", cross, points[faces[:, 0]]) > 0).all()
    line = np.outer(np.arange(9.0), (1, 2, 3))
    assert not has_area(line, np.array([[0, 1, 2], [3, 3, 4], [8, 0, 4]]), chunk=1)
    assert has_area(np.vstack([line, [[1, 0, 0]]]), np.array([[0, 1, 2], [0, 1, 9]]), chunk=1)


def test_directions_touch_only_what_is_wrong() -> None:
    points, faces = sphere(1)
    good = (points / np.linalg.norm(points, axis=1, keepdims=True)).astype(np.float32)
    assert directions(good, points, faces, faces) is good
    bad = good.copy()
    bad[0], bad[1] = 0, good[1] * 7
    fixed = directions(bad, points, faces, faces)
    assert np.array_equal(fixed[2:], good[2:])
    assert np.allclose(fixed[:2], good[:2], atol=1e-6)
