import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import limbs
import lodpipe
import meshes
from lodpipe.core.asset import Asset
from lodpipe.core.errors import InvalidMesh
from lodpipe.core.mesh import Mesh
from lodpipe.geometry.skeleton import SkeletonOptions, skeleton

DEV = Path(__file__).parents[3] / "shared" / "assets" / "dev"
WAYS = {
    "default": SkeletonOptions(),
    "single": SkeletonOptions(sources="single"),
    "formula": SkeletonOptions(levels="formula"),
    "forty": SkeletonOptions(levels=40),
    "heat": SkeletonOptions(distance="heat"),
    "dcg": SkeletonOptions(method="dcg"),
}


def of(*parts, options=None, threads=0):
    return skeleton(limbs.asset(*(p if isinstance(p, Mesh) else Mesh(*p) for p in parts)), options, threads)


def joined(a, b):
    """Two meshes as one."""
    return np.concatenate([a[0], b[0]]), np.concatenate([a[1], b[1] + len(a[0])])


def rank(found):
    """Independent loops, counted anew from nodes and links."""
    left = list(range(len(found.positions)))

    def root(n):
        while left[n] != n:
            n = left[n]
        return n

    loops = 0
    for a, b in found.edges.tolist():
        a, b = root(a), root(b)
        loops += a == b
        left[a] = b
    return loops


def double_ring():
    """Genus 3: two rings that cross each other twice, made from a distance field."""
    from sample_assets.implicit import capsule

    t = np.linspace(0, 2 * np.pi, 13)
    fields = []
    for x in (-0.5, 0.5):
        ring = np.stack([x + np.cos(t), np.sin(t), 0 * t], axis=1)
        fields += [capsule(a, b, 0.18) for a, b in itertools.pairwise(ring)]
    return limbs.blob(fields, (-1.8, -1.3, -0.3), (1.8, 1.3, 0.3), step=0.09)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    ("mesh", "genus"),
    [(Mesh(*meshes.sphere()), 0), (Mesh(*meshes.torus()), 1), (Mesh(*meshes.bumpy()), 0), (Mesh(*meshes.box()), 0)],
    ids=["sphere", "torus", "bumpy", "box"],
)
def test_loops_are_handles(way, mesh, genus):
    found = of(mesh, options=WAYS[way])
    assert [p.genus for p in found.components] == [genus]
    assert [p.cycle_rank for p in found.components] == [genus] == [rank(found)]


@pytest.mark.parametrize("way", ["default", "single", "dcg"])
def test_loops_of_crossing_rings(way):
    found = of(double_ring(), options=WAYS[way])
    assert found.components[0].genus == 3
    assert rank(found) == found.components[0].cycle_rank == 3


def test_a_handle_smaller_than_a_band_is_found():
    """A long bar with a tiny ring welded to it: its handle lies within one band of the bar."""
    positions, faces = meshes.torus(12, 8)
    far = np.array([[20.0, 0, 0]])
    tip = np.array([[positions[:, 0].argmax()]])
    near = faces[(faces == tip).any(axis=1)][0]
    bar = np.stack([near, np.roll(near, -1), np.full(3, len(positions))], axis=1)
    keep = ~(faces == near).all(axis=1)
    found = of(
        (np.concatenate([positions, far]), np.concatenate([faces[keep], bar])), options=SkeletonOptions(levels=4)
    )
    assert found.components[0].genus == 1
    assert rank(found) == 1


@pytest.mark.parametrize("arms", range(1, 9))
@pytest.mark.parametrize("hub", [0.0, 0.4])
def test_a_star_has_an_end_for_each_arm(arms, hub):
    found = of(limbs.star(arms, hub=hub))
    assert found.count("end") == (2 if arms == 1 and not hub else arms)  # a single capsule has two
    assert found.count("joint") == (1 if arms > 2 or (arms == 1 and hub) else 0)
    assert rank(found) == 0
    assert found.components[0].inside_share == pytest.approx(1.0)


@pytest.mark.parametrize("way", ["single", "formula", "forty", "heat", "dcg"])
def test_a_star_by_other_ways(way):
    assert of(limbs.star(5), options=WAYS[way]).count("end") == 5


@pytest.mark.parametrize("way", ["default", "dcg"])
@settings(max_examples=5, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True)
@given(st.integers(0, 10_000))
def test_random_trees_of_capsules(way, seed):
    mesh, ends = limbs.tree(seed)
    found = of(mesh, options=WAYS[way])
    assert found.count("end") == ends
    assert rank(found) == found.components[0].cycle_rank == 0
    assert found.components[0].inside_share >= 0.98


def test_nodes_lie_in_the_middle_of_a_capsule():
    mesh = limbs.star(2)
    found = of(mesh)
    inner = found.node_type == 1
    away = [min(np.linalg.norm(np.cross(p, d)) for d in _arms(2)) for p in found.positions[inner]]
    assert max(away) < 0.05
    assert np.median(found.radius[inner]) == pytest.approx(0.14, abs=0.01)


