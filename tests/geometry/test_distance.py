"""Sampled distances, against closed forms and a brute-force oracle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lodpipe.core.asset import Asset, ErrorFigures, Lod
from lodpipe.core.errors import InvalidMesh
from lodpipe.core.mesh import Mesh
from lodpipe.geometry.distance import distance_between, doubled_areas, measure_levels, sample_surface
from lodpipe.geometry.flatten import flatten
from lodpipe.kernel.surfaces import TriangleTree
from meshes import box, grid, sphere


def soup(positions, faces):
    return flatten(Asset("asset", (Mesh(positions, faces),)))


def between(a, b, **options):
    return distance_between(soup(*a), soup(*b), **{"samples": 20_000, **options})


def join(*meshes):
    start = np.cumsum([0] + [len(positions) for positions, _ in meshes])
    faces = [faces + np.int32(at) for (_, faces), at in zip(meshes, start, strict=False)]
    return np.concatenate([positions for positions, _ in meshes]), np.concatenate(faces)


# ---------------------------------------------------------------- the oracle: every point against every triangle


def segment_distance(p, a, b):
    along = b - a
    t = np.einsum("pfk,fk->pf", p - a, along) / np.maximum(np.einsum("fk,fk->f", along, along), 1e-300)
    return np.linalg.norm(p - a - np.clip(t, 0, 1)[..., None] * along, axis=2)


def brute_distance(points, positions, faces):
    """(P,) float64: distance of each point to the nearest of all triangles, in double precision."""
    p = np.asarray(points, float)[:, None]
    a, b, c = (positions[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1)
    inside = np.broadcast_to(size > 0, (len(points), len(faces))).copy()
    for x, y in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("pfk,fk->pf", np.cross(y - x, p - x), normal) >= 0
    plane = np.abs(np.einsum("pfk,fk->pf", p - a, normal)) / np.maximum(size, 1e-300)
    edges = np.minimum(np.minimum(segment_distance(p, a, b), segment_distance(p, b, c)), segment_distance(p, c, a))
    return np.where(inside, np.minimum(plane, edges), edges).min(axis=1)


def brute_figures(a, b, samples):
    """Mean, RMS and maximum in % of a's diagonal for the same samples and for all vertices, one by one."""
    diagonal = np.linalg.norm(np.ptp(a[0], axis=0))
    results = []
    for (positions, faces), other in ((a, b), (b, a)):
        single = positions.astype(np.float32)
        points, _ = sample_surface(single, faces, doubled_areas(single, faces), samples, seed=0)
        distance = brute_distance(points, *other)
        results.append(
            (distance.mean(), np.square(distance).mean(), distance.max(), brute_distance(positions, *other).max())
        )
    mean, square, at_samples, at_vertices = np.array(results).T
    return (
        100 * mean.mean() / diagonal,
        100 * np.sqrt(square.mean()) / diagonal,
        100 * max(at_samples.max(), at_vertices.max()) / diagonal,
    )


@settings(max_examples=12)
@given(seed=st.integers(0, 10_000))
def test_agrees_with_brute_force(seed):
    rng = np.random.default_rng(seed)
    a, b = sphere(2), sphere(1)
    a = (a[0] * rng.uniform(0.5, 2, 3) + rng.normal(0, 0.05, a[0].shape), a[1])
    b = (b[0] * rng.uniform(0.5, 2, 3) + rng.normal(0, 0.2, b[0].shape), b[1])
    figures = between(a, b, samples=800)
    expected = brute_figures(a, b, samples=800)
    assert (figures.mean, figures.rms, figures.max) == pytest.approx(expected, rel=2e-4)


# ---------------------------------------------------------------- closed forms


def test_equal_surfaces():
    assert between(sphere(3), sphere(3)) == ErrorFigures(0.0, 0.0, 0.0, 0.0)


def test_the_same_surface_with_other_triangles():
    figures = between(grid(7), grid(4))
    assert figures.max < 1e-4
    assert figures.normal_degrees == pytest.approx(0, abs=1e-4)


def test_parallel_planes():
    figures = between(grid(3), grid(5, height=0.1))
    percent = 10 / np.sqrt(2)
    assert (figures.mean, figures.rms, figures.max) == pytest.approx((percent,) * 3, rel=1e-5)
    assert figures.mean_square == pytest.approx(percent**2, rel=1e-5)
    assert figures.normal_degrees == pytest.approx(0, abs=1e-4)


