"""What must hold of shapes: outlines, corners, parts, topology. Options that matter are set here."""

from __future__ import annotations

import numpy as np
import pytest

from lodpipe.kernel import PLACEMENTS, decimate
from measures import areas, components, euler, open_edges, spread, volume
from meshes import (
    book,
    bow_tie,
    box,
    bumpy,
    cone,
    cubes,
    folded,
    grid,
    hourglass,
    messy,
    moebius,
    octahedron,
    sphere,
    terrain,
    tetrahedron,
    torus,
    triangle,
)
from options import SET, options

CORNERS = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0]], float)


def to(mesh, target, setting=SET, **arrays):
    return decimate(*mesh, [target], setting, **arrays).levels[0]


@pytest.mark.parametrize(("placement", "tolerance"), [("optimal", 1e-4), ("endpoint", 0.0)])
def test_a_flat_square_becomes_two_triangles_with_its_corners(placement, tolerance):
    level = to(grid(12), 2, options(placement=placement, boundary_weight=10.0))
    assert len(level.faces) == 2 and level.stop == "triangles"
    found = level.positions[np.lexsort(level.positions.T[::-1].round(1))]
    assert found == pytest.approx(CORNERS, abs=tolerance)
    assert np.array_equal(level.positions[:, 2], np.zeros(4))


def plan_area(level) -> float:
    flat = level.positions * [1, 1, 0]
    return float(areas(flat, level.faces).sum())


def test_an_open_terrain_keeps_its_outline_with_boundary_planes_and_erodes_without():
    """Garland & Heckbert 1997, section 6."""
    held, loose = (to(terrain(), 100, options(boundary_weight=weight)) for weight in (10.0, 0.0))
    assert len(held.faces) <= 100 and len(loose.faces) <= 100
    assert plan_area(held) == pytest.approx(1.0, abs=2e-3)
    assert plan_area(loose) < 0.9
    for corner in CORNERS[:, :2]:
        assert np.linalg.norm(held.positions[:, :2] - corner, axis=1).min() < 0.01


def test_a_fold_stays_sharp():
    level = to(folded(16, 90.0), 8)
    normals = np.cross(*(level.positions[level.faces[:, k]] - level.positions[level.faces[:, 0]] for k in (1, 2)))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert np.abs(normals).max(axis=1) == pytest.approx(1.0, abs=1e-5)  # every face lies in one of the two planes
    assert len(np.unique(np.abs(normals).argmax(axis=1))) == 2
    assert areas(level.positions, level.faces).sum() == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize("size", [1.0, 7.5])
def test_a_box_cut_into_small_faces_becomes_twelve_triangles_again(size):
    positions, faces = box(size)
    for _ in range(3):
        positions, faces = divided(positions, faces)
    assert len(faces) == 12 * 64
    level = to((positions, faces), 12)
    assert len(level.faces) == 12
    assert volume(level.positions, level.faces) == pytest.approx(size**3, rel=1e-3)
    assert np.abs(level.positions) == pytest.approx(np.full((8, 3), size / 2), rel=1e-3)


