import dataclasses

import numpy as np
import pytest

import limbs
from lodpipe.core.asset import Asset, Target
from lodpipe.core.errors import InvalidMesh
from lodpipe.core.material import Material
from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.geometry.decimate import decimate_asset
from lodpipe.geometry.importance import ImportanceOptions, importance
from lodpipe.geometry.parts import PartRule, part
from lodpipe.geometry.segment import segment
from lodpipe.geometry.skeleton import skeleton


@pytest.fixture(scope="module")
def star():
    asset = limbs.asset(limbs.star(4, hub=0.3))
    asset = dataclasses.replace(asset, skeleton=skeleton(asset))
    return dataclasses.replace(asset, segments=segment(asset, asset.skeleton))


def ruled(asset, **rules):
    return dataclasses.replace(asset, importance=importance(asset, ImportanceOptions(parts=rules)))


def inside(level, positions):
    """How many of `positions` are vertices of the level, to the last bit."""
    have = {p.tobytes() for p in level.meshes[0].positions}
    return sum(p.tobytes() in have for p in positions)


@pytest.mark.parametrize("metric", ["quadric", "visual"])
def test_what_is_pinned_stays_to_the_last_bit(star, metric):
    tips = part(star, "end").vertices[0]
    asset = ruled(star, end=PartRule(keep=1.0))
    level = decimate_asset(asset, [Target(ratio=0.3)], metric=metric)[1]
    positions = asset.meshes[0].positions[tips]
    assert len(positions) > 20
    assert inside(level, positions) == len(positions)
    plain = decimate_asset(star, [Target(ratio=0.3)], metric=metric)[1]
    assert inside(plain, positions) < len(positions)


def test_a_branch_keeps_its_share(star):
    faces = part(star, "branch2").faces[0]

    def left(level):
        at = star.meshes[0].positions[star.meshes[0].faces[faces]].mean(axis=(0, 1))
        middles = level.meshes[0].positions[level.meshes[0].faces].mean(axis=1)
        return int((middles @ at / np.linalg.norm(at) > 0.45).sum())

    asset = ruled(star, branch2=PartRule(keep=0.6))
    goals = [Target(ratio=0.4), Target(ratio=0.2)]
    levels = decimate_asset(asset, goals)
    for kept, plain in zip(levels[1:], decimate_asset(star, goals)[1:], strict=True):
        assert kept.triangles <= plain.triangles + 1
        assert left(kept) > left(plain)
        assert left(kept) >= 0.5 * left(levels[0])  # of the branch and a little more


def test_weights_of_parts_multiply(star):
    found = importance(star, ImportanceOptions(parts={"main": PartRule(weight=5), "branch": PartRule(weight=0.5)}))
    main = part(star, "main").vertices[0]
    assert found.weight[0][main] == pytest.approx(5)
    assert found.weight[0][~main] == pytest.approx(0.5)


def test_names_of_nodes_meshes_and_materials():
    mesh = limbs.star(2)
    halves = (mesh.positions[mesh.faces].mean(axis=1)[:, 0] > 0).astype(np.int32)
    mesh = Mesh(mesh.positions, mesh.faces, face_primitive=halves, primitives=(Primitive(0), Primitive(1)), name="rod")
    document = {"scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"name": "stick", "mesh": 0}]}
    asset = Asset("a", (mesh,), (Material({"name": "red"}), Material({"name": "blue"})), document=document)
    assert part(asset, "rod").vertices[0].all()
    assert part(asset, "stick").faces[0].all()
    assert np.array_equal(part(asset, "blue").faces[0], halves == 1)
    with pytest.raises(InvalidMesh, match="there is no part 'blu'; did you mean 'blue'"):
        part(asset, "blu")


def test_segments_are_missed_in_so_many_words():
    with pytest.raises(InvalidMesh, match="segments need `skeleton` and `segment`"):
        part(limbs.asset(limbs.star(2)), "main")
