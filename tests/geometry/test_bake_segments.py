"""Which segments may be baked onto which faces."""

from __future__ import annotations

import numpy as np

from lodpipe.core.mesh import Mesh
from lodpipe.geometry.bake_segments import SegmentFilter, asked
from lodpipe.geometry.bake_source import SourceMesh
from meshes import grid


def comb() -> tuple[Mesh, np.ndarray]:
    """A hand (0) with two fingers (1, 2) that touch the hand and not each other: strips of a sheet, 0 at the bottom."""
    positions, faces = grid(6)
    x, y = positions[:, 0], positions[:, 1]
    gap = (np.abs(x - 0.5) < 0.1) & (y > 0.4)
    faces = faces[~gap[faces].any(axis=1)]
    return Mesh(positions, faces), np.where(y < 0.4, 0, np.where(x < 0.5, 1, 2)).astype(np.int32)


def test_a_face_may_show_its_segment_and_those_that_touch_it():
    mesh, segment = comb()
    filter_ = SegmentFilter(mesh, segment)
    fingers = [filter_.allowed(number) for number in (1, 2)]
    of_face = filter_.of_face
    assert set(of_face[fingers[0]]) == {0, 1} and set(of_face[fingers[1]]) == {0, 2}
    assert filter_.allowed(0).all()


def test_faces_without_a_segment_are_shown_by_all_and_show_all():
    mesh, segment = comb()
    segment[segment == 2] = -1
    filter_ = SegmentFilter(mesh, segment)
    assert filter_.allowed(1).all() and filter_.allowed(-1).all()


def test_a_level_takes_the_segments_that_lie_nearest():
    mesh, segment = comb()
    source = SourceMesh(mesh, 1, segment)
    assert np.array_equal(source.segments_of(mesh), SegmentFilter(mesh, segment).of_face)
    assert (SourceMesh(mesh, 1).segments_of(mesh) == -1).all()
    assert asked(mesh).shape == (4 * len(mesh.faces), 3)


def test_a_finger_does_not_show_the_one_beside_it():
    """Two fingers side by side: a level of the first that lies nearer to the second still finds the first."""
    sheet, faces = grid(3)
    fingers = [sheet, sheet + np.array([0, 0, 1.0])]
    hand = np.array([[0, 0, -9], [0.1, 0, -9], [0, 0.1, -9]])
    joints = [[0, 1, 32], [16, 17, 33]]  # a face of each finger reaches the hand, so that both touch it
    positions = np.concatenate([*fingers, hand])
    source = Mesh(positions, np.concatenate([faces, faces + 16, [[32, 33, 34]], joints]).astype(np.int32))
    segment = np.repeat([1, 2, 0], [16, 16, 3]).astype(np.int32)
    points = np.array([[0.5, 0.5, 0.8]])
    up = np.array([[0, 0, 1.0]])
    known = SourceMesh(source, 1, segment)
    for number, height in ((1, 0.0), (2, 1.0)):
        found = known.find(points, up, 2.0, known.allowed(-1, number))
        assert np.allclose(known.points(found), [[0.5, 0.5, height]], atol=1e-5)
