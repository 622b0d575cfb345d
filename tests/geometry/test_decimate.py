"""Whole assets: one budget over all meshes, their places and sizes, their own attributes and materials."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import lodpipe
from lodpipe.core.asset import Asset, Target
from lodpipe.core.errors import Cancelled, InvalidMesh
from lodpipe.core.material import Material
from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.geometry.decimate import decimate, decimate_asset
from lodpipe.geometry.distance import distance_between
from lodpipe.geometry.flatten import flatten
from lodpipe.geometry.joined import AttributeWeights, Joined
from measures import open_edges, volume, welded
from meshes import box, bumpy, grid, sphere, terrain, uv_sphere
from options import SET, options


def asset(*meshes, nodes=None):
    """An asset of meshes, each placed by a node (`nodes`: their glTF forms), or once where it lies."""
    nodes = [{"mesh": i} for i in range(len(meshes))] if nodes is None else nodes
    document = {"nodes": nodes, "scenes": [{"nodes": list(range(len(nodes)))}], "scene": 0}
    return Asset(name="test", meshes=tuple(meshes), document=document)


def counts(level):
    return [len(mesh.faces) for mesh in level.meshes]


def levels(source, *targets, setting=SET, **more):
    return decimate_asset(
        source, [t if isinstance(t, Target) else Target(triangles=t) for t in targets], setting, **more
    )


# ---------------------------------------------------------------------------------------------------------- one budget


def test_triangles_go_where_the_error_is():
    """A ball beside a flat sheet of as many faces: the sheet needs two triangles, the ball gets the rest."""
    ball, sheet = Mesh(*sphere(4)), Mesh(*grid(32, height=3.0))
    assert len(ball.faces) == len(sheet.faces) == 2048
    source, level = levels(asset(ball, sheet), 402)
    assert source.meshes == (ball, sheet)
    assert sum(counts(level)) in (401, 402) and level.stop_reason == "target"
    assert counts(level)[1] <= 10 and counts(level)[0] >= 390


def test_a_mesh_shown_larger_gets_more():
    ball = Mesh(*sphere(4))
    small = {"mesh": 0, "translation": [5, 0, 0], "scale": [0.1, 0.1, 0.1]}
    level = levels(asset(ball, ball, nodes=[small, {"mesh": 1}]), 600)[1]
    assert counts(level)[1] > 3 * counts(level)[0] > 0
    same = levels(asset(ball, ball, nodes=[{"mesh": 0, "translation": [5, 0, 0]}, {"mesh": 1}]), 600)[1]
    assert counts(same)[0] == pytest.approx(300, abs=10)


def test_a_mesh_shown_often_gets_more():
    ball = Mesh(*sphere(4))
    once, often = {"mesh": 0}, [{"mesh": 1, "translation": [3.0 * i, 0, 0]} for i in range(1, 20)]
    level = levels(asset(ball, ball, nodes=[once, *often]), 600)[1]
    assert counts(level)[1] > 1.5 * counts(level)[0] > 0


def test_all_levels_come_from_one_call_in_the_order_asked_for():
    got = levels(asset(Mesh(*bumpy(4))), 100, 1500, Target(ratio=0.25))
    assert [level.triangles for level in got] == [2048, 100, 1500, 512]
    assert [level.target for level in got[1:]] == [Target(triangles=100), Target(triangles=1500), Target(ratio=0.25)]
    assert got[1].estimate > got[3].estimate > got[2].estimate > got[0].estimate == 0


def test_estimates_are_in_percent_of_the_diagonal():
    big = levels(asset(Mesh(sphere(4)[0] * 1000, sphere(4)[1])), 300)[1]
    one = levels(asset(Mesh(*sphere(4))), 300)[1]
    assert big.estimate == pytest.approx(one.estimate, rel=0.05)
    assert 0.05 < one.estimate < 2


# ---------------------------------------------------------------------------------------------------------- placement


def test_levels_stay_in_each_mesh_s_own_space():
    """Turned, scaled and moved by nodes in the scene; the mesh itself lies where it lay."""
    mesh = Mesh(*bumpy(4, 0.05))
    quarter = [np.sin(np.pi / 4), 0.0, 0.0, np.cos(np.pi / 4)]
    nodes = [{"mesh": 0, "rotation": quarter, "scale": [3, 3, 3], "translation": [10, -20, 30]}]
    level = levels(asset(mesh, nodes=nodes), 300)[1].meshes[0]
    radius = np.linalg.norm(level.positions, axis=1)
    assert len(level.faces) == 300 and radius.min() > 0.97 and radius.max() < 1.08
    exact = {row.tobytes() for row in mesh.positions}
    endpoint = levels(asset(mesh, nodes=nodes), 300, setting=options(placement="endpoint"))[1].meshes[0]
    assert all(row.tobytes() in exact for row in endpoint.positions)  # not by a matrix there and back


@pytest.mark.parametrize("scale", [[-1, 1, 1], [2, -3, 4], [1, 1, 0]])
def test_mirrored_stretched_and_flattened_nodes(scale):
    mesh = Mesh(*bumpy(3))
    level = levels(asset(mesh, nodes=[{"mesh": 0, "scale": scale}]), 100)[1].meshes[0]
    assert len(level.faces) == 100
    assert volume(level.positions, level.faces) == pytest.approx(volume(*bumpy(3)), rel=0.1)


def test_a_mesh_that_no_node_shows_is_simplified_too():
    both = asset(Mesh(*bumpy(3)), Mesh(*bumpy(3)), nodes=[{"mesh": 0}])
    assert min(counts(levels(both, 200)[1])) > 50


def test_a_mesh_without_faces_stays():
    empty = Mesh(np.zeros((3, 3)), np.zeros((0, 3), np.int32), name="points")
    level = levels(asset(empty, Mesh(*bumpy(3))), 100)[1]
    assert level.meshes[0] is empty and counts(level) == [0, 100]
    assert levels(asset(empty), 5)[1].meshes == (empty,)


def test_parts_that_vanish_leave_an_empty_mesh_of_the_same_kind():
    tiny = dataclasses.replace(uv_sphere(4, 4), positions=uv_sphere(4, 4).positions * 1e-3).mesh(name="tiny")
    level = levels(asset(tiny, uv_sphere(16, 32).mesh()), 100)[1]
    assert counts(level)[0] == 0 and counts(level)[1] <= 100
    assert {n: v.shape for n, v in level.meshes[0].attributes.items()} == {
        "TEXCOORD_0": (0, 2),
        "NORMAL": (0, 3),
        "COLOR_0": (0, 4),
    }
    assert level.meshes[0].name == "tiny" and level.meshes[0].primitives == tiny.primitives


# ------------------------------------------------------------------------------------------------ what is carried along


def test_kept_meshes_pass_untouched_and_count_against_the_target():
    kept = Mesh(*bumpy(3), keep_reason="it is skinned")
    source = asset(kept, Mesh(*bumpy(4)))
    level = levels(source, 812)[1]
    assert level.meshes[0] is kept and counts(level) == [512, 300] and level.stop_reason == "target"
    too_few = levels(source, 100)[1]
    assert too_few.meshes[0] is kept and too_few.stop_reason == "kept meshes"
    assert counts(too_few)[1] == 0
    alone = levels(asset(kept), 100)[1]
    assert alone.meshes == (kept,) and alone.stop_reason == "kept meshes"


def test_meshes_with_different_attributes_keep_their_own():
    textured, plain = uv_sphere(16, 32, materials=2).mesh(name="textured"), Mesh(*bumpy(3), name="plain")
    colors = np.random.default_rng(0).random((len(bumpy(3)[0]), 3)).astype(np.float32)
    tangents = np.tile(np.array([1, 0, 0, -1], np.float32), (len(colors), 1))
    painted = Mesh(*bumpy(3), attributes={"COLOR_0": colors, "TANGENT": tangents}, name="painted")
    level = levels(asset(textured, plain, painted), 600)[1]
    for mesh, origin in zip(level.meshes, (textured, plain, painted), strict=True):
        assert mesh.name == origin.name and mesh.primitives == origin.primitives
        assert {n: v.shape[1] for n, v in mesh.attributes.items()} == {
            n: v.shape[1] for n, v in origin.attributes.items()
        }
        assert 0 < len(mesh.faces) < len(origin.faces)
    three = level.meshes[2].attributes["COLOR_0"]
    assert three.shape[1] == 3 and three.min() >= 0 and three.max() <= 1
    assert set(np.unique(level.meshes[2].attributes["TANGENT"][:, 3])) == {-1}


@pytest.mark.parametrize("steering", [True, False])
def test_new_normals_are_unit_and_new_colours_within_range(steering):
    ball = uv_sphere(32, 64, materials=2).mesh()
    level = levels(asset(ball), 200, setting=options(attribute_cost=steering))[1].meshes[0]
    normals, colors = level.attributes["NORMAL"], level.attributes["COLOR_0"]
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1, abs=1e-5)
    assert colors.min() >= 0 and colors.max() <= 1
    outward = np.einsum("ij,ij->i", normals[level.wedges[:, 0]], level.positions[level.faces[:, 0]])
    assert outward.min() > 0.9


def test_a_normal_that_has_no_direction_left_is_still_one():
    """Opposite normals that meet cancel out; what is written must be a unit vector all the same."""
    positions, faces = grid(4)
    normals = np.zeros((len(positions), 3), np.float32)
    normals[:, 2] = np.where(np.arange(len(positions)) % 2, 1, -1)
    mesh = Mesh(positions, faces, attributes={"NORMAL": normals})
    for target in (16, 8, 2):
        level = levels(asset(mesh), target, setting=options(placement="midpoint", attribute_cost=False))[1].meshes[0]
        assert np.linalg.norm(level.attributes["NORMAL"], axis=1) == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("with_attributes", [True, False])
def test_faces_keep_their_primitive_and_borders_stay_closed(with_attributes):
    ball = uv_sphere(24, 48, materials=2)
    mesh = ball.mesh()
    if not with_attributes:
        mesh = Mesh(
            ball.positions, ball.faces, face_primitive=ball.face_primitive, primitives=(Primitive(0), Primitive(1))
        )
    level = levels(asset(mesh), 300)[1].meshes[0]
    assert len(level.faces) == 300 and open_edges(welded(level.positions, level.faces)) == 0
    height = level.positions[level.faces].mean(axis=1)[:, 2]
    assert ((height < 0) == (level.face_primitive == 1))[np.abs(height) > 0.15].all()
    assert 100 < (level.face_primitive == 1).sum() < 200


def test_the_source_is_not_changed():
    source = asset(uv_sphere(16, 32, materials=2).mesh(), Mesh(*bumpy(3)))
    before = source.fingerprint()
    levels(source, 300, Target(error=1.0))
    assert source.fingerprint() == before


# ------------------------------------------------------------------------------------------------------------- targets


def test_kinds_of_targets():
    mesh = Mesh(*bumpy(3))
    assert len(decimate(mesh, 100).faces) == 100
    assert len(decimate(mesh, 0.25).faces) == 128
    assert len(decimate(mesh, np.int64(100)).faces) == len(decimate(mesh, Target(triangles=100)).faces) == 100
    assert len(decimate(mesh, 1.0).faces) == 512
    assert len(decimate(mesh, 10**9).faces) == 512
    assert 1 <= len(decimate(mesh, 1e-9).faces) <= 4  # rounds to one triangle; the last part does not vanish


@pytest.mark.parametrize("percent", [0.2, 1.0, 5.0])
def test_a_target_error_is_kept_as_measured(percent):
    source = asset(Mesh(*sphere(4)), Mesh(terrain()[0] + [2, 0, 0], terrain()[1]))
    level = levels(source, Target(error=percent))[1]
    assert level.stop_reason == "error" and level.target == Target(error=percent)
    measured = distance_between(flatten(source), flatten(source, level.meshes), 50_000).max
    assert 0.3 * percent < measured < 1.1 * percent
    assert level.triangles < source.triangles


def test_a_larger_error_needs_fewer_triangles():
    source = asset(Mesh(*sphere(4)))
    sizes = [level.triangles for level in levels(source, *(Target(error=e) for e in (0.2, 1.0, 5.0)))]
    assert sizes == sorted(sizes, reverse=True) and sizes[1] > 4 * sizes[3]


def test_an_error_of_zero_takes_nothing_that_counts():
    source = asset(Mesh(*bumpy(3)))
    assert levels(source, Target(error=0.0))[1].triangles > 500


@pytest.mark.parametrize(
    ("target", "message"),
    [
        (0, "at least 1 triangle"),
        (-5, "at least 1 triangle"),
        (0.0, "above 0 and up to 1"),
        (1.5, "above 0 and up to 1"),
        (float("nan"), "above 0 and up to 1"),
        (Target(error=-1.0), "error of 0 % or more"),
        (Target(), "a target needs"),
        (Target(pixels=1.0), "a target needs"),
        (True, "a target is a number"),
        ("half", "a target is a number"),
        (None, "a target is a number"),
    ],
)
def test_targets_out_of_range_are_refused(target, message):
    with pytest.raises(InvalidMesh, match=message):
        decimate(Mesh(*bumpy(1)), target)


# -------------------------------------------------------------------------------------------------------- the function


def test_the_public_name_works_on_meshes_and_assets():
    ball = uv_sphere(16, 32, materials=2).mesh(name="ball")
    one = lodpipe.decimate(ball, 0.25, placement="endpoint", weights=AttributeWeights(uv=0.2), threads=1)
    assert isinstance(one, Mesh) and one.name == "ball" and 239 <= len(one.faces) <= 240
    source = asset(ball, Mesh(*box()))
    whole = lodpipe.decimate(source, 300)
    assert isinstance(whole, Asset) and whole.name == "test" and whole.document == source.document
    assert whole.triangles <= 300 and whole.lods == ()
    with pytest.raises(TypeError, match="placment"):
        lodpipe.decimate(ball, 0.25, placment="endpoint")


def test_an_asset_without_meshes():
    assert levels(Asset(name="nothing", meshes=()), 5)[1].meshes == ()


def test_progress_and_cancelling():
    source, seen = asset(Mesh(*bumpy(4))), []
    levels(source, 100, progress=lambda done, total: seen.append(done / total))
    assert seen == sorted(seen) and seen[0] == 0
    with pytest.raises(Cancelled):
        levels(source, 100, cancelled=lambda: True)
    calls = []
    with pytest.raises(Cancelled):
        levels(source, 100, cancelled=lambda: calls.append(0) or len(calls) > 3)


def test_attribute_weights_say_where_a_texture_is_kept():
    """A flat sheet whose texture is bent on one half: the more UVs are worth, the more triangles that half gets."""
    positions, faces = grid(24)
    bent = np.where(positions[:, 0] < 0.5, 0.5 + 0.4 * np.sin(12 * positions[:, 0]), positions[:, 0])
    uv = np.stack([bent, positions[:, 1]], axis=1).astype(np.float32)
    mesh = Mesh(positions, faces, attributes={"TEXCOORD_0": uv})

    def share(weight):
        level = levels(asset(mesh), 120, weights=AttributeWeights(uv=weight, normal=0, color=0))[1].meshes[0]
        return float((level.positions[level.faces].mean(axis=1)[:, 0] < 0.5).mean())

    assert share(0.5) > 0.6 > share(0.0)


def test_what_uvs_are_worth_depends_on_textured_meshes_alone():
    """A large mesh without UVs does not make the texture of a small one dearer."""
    positions, faces = grid(8)
    sheet = Mesh(positions, faces, attributes={"TEXCOORD_0": positions[:, :2].astype(np.float32)})
    bare = Mesh(*sphere(4, 5.0))

    def straight(*meshes):
        joined = Joined.of(asset(*meshes))
        return joined.columns(options(), AttributeWeights(uv=0.1, normal=0, color=0), 100)[1]

    assert straight(sheet) == pytest.approx([0.1, 0.1])  # a unit of UV is a unit of length
    assert straight(sheet, bare) == pytest.approx([0.1, 0.1])
    assert straight(bare) == []


def flat_shaded(positions, faces):
    corners = positions[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    rows = np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3)
    return Mesh(positions, faces, wedges=rows, attributes={"NORMAL": np.repeat(normals, 3, axis=0).astype(np.float32)})


def test_edges_between_facets_are_no_seams():
    """A flat-shaded ball is simplified like one without normals; where a smooth side meets a lid is a seam."""
    ball = sphere(4)
    bare, flat = (decimate(mesh, 300) for mesh in (Mesh(*ball), flat_shaded(*ball)))
    assert np.array_equal(bare.positions, flat.positions) and flat.wedge_count > 2 * bare.wedge_count
    assert Joined.of(asset(Mesh(*ball))).real_seams is None

    mesh = flat_shaded(*box())
    inward = -mesh.positions[mesh.faces[:2]].reshape(-1, 3).astype(np.float32)
    lid = dataclasses.replace(mesh, attributes={"NORMAL": np.vstack([inward, mesh.attributes["NORMAL"][6:]])})
    held = Joined.of(asset(lid)).real_seams
    assert held[:2].all(), "its two triangles are no facets"
    assert held.sum() == 6 + 4, "and the four that meet them hold the edge, too"
    assert not Joined.of(asset(mesh)).real_seams.any()


def test_levels_have_the_same_bytes_twice_and_with_threads():
    source = asset(uv_sphere(24, 48, materials=2).mesh(), Mesh(*bumpy(4)))
    made = [
        [mesh.fingerprint() for level in levels(source, 1000, Target(error=1.0), threads=t) for mesh in level.meshes]
        for t in (1, 2, 2)
    ]
    assert made[0] == made[1] == made[2]


@pytest.mark.parametrize("placement", ["optimal", "endpoint", "midpoint"])
def test_parts_of_two_meshes_may_be_joined(placement):
    """With a pair distance vertices of different meshes merge; each mesh then has its own copy of the place."""
    left, right = Mesh(*bumpy(3)), Mesh(bumpy(3, seed=1)[0] + [2.05, 0, 0], bumpy(3)[1])
    setting = options(placement=placement, pair_distance=0.3, keep_topology=False)
    level = levels(asset(left, right), 600, setting=setting)[1]
    places = [set(map(tuple, mesh.positions.round(6))) for mesh in level.meshes]
    assert places[0] & places[1]
    for mesh, middle in zip(level.meshes, ([0, 0, 0], [2.05, 0, 0]), strict=True):
        assert len(mesh.faces) > 200 and np.linalg.norm(mesh.positions - middle, axis=1).max() < 1.4


# ---------------------------------------------------------------------------------------------------------- visual


def off(source, level):
    """Mean distance of a level to the source, % of the diagonal."""
    return distance_between(flatten(source), flatten(source, level.meshes), 20_000).mean


def test_visual_levels_are_nearer_and_shaded_like_the_source():
    source = asset(Mesh(*bumpy(5, 0.05)))
    plain = levels(source, 400, setting=None)[1]
    visual = levels(source, 400, setting=None, metric="visual")[1]
    assert visual.triangles == plain.triangles == 400
    assert off(source, visual) < 0.9 * off(source, plain)
    normals = visual.meshes[0].attributes["NORMAL"]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    assert "NORMAL" not in source.meshes[0].attributes


def test_visual_keeps_attributes_materials_and_targets():
    ball = uv_sphere(32, 64, materials=2).mesh()
    beside = {"mesh": 1, "translation": [3, 0, 0], "scale": [1, -2, 1]}
    source = asset(ball, Mesh(*bumpy(3)), nodes=[{"mesh": 0}, beside])
    source = dataclasses.replace(source, materials=(Material(), Material()))
    level = levels(source, 900, setting=None, metric="visual")[1]
    assert level.triangles in (899, 900)
    made = level.meshes[0]
    assert set(made.attributes) == set(ball.attributes) and set(made.face_primitive) == {0, 1}
    assert made.attributes["COLOR_0"].min() >= 0 and made.attributes["COLOR_0"].max() <= 1
    rough = level.meshes[1]
    assert volume(rough.positions, rough.faces) == pytest.approx(volume(*bumpy(3)), rel=0.1)


def test_visual_levels_found_by_error_are_fitted():
    source = asset(Mesh(*bumpy(5, 0.05)))
    goal = Target(error=1.0)
    found = decimate_asset(source, [goal], metric="visual")[1]
    plain = decimate_asset(source, [goal])[1]
    assert found.triangles <= plain.triangles
    assert distance_between(flatten(source), flatten(source, found.meshes), 20_000).max <= 1.0
    same = decimate_asset(source, [goal], metric="visual", threads=2)[1]
    assert same.meshes[0].positions.tobytes() == found.meshes[0].positions.tobytes()
    unfitted = levels(source, found.triangles, setting=None)[1]
    assert off(source, found) < 0.95 * off(source, unfitted)


def test_visual_search_for_an_error_is_cancelled():
    asked = []

    def cancelled():
        asked.append(1)
        return len(asked) > 12

    with pytest.raises(Cancelled):
        decimate_asset(asset(Mesh(*bumpy(4))), [Target(error=1.0)], metric="visual", cancelled=cancelled)
    assert len(asked) == 13


def test_visual_half_edges_invent_nothing():
    source = asset(uv_sphere(16, 32).mesh())
    made = levels(source, 300, setting=options(placement="endpoint"), metric="visual")[1].meshes[0]
    known = {row.tobytes() for row in source.meshes[0].positions}
    assert all(row.tobytes() in known for row in made.positions)


def test_visual_is_cancelled_while_it_fits():
    asked = []

    def cancelled():
        asked.append(1)
        return len(asked) > 6

    with pytest.raises(Cancelled):
        levels(asset(Mesh(*bumpy(3))), 300, setting=None, metric="visual", cancelled=cancelled)
