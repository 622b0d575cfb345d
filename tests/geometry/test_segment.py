import numpy as np
import pytest

import limbs
import meshes
from lodpipe.core.mesh import Mesh
from lodpipe.geometry.segment import segment
from lodpipe.geometry.skeleton import skeleton
from lodpipe.geometry.skeleton_view import skeleton_model


def cut(*parts):
    asset = limbs.asset(*parts)
    return asset, segment(asset, skeleton(asset))


@pytest.mark.parametrize("arms", [3, 5, 8])
def test_a_star_is_cut_into_its_arms(arms):
    asset, found = cut(limbs.star(arms, hub=0.35))
    assert found.names == ("main", *(f"branch{i + 1}" for i in range(arms)))
    positions, label = asset.meshes[0].positions, found.vertex_segment[0]
    out = np.linalg.norm(positions, axis=1)
    assert (label[out < 0.36] == 0).mean() > 0.9
    assert (label[out > 0.75] > 0).mean() > 0.95
    for branch in range(1, arms + 1):  # each branch lies on one side
        mine = positions[label == branch]
        middle = mine.mean(axis=0)
        assert ((mine @ middle) > 0).all()


def test_borders_part_the_segments():
    asset, found = cut(limbs.star(4))
    mesh, label, border = asset.meshes[0], found.vertex_segment[0], found.border[0]
    own = label[mesh.faces]
    mixed = (own != own[:, :1]).any(axis=1)
    assert mixed.any()
    assert border[mesh.faces[mixed]].all()
    assert border.sum() == len(np.unique(mesh.faces[mixed]))


def test_parts_are_the_types_of_the_nodes():
    asset, found = cut(limbs.star(4))
    sizes = np.linalg.norm(asset.meshes[0].positions, axis=1)
    assert set(np.unique(found.vertex_part[0])) == {0, 1, 2}
    assert sizes[found.vertex_part[0] == 0].min() > sizes[found.vertex_part[0] == 2].max()


def test_components_have_names_of_their_own():
    ball = meshes.sphere()
    far = Mesh(ball[0] + [5, 0, 0], ball[1])
    _, found = cut(Mesh(*ball), far)
    assert found.names == ("part1.main", "part2.main")
    assert [set(v.tolist()) for v in found.vertex_segment] == [{0}, {1}]


def test_a_ring_is_one_main_body():
    _, found = cut(Mesh(*meshes.torus()))
    assert found.names == ("main",)


def test_without_triangles():
    _, found = cut(Mesh(np.zeros((2, 3)), np.zeros((0, 3), int)))
    assert found.names == ()
    assert (found.vertex_segment[0] == -1).all()


def test_the_model_to_look_at_has_both_in_their_colours():
    asset = limbs.asset(limbs.star(3))
    found = skeleton(asset)
    model = skeleton_model(asset, found, segment(asset, found))
    assert [m.name for m in model.meshes] == ["skeleton", "segments"]
    assert len(model.meshes[1].faces) == len(asset.meshes[0].faces)
    assert len(np.unique(model.meshes[1].attributes["COLOR_0"], axis=0)) == 4
    low, high = asset.meshes[0].positions.min(axis=0), asset.meshes[0].positions.max(axis=0)
    assert (model.meshes[0].positions > low - 0.1).all()
    assert (model.meshes[0].positions < high + 0.1).all()