def test_nested_spheres():
    figures = between(sphere(6), sphere(6, radius=0.9))
    percent = 10 / np.sqrt(12)  # the box of the unit sphere is 2 wide
    assert (figures.mean, figures.rms) == pytest.approx((percent,) * 2, rel=2e-3)
    assert figures.max == pytest.approx(percent, rel=1e-2)


def test_the_farther_direction_decides_the_maximum():
    square, with_far_island = grid(4), join(grid(4), (grid(1)[0] * 0.01 + [2.0, 0, 0], grid(1)[1]))
    for a, b in ((square, with_far_island), (with_far_island, square)):
        diagonal = np.linalg.norm(np.ptp(a[0], axis=0))
        assert between(a, b).max == pytest.approx(101 / diagonal, rel=1e-3)


def test_a_vertex_between_the_samples_counts():
    positions, faces = grid(20)
    spike = positions.copy()
    spike[210, 2] = 0.5  # six of 800 triangles
    assert between((positions, faces), (spike, faces), samples=50).max == pytest.approx(50 / np.sqrt(2), rel=1e-3)


@pytest.mark.parametrize("bend", [10.0, 60.0])
def test_normal_deviation_of_a_turned_plane(bend):
    positions, faces = grid(2)
    angle = np.radians(bend)
    turned = np.stack(
        [positions[:, 0] * np.cos(angle), positions[:, 1], positions[:, 0] * np.sin(angle)],
        axis=1,
    )
    assert between((positions, faces), (turned, faces)).normal_degrees == pytest.approx(bend, rel=1e-4)


def test_a_face_turned_over_is_seen():
    positions, faces = grid(4)
    over = faces.copy()
    over[: len(faces) // 4] = over[: len(faces) // 4, ::-1]
    assert between((positions, faces), (positions, over)).normal_degrees == pytest.approx(45, rel=0.01)
    assert between(sphere(3), (sphere(3)[0], sphere(3)[1][:, ::-1])).normal_degrees == pytest.approx(180, rel=1e-3)


def test_a_thin_wall_is_compared_side_by_side():
    def wall(n, thickness):
        top, bottom = grid(n, thickness / 2), grid(n, -thickness / 2)
        return join(top, (bottom[0], bottom[1][:, ::-1]))

    # moved by more than its thickness: the closest points of one side lie on the other
    moved = wall(3, 0.001)
    moved[0][:, 2] += 0.01
    assert between(wall(4, 0.001), moved).normal_degrees == pytest.approx(0, abs=1e-3)


def test_a_sheet_with_two_faces_in_the_same_place():
    def sheet(n):
        positions, faces = grid(n)
        return positions, np.concatenate([faces, faces[:, ::-1]])

    assert between(sheet(4), sheet(3)).normal_degrees == pytest.approx(0, abs=1e-3)


# ---------------------------------------------------------------- precision, size, degenerate input


@pytest.mark.parametrize("scale", [1e-19, 1.0, 1e31])
@pytest.mark.parametrize("offset", [0.0, 3e7])
def test_scale_and_offset_do_not_matter(scale, offset):
    a, b = sphere(3), sphere(1)
    expected = between(a, b)
    moved = [((p + offset) * scale, f) for p, f in (a, b)]
    got = between(*moved)
    assert got.mean == pytest.approx(expected.mean, rel=1e-4)
    assert got.max == pytest.approx(expected.max, rel=1e-4)
    assert got.normal_degrees == pytest.approx(expected.normal_degrees, rel=1e-2)


def test_slivers_do_not_blur_the_distance():
    """Triangles 2000 times as long as high, fanned over a plane, against the plane."""
    step = np.linspace(0, 1, 2001)
    fan = np.concatenate([[[0.0, 0.0, 0.0]], np.stack([np.ones(2001), step, 0 * step], axis=1)])
    faces = np.stack([np.zeros(2000), np.arange(1, 2001), np.arange(2, 2002)], axis=1).astype(np.int32)
    half = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0]]), np.array([[0, 1, 2]], np.int32)
    rotated = [(p @ np.linalg.qr(np.array([[1.0, 2, 3], [0, 1, 4], [5, 6, 0]]))[0], f) for p, f in ((fan, faces), half)]
    figures = between(*rotated)
    assert figures.max < 1e-5  # 0.03 in single precision
    assert figures.mean < 3e-6  # 0.003


