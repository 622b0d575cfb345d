"""Animations sampled, joints turned, and what of a motion is worth a triangle."""

import dataclasses

import numpy as np
import pytest

from lodpipe.core.asset import Accessor
from lodpipe.geometry.poses import Bones, _poses, _sampled, motion
from tests.geometry.rigs import bent, ramp, rigged, skinned, tube


def at(time: float, values, how: str = "LINEAR", times=(0, 2), path: str = "translation"):
    accessors = [
        Accessor(np.array(times, np.float32)[:, None], "SCALAR"),
        Accessor(np.array(values, np.float32), "VEC"),
    ]
    channel = {"sampler": 0, "target": {"node": 5, "path": path}}
    animation = {"samplers": [{"input": 0, "output": 1, "interpolation": how}], "channels": [channel]}
    return _sampled(accessors, animation, time).get(5, {}).get(path)


def test_interpolation():
    ends = [[0, 0, 0], [2, 4, 8]]
    assert at(0.5, ends).tolist() == [0.5, 1, 2]
    assert at(1.9, ends, "STEP").tolist() == [0, 0, 0] and at(2, ends, "STEP").tolist() == [2, 4, 8]
    assert at(-1, ends).tolist() == [0, 0, 0] and at(9, ends).tolist() == [2, 4, 8]
    assert at(1, [[1, 1, 1]], times=(0,)).tolist() == [1, 1, 1]
    spline = [[0, 0, 0], [0, 0, 0], [1, 0, 0], [0, 0, 0], [2, 2, 2], [0, 0, 0]]
    assert at(1, spline, "CUBICSPLINE").tolist() == pytest.approx([1.25, 1, 1])  # glTF 2.0, appendix C.3
    half = at(1, [[0, 0, 0, 1], [0, 0, -1, 0]], path="rotation")
    assert np.abs(half) == pytest.approx([0, 0, np.sqrt(0.5), np.sqrt(0.5)])


def test_what_cannot_be_read_moves_nothing():
    assert at(0.5, [[0, 0, 0]]) is None, "a value for two times"
    assert at(0.5, [[0, 0], [1, 1]]) is None
    assert at(0.5, np.zeros((0, 3)), times=()) is None
    assert at(1, [[0, 0, 0, 0], [0, 0, 0, 0]], path="rotation").tolist() == [0, 0, 0, 1]


def test_a_pose_moves_the_joints_below():
    nodes = [{"children": [1], "translation": [0, 0, 1]}, {"children": [2], "rotation": [0, 0, 0, 1]}, {}, {"mesh": 0}]
    bones = Bones.of(nodes, [2, 1])
    assert list(bones.parent) == [0, 1, 2]
    turned = bones.matrices({1: {"rotation": np.array([0, 0, 1.0, 0])}, 2: {"translation": np.array([1.0, 0, 0])}})
    assert np.allclose(turned[0] @ [0, 0, 0, 1], [-1, 0, 1, 1]) and np.allclose(turned[1] @ [1, 0, 0, 1], [-1, 0, 1, 1])


def test_a_mesh_that_moves_as_a_whole_does_not_move():
    points, faces = tube()
    whole = skinned(points, faces, np.ones(len(points)))
    assert np.abs(motion(rigged(whole), 0, points)).max(initial=0) < 1e-5


def test_distances_are_those_of_the_poses():
    """One pose: the columns are as far apart as the displacements, after the affine map that suits all best."""
    points, faces = tube()
    mesh = skinned(points, faces, ramp(points[:, 0]))
    still = np.array([0, 0, 0.5, np.sqrt(0.75)])
    asset = rigged(mesh, (still, still))
    moved = bent(mesh, np.pi / 3).positions
    home = np.column_stack([points, np.ones(len(points))])
    affine = np.linalg.lstsq(home, moved, rcond=None)[0]
    left = (moved - home @ affine) / np.cbrt(np.linalg.det(affine[:3]))
    columns = motion(asset, 0, points)
    want, got = (np.linalg.norm(v[::7, None] - v[None, ::7], axis=2) for v in (left, columns))
    assert np.abs(want - got).max() < 0.15 * want.max()  # 98 % of the energy
    assert np.allclose(motion(asset, 0, points * 3), columns * 3, atol=1e-3), "in the unit of the positions"


def test_without_an_animation_joints_are_bent():
    points, faces = tube()
    asset = rigged(skinned(points, faces, ramp(points[:, 0])))
    still = dataclasses.replace(asset, document={**asset.document, "animations": []})
    poses = _poses(still, Bones.of(still.document["nodes"], [1, 2]), 5)
    assert len(poses) == 5 and all(abs(np.linalg.norm(p[2]["rotation"]) - 1) < 1e-12 for p in poses)
    assert motion(still, 0, points).shape[1] > 0
    assert np.array_equal(motion(still, 0, points), motion(still, 0, points))


def test_too_few_inverse_matrices():
    points, faces = tube(4, 4)
    asset = rigged(skinned(points, faces, ramp(points[:, 0])))
    short = (Accessor(asset.accessors[0].values[:1], "MAT4"), *asset.accessors[1:])
    assert np.isfinite(motion(dataclasses.replace(asset, accessors=short), 0, points)).all()
