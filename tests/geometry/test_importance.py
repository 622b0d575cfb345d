import dataclasses

import numpy as np
import pytest

import limbs
import meshes
from lodpipe.core.asset import Asset
from lodpipe.core.errors import InvalidMesh
from lodpipe.core.mesh import Mesh
from lodpipe.geometry.flatten import flatten_once
from lodpipe.geometry.importance import (
    BORDER,
    TERMINAL,
    ImportanceOptions,
    importance,
    mesh_saliency,
    seen_share,
)
from lodpipe.geometry.segment import segment
from lodpipe.geometry.skeleton import skeleton


def shaped(mesh):
    asset = limbs.asset(mesh)
    asset = dataclasses.replace(asset, skeleton=skeleton(asset))
    return dataclasses.replace(asset, segments=segment(asset, asset.skeleton))


def test_each_branch_has_a_triangle_that_is_reserved():
    asset = shaped(limbs.star(5, hub=0.3))
    found = importance(asset)
    positions = asset.meshes[0].positions
    assert len(found.reserved) == 5
    out = np.linalg.norm(positions[found.reserved], axis=2)
    assert out[:, 0].min() > 1.05  # terminal vertices
    assert out[:, 1:].max() < 0.8  # the pair at the branch's root
    apart = np.linalg.norm(positions[found.reserved[:, 1]] - positions[found.reserved[:, 2]], axis=1)
    assert apart.min() > 0.2
    assert (found.extreme[0][found.reserved[:, 0]] == TERMINAL).all()


def test_borders_and_volumetric_points_weigh_more_than_the_rest():
    asset = shaped(limbs.star(4, hub=0.3))
    extreme = importance(asset).extreme[0]
    assert (extreme[asset.segments.border[0]] >= BORDER).all()
    assert (extreme == 1).mean() > 0.5
    hub = np.linalg.norm(asset.meshes[0].positions, axis=1) < 0.35
    assert (extreme[hub] > BORDER).any()  # where rays to the joint meet the body


def test_without_a_skeleton_nothing_fades_in():
    found = importance(limbs.asset(limbs.star(3)))
    assert len(found.reserved) == 0
    assert (found.extreme[0] == 1).all()
    assert (found.weight[0] == 1).all()


def test_painted_red_protects_blue_reduces_grey_is_neutral():
    positions, faces = meshes.grid(4)
    colour = np.full((len(positions), 4), 0.5, np.float32)
    colour[0, :3], colour[1, :3] = (1, 0, 0), (0, 0, 1)
    asset = Asset("sheet", (Mesh(positions, faces, attributes={"_WEIGHT": colour, "COLOR_0": colour}),))
    weight = importance(asset, ImportanceOptions(painted="_WEIGHT")).weight[0]
    assert weight[:3] == pytest.approx([100, 0.01, 1])
    assert (importance(asset).weight[0] == 1).all()  # an ordinary COLOR_0 is never taken for weights


def test_a_number_is_the_weight_itself_within_bounds():
    positions, faces = meshes.grid(2)
    values = np.linspace(-1, 1000, len(positions)).astype(np.float32)[:, None]
    asset = Asset("sheet", (Mesh(positions, faces, attributes={"_W": values}),))
    weight = importance(asset, ImportanceOptions(painted="_W")).weight[0]
    assert weight[0] == pytest.approx(0.01)
    assert weight[-1] == pytest.approx(100)


def test_an_attribute_that_is_not_there_is_named_with_those_that_are():
    mesh = Mesh(*meshes.grid(), attributes={"COLOR_0": np.ones((4, 4), np.float32)})
    with pytest.raises(InvalidMesh, match="'_WEIGHT' for painted weights; there are: COLOR_0"):
        importance(Asset("sheet", (mesh,)), ImportanceOptions(painted="_WEIGHT"))


def test_what_is_hidden_is_not_seen():
    outer, inner = meshes.sphere(3), meshes.sphere(2, 0.3)
    asset = limbs.asset(Mesh(*outer), Mesh(*inner))
    share = seen_share(flatten_once(asset), np.concatenate([np.eye(3), -np.eye(3)]))
    assert share[: len(outer[0])].min() > 0
    assert share[len(outer[0]) :].max() == 0
    weight = importance(asset, ImportanceOptions(visibility=1.0)).weight
    assert weight[1].max() == pytest.approx(0.1)  # a floor above zero


def test_saliency_is_where_curvature_stands_out():
    positions, faces = meshes.grid(40)
    bump = np.exp(-((positions[:, :2] - 0.5) ** 2).sum(axis=1) / 0.002)
    positions[:, 2] = 0.06 * bump
    inner = (np.abs(positions[:, :2] - 0.5) < 0.4).all(axis=1)
    saliency = mesh_saliency(flatten_once(limbs.asset(Mesh(positions, faces))))
    assert saliency.max() == 1
    top = np.argmax(np.where(inner, saliency, 0))
    assert np.linalg.norm(positions[top, :2] - 0.5) < 0.1


@pytest.mark.parametrize("size", [1e-12, 1e9])
def test_size_and_place_do_not_matter(size):
    mesh = limbs.star(3)
    here = importance(shaped(mesh), ImportanceOptions(saliency=1.0))
    there = importance(shaped(Mesh(mesh.positions * size, mesh.faces)), ImportanceOptions(saliency=1.0))
    assert there.weight[0] == pytest.approx(here.weight[0], rel=1e-3, abs=1e-2)
    assert len(there.reserved) == 3


def test_odd_meshes():
    for mesh in (meshes.triangle(), meshes.messy(), meshes.book(), (np.zeros((0, 3)), np.zeros((0, 3), int))):
        found = importance(shaped(Mesh(*mesh)), ImportanceOptions(visibility=0.5, saliency=1.0))
        assert np.isfinite(found.weight[0]).all()
        assert (found.weight[0] > 0).all()
        assert len(found.weight[0]) == len(mesh[0])


def test_options_out_of_range():
    with pytest.raises(InvalidMesh, match="strength"):
        importance(limbs.asset(limbs.star(2)), ImportanceOptions(strength=2))
    with pytest.raises(InvalidMesh, match="camera"):
        importance(limbs.asset(limbs.star(2)), ImportanceOptions(cameras=((0, 0, 0),)))