def divided(positions, faces):
    """Each triangle cut in four, in its plane."""
    ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    edges, row = np.unique(ends, axis=0, return_inverse=True)
    ab, bc, ca = (row.reshape(3, -1) + len(positions)).reshape(3, -1)
    a, b, c = faces.T
    quarters = [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return np.concatenate([positions, positions[edges].mean(axis=1)]), np.concatenate(quarters).astype(np.int32)


# ------------------------------------------------------------------------------------------------------ aggregation


@pytest.mark.parametrize("keep_topology", [True, False])
def test_cubes_shrink_alone_along_edges(keep_topology):
    """10 × 10 cubes (Garland & Heckbert 1997, figure 3): with edges alone no two become one."""
    setting = options(keep_topology=keep_topology)
    levels = decimate(*cubes(), [1200, 800, 400, 200], setting).levels
    for level in levels:
        assert level.stop == "triangles"
        cube = np.rint(level.positions[level.faces][..., :2])  # of which cube each corner is nearest to the middle
        assert (cube == cube[:, :1]).all()
    assert [components(level.faces) for level in levels[:3]] == [100, 100, 100]


# ---------------------------------------------------------------------------------------------------------- topology


@pytest.mark.parametrize("placement", PLACEMENTS)
@pytest.mark.parametrize(
    ("mesh", "target", "characteristic"),
    [(sphere, 4, 2), (bumpy, 40, 2), (torus, 60, 0), (cone, 40, 2), (box, 4, 2), (octahedron, 4, 2), (moebius, 40, 0)],
)
def test_topology_is_kept(mesh, target, characteristic, placement):
    positions, faces = mesh()
    border = 1 if mesh is moebius else 0
    assert euler(faces) == characteristic
    level = to((positions, faces), target, options(placement=placement, keep_topology=True, may_relax=False))
    assert target - 1 <= len(level.faces) <= target and level.stop == "triangles"
    assert euler(level.faces) == characteristic and components(level.faces) == 1
    assert (open_edges(level.faces) > 0) == border
    assert not level.relaxed


def test_two_spheres_that_share_a_vertex_go_on_sharing_one():
    level = to(hourglass(), 40, options(may_relax=False))
    assert len(level.faces) == 40 and euler(level.faces) == 3 and components(level.faces) == 1


def test_a_handle_is_given_up_only_when_that_is_allowed():
    kept = to(torus(), 4, options(may_relax=False))
    assert kept.stop == "topology" and euler(kept.faces) == 0 and not kept.relaxed
    assert 14 <= len(kept.faces) <= 24  # a torus has 14 triangles at least
    given_up = to(torus(), 12, options(may_relax=True))
    assert given_up.stop == "triangles" and given_up.relaxed and len(given_up.faces) <= 12
    never_kept = to(torus(), 12, options(keep_topology=False))
    assert never_kept.stop == "triangles" and not never_kept.relaxed


def test_levels_above_the_point_where_topology_was_given_up_are_not_marked():
    fine, coarse = decimate(*torus(), [100, 8], options(may_relax=True)).levels
    assert (fine.relaxed, coarse.relaxed) == (False, True) and euler(fine.faces) == 0


@pytest.mark.parametrize("mesh", [tetrahedron, octahedron, book, bow_tie, triangle, box, messy, cone, hourglass])
@pytest.mark.parametrize("target", [0, 1, 3, 5, 10_000])
def test_small_and_broken_meshes_go_down_to_any_target(mesh, target):
    positions, faces = mesh()
    sound = int((np.diff(np.sort(faces, axis=1), axis=1) > 0).all(axis=1).sum())
    level = to((positions, faces), target)
    assert len(level.faces) <= target and level.stop == "triangles"
    if target == 10_000:
        assert len(level.faces) == sound
        assert np.array_equal(level.positions[level.faces], positions[faces[level.face_source]])
    kept = to((positions, faces), target, options(keep_last=True))
    assert len(kept.faces) > 0
    if kept.stop != "triangles":  # what is left would go as a whole
        assert kept.stop == "last" and target < len(kept.faces) <= 4 and components(kept.faces) == 1


@pytest.mark.parametrize("mesh", [bumpy, sphere, torus])
def test_no_face_is_turned_over(mesh):
    positions, faces = mesh()
    level = to((positions, faces), 60)
    middle = level.positions[level.faces].mean(axis=1)
    out = middle * ([1, 1, 0] if mesh is torus else 1)
    out = middle - 0.9 * out / np.linalg.norm(out, axis=1, keepdims=True) if mesh is torus else out
    normals = np.cross(*(level.positions[level.faces[:, k]] - level.positions[level.faces[:, 0]] for k in (1, 2)))
    assert (np.einsum("ij,ij->i", normals, out) > 0).all()


def test_new_faces_are_no_slivers():
    level = to(bumpy(4, 0.02), 200)
    corners = level.positions[level.faces]
    longest = np.max([np.linalg.norm(corners[:, i] - corners[:, i - 1], axis=1) for i in range(3)], axis=0)
    assert (2 * areas(level.positions, level.faces) / longest**2).min() > 1e-3


def off_the_sphere(level) -> float:
    """Mean distance of a level's surface to the unit sphere."""
    return float(np.abs(np.linalg.norm(spread(level.positions, level.faces), axis=1) - 1).mean())


def test_the_estimated_error_has_the_size_of_the_measured_one():
    """It is a root mean square over planes, no bound."""
    levels = decimate(*sphere(5), [4000, 1000, 300, 100], SET).levels
    for level in levels:
        assert off_the_sphere(level) < level.error < 3 * off_the_sphere(level)


def test_optimal_placement_is_nearer_than_endpoints():
    levels = {p: to(sphere(5), 300, options(placement=p)) for p in PLACEMENTS}
    off = {placement: off_the_sphere(level) for placement, level in levels.items()}
    assert off["optimal"] < 0.6 * off["endpoint"] and off["optimal"] < 0.6 * off["midpoint"]