def _arms(arms, turn=0.3):
    angle = np.arange(arms) * 2.4 + turn
    return np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)


def test_terminal_vertices_are_the_tips():
    mesh = limbs.star(4)
    found = of(mesh)
    tips = mesh.positions[found.tip[found.tip >= 0]]
    assert len(tips) == 4
    assert np.linalg.norm(tips, axis=1).min() > 1.05  # arms of length 1 end 0.14 farther out
    assert (found.tip_mesh[found.tip >= 0] == 0).all()
    assert (found.tip[found.node_type != 0] == -1).all()


def test_every_vertex_has_a_node_of_its_component():
    found = of(limbs.star(3), limbs.star(2))
    assert len(found.components) == 2  # their surfaces cross, and yet they are two
    for index, nodes in enumerate(found.vertex_node):
        assert (found.component[nodes] == index).all()


def test_coincident_vertices_of_two_meshes_are_one():
    mesh = limbs.star(3)
    half = mesh.positions[mesh.faces].mean(axis=1)[:, 2] > 0
    parts = [Mesh(mesh.positions, mesh.faces[rows]) for rows in (half, ~half)]
    found = of(*parts)
    assert len(found.components) == 1
    assert found.count("end") == 3
    assert (found.vertex_node[0][np.unique(parts[0].faces)] >= 0).all()


def test_placements_count():
    mesh = limbs.star(3)
    node = {"mesh": 0, "scale": [2, 2, 2], "translation": [5, 0, 0]}
    placed = Asset("placed", (mesh,), document={"scene": 0, "scenes": [{"nodes": [0]}], "nodes": [node]})
    here, there = skeleton(limbs.asset(mesh)), skeleton(placed)
    assert there.positions == pytest.approx(here.positions * 2 + [5, 0, 0], abs=1e-4)
    assert there.radius == pytest.approx(here.radius * 2, abs=1e-4)


def test_same_bytes_for_any_threads_and_the_input_stays():
    mesh = limbs.star(5)
    before = mesh.fingerprint()
    assert of(mesh, threads=1).fingerprint() == of(mesh, threads=2).fingerprint()
    assert mesh.fingerprint() == before


def test_about_half_of_the_vertices_are_on_levels_by_the_formula():
    found = of(limbs.star(2), options=WAYS["formula"])
    assert 0.3 < found.on_level[0].mean() < 0.7  # Pao 2003: level sets two mean edges apart


@pytest.mark.parametrize("scale", [1e-19, 1.0, 1e15])
def test_any_size_and_place(scale):
    mesh = limbs.star(3)
    found = of(Mesh(mesh.positions * scale + 1e3 * scale, mesh.faces))
    assert found.count("end") == 3


ODD = {
    "triangle": meshes.triangle(),
    "sheet": meshes.grid(6),
    "folded": meshes.folded(),
    "moebius": meshes.moebius(),
    "book": meshes.book(),
    "bow tie": meshes.bow_tie(),
    "hourglass": meshes.hourglass(),
    "messy": meshes.messy(),
    "cone": meshes.cone(200),
    "needle": (np.array([[0, 0, 0], [1, 0, 0], [0.5, 0, 0]], float), np.array([[0, 1, 2]])),
    "point": (np.zeros((3, 3)), np.array([[0, 1, 2]])),
    "degenerate": (np.eye(3), np.array([[0, 0, 1], [1, 1, 1]])),
    "nothing": (np.zeros((0, 3)), np.zeros((0, 3), int)),
}


@pytest.mark.parametrize("way", ["default", "heat", "dcg"])
@pytest.mark.parametrize("name", ODD)
def test_odd_meshes_give_something_for_each_component(name, way):
    found = of(ODD[name], options=WAYS[way])
    assert np.isfinite(found.positions).all()
    assert np.isfinite(found.radius).all()
    assert set(found.component.tolist()) == set(range(len(found.components)))
    assert found.fingerprint() == of(ODD[name], options=WAYS[way]).fingerprint()


def test_what_could_not_be_done_is_said():
    assert "border loop" in of(meshes.grid(6)).components[0].notes[0]
    assert "not a manifold" in " ".join(of(meshes.book()).components[0].notes)
    assert "one-sided" in " ".join(of(meshes.moebius()).components[0].notes)
    assert of(meshes.sphere()).components[0].notes == ()
    assert of(joined(meshes.sphere(), (meshes.sphere()[0] * 0.01 + 3, meshes.sphere()[1]))).components[1].notes


def test_many_components_are_quick_and_each_has_its_own():
    found = of(meshes.cubes(20, 0.5))
    assert len(found.components) == 400
    nodes = np.bincount(found.component)
    assert nodes.min() == nodes.max()
    assert all(part.cycle_rank == part.genus == 0 for part in found.components)