def test_samples_are_spread_by_area():
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [3, 0, 0]], np.float32)
    faces = np.array([[0, 1, 2], [1, 3, 2], [0, 0, 1]], np.int32)
    points, picked = sample_surface(positions, faces, doubled_areas(positions, faces), 3000, seed=1)
    assert np.bincount(picked, minlength=3).tolist() == pytest.approx([1000, 2000, 0], abs=1)
    first = points[picked == 0]
    np.testing.assert_allclose(first.mean(axis=0), [1 / 3, 1 / 3, 0], atol=0.02)
    assert (first.sum(axis=1) <= 1 + 1e-6).all()
    assert (first >= 0).all()


def test_surfaces_without_area():
    line = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0, 1, 2]], np.int32)
    shifted = line[0] + [0, 0.5, 0], line[1]
    figures = between(line, shifted)
    assert figures.mean == pytest.approx(25, rel=1e-3)
    assert figures.normal_degrees == 0.0
    point = np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32)
    assert between(point, (point[0], point[1][:, ::-1])) == ErrorFigures(0.0, 0.0, 0.0, 0.0)


def test_a_few_triangles_get_few_samples(monkeypatch):
    """Inside a fine sphere each of them would take a millisecond."""
    asked = []
    closest = TriangleTree.closest
    monkeypatch.setattr(
        TriangleTree, "closest", lambda tree, points: asked.append(len(points)) or closest(tree, points)
    )
    figures = between(sphere(4), sphere(0, radius=0.2))
    assert figures.mean > 20
    assert max(asked) == 20_000
    assert sorted(asked)[-2] == 8000


def test_no_triangles():
    nothing = np.zeros((0, 3)), np.zeros((0, 3), np.int32)
    assert between(nothing, nothing) == ErrorFigures(0.0, 0.0, 0.0, 0.0)
    with pytest.raises(InvalidMesh, match="no distance to a model without triangles"):
        between(box(), nothing)


# ---------------------------------------------------------------- levels


def asset_with_levels():
    source = Mesh(*sphere(4))
    levels = [source, Mesh(*sphere(3)), Mesh(*sphere(2)), Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))]
    return Asset("ball", (source,), lods=tuple(Lod((mesh,)) for mesh in levels))


def test_levels_are_measured_against_the_source():
    asset = asset_with_levels()
    seen = []
    figures = measure_levels(asset, samples=5000, progress=lambda done, total: seen.append((done, total)))
    assert figures[0] == ErrorFigures(0.0, 0.0, 0.0, 0.0)
    assert figures[1] == distance_between(flatten(asset), flatten(asset, asset.lods[1].meshes), samples=5000)
    assert figures[2].mean > 3 * figures[1].mean > 0
    assert figures[3] is None
    assert seen == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_every_instance_counts():
    """Two placements ten apart: the diagonal, and so every percentage, is that of the whole scene."""
    source, level = Mesh(*sphere(4)), Mesh(*sphere(2))
    document = {"scenes": [{"nodes": [0, 1]}], "nodes": [{"mesh": 0}, {"mesh": 0, "translation": [10, 0, 0]}]}
    asset = Asset("pair", (source,), document=document, lods=(Lod((level,)),))
    alone = Asset("one", (source,), lods=(Lod((level,)),))
    pair, one = (measure_levels(x, samples=20_000)[0] for x in (asset, alone))
    assert pair.mean * np.linalg.norm([12, 2, 2]) == pytest.approx(one.mean * np.sqrt(12), rel=0.02)


def test_the_number_of_threads_does_not_matter():
    results = [measure_levels(asset_with_levels(), samples=30_000, threads=threads) for threads in (1, 2, 0)]
    assert results[0] == results[1] == results[2]


def test_the_seed_matters_a_little():
    first, second = (measure_levels(asset_with_levels(), samples=5000, seed=seed)[2] for seed in (0, 1))
    assert first.mean != second.mean
    assert first.mean == pytest.approx(second.mean, rel=0.02)
