"""Rigged meshes through the decimator: weights and targets stay those of the place, and what bends stays bendable."""

import dataclasses

import numpy as np
import pytest

import lodpipe
from lodpipe.core.asset import Asset, Target
from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.geometry.decimate import decimate_asset
from lodpipe.geometry.distance import distance_between
from lodpipe.geometry.flatten import flatten
from lodpipe.geometry.joined import AttributeWeights
from lodpipe.geometry.rig import carry, is_rig
from lodpipe.kernel import QuadricOptions
from lodpipe.kernel.similarity import SimilarityOptions
from tests.geometry.rigs import bent, ramp, rigged, skinned, tube


def weight_of(mesh: Mesh, joint: int) -> np.ndarray:
    """What a joint weighs at each vertex; all wedges of a vertex agree."""
    each = (mesh.attributes["WEIGHTS_0"] * (mesh.attributes["JOINTS_0"] == joint)).sum(axis=1)
    out = np.full(len(mesh.positions), np.nan)
    out[mesh.faces] = each[mesh.wedges]
    assert (out[mesh.faces] == each[mesh.wedges]).all(), "a crack would open between two wedges"
    return out


def arm() -> Mesh:
    points, faces = tube()
    return skinned(points, faces, ramp(points[:, 0]))


@pytest.mark.parametrize("metric", ["quadric", "visual"])
@pytest.mark.parametrize("ratio", [0.5, 0.1])
def test_weights_are_those_of_the_place(metric, ratio):
    level = decimate_asset(rigged(arm()), [Target(ratio=ratio)], metric=metric)[1].meshes[0]
    assert len(level.faces) <= ratio * len(arm().faces) and list(level.attributes)[:2] == ["JOINTS_0", "WEIGHTS_0"]
    assert np.abs(weight_of(level, 1) - ramp(level.positions[:, 0])).max() < 0.02
    assert np.abs(level.attributes["WEIGHTS_0"].sum(axis=1) - 1).max() < 2e-7 * 4


@pytest.mark.parametrize(
    ("options", "target"),
    [
        (QuadricOptions(placement="endpoint"), Target(ratio=0.3)),
        (QuadricOptions(), Target(error=2.0)),
        (SimilarityOptions(metric="ray", collapse="half", keep_last=True), Target(ratio=0.6)),
        (SimilarityOptions(metric="ray", collapse="full", keep_last=True), Target(ratio=0.6)),
    ],
)
def test_every_way_to_a_level_carries_them(options, target):
    mesh = skinned(*tube(24, 8), ramp(tube(24, 8)[0][:, 0]))
    level = decimate_asset(rigged(mesh), [target], options)[1].meshes[0]
    assert 0 < len(level.faces) < len(mesh.faces)
    assert np.abs(weight_of(level, 1) - ramp(level.positions[:, 0])).max() < 0.2


def test_a_leg_never_follows_the_other():
    (one, faces), (two, _) = tube(y=0.0), tube(y=1.01)
    points, joints = np.concatenate([one, two]), np.zeros((2 * len(one), 4), np.float32)
    joints[len(one) :, 0] = 1
    weights = np.tile(np.array([1, 0, 0, 0], np.float32), (len(points), 1))
    mesh = Mesh(
        points,
        np.concatenate([faces, faces + np.int32(len(one))]),
        attributes={"JOINTS_0": joints, "WEIGHTS_0": weights},
        primitives=(Primitive(None, ("JOINTS_0", "WEIGHTS_0")),),
    )
    level = decimate_asset(rigged(mesh), [Target(ratio=0.05)])[1].meshes[0]
    assert (weight_of(level, 1) == (level.positions[:, 1] > 0.505)).all()


def test_what_bends_stays_bendable():
    """At rest the elbow is a straight tube, on which no vertex is worth more than another."""
    source, asset = arm(), rigged(arm())
    straight = Asset("a", (bent(source),))

    def off(motion: float) -> float:
        options = {"weights": AttributeWeights(motion=motion)}
        level = decimate_asset(asset, [Target(ratio=0.08)], **options)[1].meshes[0]
        return distance_between(flatten(straight), flatten(straight, (bent(level),)), 5000).mean

    assert off(AttributeWeights.motion) < 0.6 * off(0.0)