def test_options_out_of_range():
    with pytest.raises(InvalidMesh, match="levels must be 2 or more"):
        of(meshes.box(), options=SkeletonOptions(levels=1))
    with pytest.raises(InvalidMesh, match="least_branch"):
        of(meshes.box(), options=SkeletonOptions(least_branch=-1))


def test_domains_are_carried_from_the_proxy():
    """More triangles than balls are looked for on: every vertex has a node of its own arm all the same."""
    mesh = limbs.blob(limbs.star_fields(4), (-1.2,) * 3, (1.2,) * 3, step=0.033)
    assert len(mesh.faces) > 8000
    found = of(mesh, options=WAYS["dcg"])
    assert found.count("end") == 4
    far = np.linalg.norm(mesh.positions, axis=1) > 0.7  # on an arm, whose nodes lie the same way
    nodes = found.positions[found.vertex_node[0]]
    assert (np.einsum("ij,ij->i", nodes, mesh.positions)[far] > 0.2).all()


NAMED = {
    "teddy.obj": (5, 7),
    "octopus.off": (8, 9),
    "dolphin.off": (5, 7),
    "horse.ply": (6, 8),
}


@pytest.mark.parametrize("name", NAMED)
def test_named_models(name):
    if not (DEV / name).is_file():
        pytest.skip(f"{name} is not here")
    found = skeleton(lodpipe.load(DEV / name))
    low, high = NAMED[name]
    assert low <= found.count("end") <= high
    assert found.components[0].cycle_rank == found.components[0].genus == 0
    assert found.components[0].inside_share >= 0.98


def test_the_sample_starfish_has_five_ends_and_one_joint():
    path = Path(__file__).parents[2] / "sample_assets" / "starfish.glb"
    if not path.is_file():
        pytest.skip("samples are not made")
    found = skeleton(lodpipe.load(path))
    assert (found.count("end"), found.count("joint")) == (5, 1)
    turned = dataclasses.replace(WAYS["default"], sources="single")
    assert skeleton(lodpipe.load(path), turned).count("end") == 5


def tube(points, radius=0.14):
    """A capsule along a polyline."""
    from sample_assets.implicit import capsule

    points = np.array(points, float)
    fields = [capsule(a, b, radius) for a, b in itertools.pairwise(points)]
    return limbs.blob(fields, points.min(axis=0) - 1.5 * radius, points.max(axis=0) + 1.5 * radius)


BENT = {
    "right angle": [[0, 0, 0], [1, 0, 0], [1, 1, 0]],
    "back and forth": [[0, 0, 0], [1, 0, 0], [0.3, 0.7, 0], [1.3, 0.9, 0], [1, 0.9, 1]],
    "stairs": [[0, 0, 0], [0.6, 0, 0], [0.6, 0.6, 0], [1.2, 0.6, 0], [1.2, 1.2, 0]],
}


@pytest.mark.parametrize("way", ["default", "dcg"])
@pytest.mark.parametrize("shape", BENT)
def test_elbows_are_not_ends(shape, way):
    found = of(tube(BENT[shape]), options=WAYS[way])
    assert (found.count("end"), found.count("joint")) == (2, 0)


@pytest.mark.parametrize("way", ["default", "dcg"])
def test_a_body_with_legs_has_a_spine(way):
    """Four legs on a long trunk: the paths to them run along its middle, not from one place across it."""
    from sample_assets.implicit import capsule

    legs = [capsule((x, 0, 0), (x, y, -1), 0.13) for x in (-0.2, 1.8) for y in (-0.5, 0.5)]
    body = limbs.blob([capsule((0, 0, 0), (1.6, 0, 0), 0.35), *legs], (-0.5, -0.7, -1.2), (2.1, 0.7, 0.5))
    found = of(body, options=WAYS[way])
    assert found.count("end") == 4
    along = found.positions[(found.positions[:, 0] > 0.3) & (found.positions[:, 0] < 1.3)]
    assert len(along) > 2
    assert np.abs(along[:, 1]).max() < 0.1
    assert np.abs(along[:, 2]).max() < 0.15


@pytest.mark.parametrize("way", ["default", "dcg"])
@pytest.mark.parametrize("seed", [3, 8])
def test_ends_hold_under_noise_decimation_and_turns(way, seed):
    mesh, ends = limbs.tree(seed)
    size = np.linalg.norm(np.ptp(mesh.positions, axis=0))
    noise = np.random.default_rng(seed).normal(size=mesh.positions.shape) * 0.005 * size
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    for changed in (
        Mesh(mesh.positions + noise, mesh.faces),
        lodpipe.decimate(mesh, 0.1),
        Mesh(mesh.positions @ turn * np.linalg.det(turn), mesh.faces),
    ):
        assert of(changed, options=WAYS[way]).count("end") == ends