def test_targets_are_carried_and_steer():
    points, faces = tube()
    swell = np.zeros_like(points, np.float32)
    swell[:, 1:] = points[:, 1:] * np.exp(-((points[:, :1] - 2) ** 2) * 8)
    targets = {"MORPH_0_POSITION": swell, "MORPH_0_NORMAL": swell * 0}
    mesh = Mesh(points, faces, attributes=targets, primitives=(Primitive(None, tuple(targets)),))
    asset = Asset("a", (mesh,))

    def swollen(m: Mesh) -> Mesh:
        corner = np.zeros(len(m.positions), int)
        corner[m.faces] = m.wedges
        return Mesh(m.positions + m.attributes["MORPH_0_POSITION"][corner], m.faces)

    def off(motion: float) -> float:
        weights = AttributeWeights(motion=motion)
        level = decimate_asset(asset, [Target(ratio=0.1)], weights=weights)[1].meshes[0]
        assert list(level.attributes) == list(targets)
        full = Asset("a", (swollen(mesh),))
        return distance_between(flatten(full), flatten(full, (swollen(level),)), 5000).mean

    assert off(AttributeWeights.motion) < 0.7 * off(0.0)


def test_a_vertex_for_each_corner_is_no_seam():
    """Exporters without an index: the same levels as with one."""
    mesh = arm()
    rows = mesh.wedges.ravel()
    apart = dataclasses.replace(
        mesh,
        wedges=np.arange(len(rows), dtype=np.int32).reshape(-1, 3),
        attributes={name: values[rows] for name, values in mesh.attributes.items()},
    )
    one, two = (decimate_asset(rigged(m), [Target(ratio=0.2)])[1].meshes[0] for m in (mesh, apart))
    assert np.array_equal(one.positions, two.positions) and two.wedge_count == len(two.positions)
    corners = dataclasses.replace(apart, attributes={"NORMAL": np.eye(3, dtype=np.float32)[np.arange(len(rows)) % 3]})
    assert decimate_asset(rigged(corners), [Target(ratio=0.9)])[1].meshes[0].wedge_count > 2 * len(two.positions)


def test_the_source_is_its_own_level():
    mesh = arm()
    rows = np.arange(len(mesh.positions), dtype=np.int32)
    same = carry(mesh, mesh.positions, rows, rows, rows, rows, rows)
    assert all(np.array_equal(same[name], mesh.attributes[name]) for name in mesh.attributes)


def test_the_strongest_joints_remain():
    """The middle of an edge between vertices with four joints each, one of them in common."""
    joints = np.array([[1, 2, 3, 4], [4, 5, 6, 7], [1, 2, 3, 4]], np.float32)
    weights = np.array([[0.4, 0.3, 0.2, 0.1], [0.1, 0.5, 0.3, 0.1], [1, 0, 0, 0]], np.float32)
    mesh = Mesh(
        np.array([[0, 0, 0], [2, 0, 0], [0, 1, 0]], float),
        np.array([[0, 1, 2]], np.int32),
        attributes={"JOINTS_0": joints, "WEIGHTS_0": weights},
    )
    one, merged = np.array([-1], np.int32), np.array([0, 0, -1], np.int32)
    out = carry(mesh, np.array([[1.0, 0, 0]]), one, merged, np.array([0], np.int32), one, merged)
    assert out["JOINTS_0"][0].tolist() == [5, 1, 2, 6]
    assert np.allclose(out["WEIGHTS_0"][0], np.array([0.25, 0.2, 0.15, 0.15]) / 0.75)
    lost = carry(mesh, np.array([[1.9, 0, 0]]), one, one[:0], np.array([0], np.int32), one, one[:0])
    assert lost["JOINTS_0"][0].tolist() == [4, 5, 6, 7], "the nearest vertex stands in"


def test_names():
    rig = ["JOINTS_0", "WEIGHTS_1", "MORPH_3_POSITION", "MORPH_0_TEXCOORD_0"]
    assert [n for n in [*rig, "NORMAL", "_JOINTS_0", "COLOR_0", "MORPHS"] if is_rig(n)] == rig


def test_one_mesh_with_a_rig_beside_one_without():
    points, faces = tube(24, 8)
    up = np.tile(np.float32([0, 0, 1]), (len(points), 1))
    plain = Mesh(points + np.array([0, 3, 0]), faces, attributes={"NORMAL": up})
    asset = dataclasses.replace(rigged(skinned(points, faces, ramp(points[:, 0]))), meshes=())
    asset = dataclasses.replace(asset, meshes=(skinned(points, faces, ramp(points[:, 0])), plain))
    asset.document["nodes"].append({"mesh": 1})
    asset.document["scenes"][0]["nodes"].append(3)
    first, second = lodpipe.decimate(asset, 0.2).meshes
    assert list(first.attributes) == ["JOINTS_0", "WEIGHTS_0"] and list(second.attributes) == ["NORMAL"]
    assert np.abs(weight_of(first, 1) - ramp(first.positions[:, 0])).max() < 0.1
