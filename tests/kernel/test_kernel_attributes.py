"""UVs, normals and colours through the collapse: they stay true, and no seam or border between materials opens."""

from __future__ import annotations

import numpy as np
import pytest

from lodpipe.kernel import PLACEMENTS, decimate
from measures import components, euler, open_edges
from meshes import bumpy, grid, islands, seam_cylinder, sphere_attributes, uv_sphere
from options import options

WEIGHTS = [0.1] * 2 + [0.05] * 3 + [0.05] * 4  # of a uv_sphere's columns


def run(textured, target, setting, weights=WEIGHTS, **more):
    arrays = {"wedges": textured.wedges, "values": textured.values, "column_weights": weights, **more}
    return decimate(textured.positions, textured.faces, [target], setting, **arrays).levels[0]


def wedge_owner(level) -> dict[int, set[int]]:
    """Wedge -> the vertices at which faces use it."""
    owner: dict[int, set[int]] = {}
    for wedge, vertex in zip(level.wedges.ravel(), level.faces.ravel(), strict=True):
        owner.setdefault(int(wedge), set()).add(int(vertex))
    return owner


def inner(corners):
    """Places (or values) a little inside of the corners (F, 3, K) of faces."""
    return 0.7 * corners + 0.3 * corners.mean(axis=1, keepdims=True)


def attribute_errors(level):
    """Mean errors of UV (share of the unit square), normal (degrees) and colour against the sphere that they belong to.

    Taken in the faces near their corners, where u has no ambiguity at the seam; UVs away from the poles.
    """
    points = inner(level.positions[level.faces])
    truth = sphere_attributes(points / np.linalg.norm(points, axis=-1, keepdims=True))
    found = inner(level.values[level.wedges].astype(float))
    uv = np.abs(found[..., :2] - truth["TEXCOORD_0"])
    uv[..., 0] = np.minimum(uv[..., 0], 1 - uv[..., 0])
    normal = found[..., 2:5] / np.linalg.norm(found[..., 2:5], axis=-1, keepdims=True)
    cosine = np.einsum("fck,fck->fc", normal, truth["NORMAL"]).clip(-1, 1)
    color = np.abs(found[..., 5:8] - truth["COLOR_0"][..., :3])
    away_from_poles = np.abs(truth["NORMAL"][..., 2]) < 0.9
    return uv.max(axis=-1)[away_from_poles].mean(), np.degrees(np.arccos(cosine)).mean(), color.max(axis=-1).mean()


@pytest.mark.parametrize("steering", [True, False])
def test_attributes_stay_true_on_a_sphere(steering):
    ball = uv_sphere(64, 128, materials=2)
    assert len(ball.faces) == 16128
    level = run(ball, 1612, options(attribute_cost=steering))
    uv, degrees, color = attribute_errors(level)
    assert len(level.faces) == 1612
    assert uv <= 2e-4 and degrees <= 0.2 and color <= 1e-3


@pytest.mark.parametrize("placement", PLACEMENTS)
@pytest.mark.parametrize("keep_topology", [True, False])
def test_the_border_between_two_materials_never_opens(placement, keep_topology):
    ball = uv_sphere(24, 32, materials=2)
    setting = options(placement=placement, keep_topology=keep_topology)
    for target in (800, 200, 60):
        level = run(ball, target, setting)
        assert len(level.faces) <= target
        assert open_edges(level.faces) == 0 and components(level.faces) == 1
        primitive = ball.face_primitive[level.face_source]
        assert 0.3 < primitive.mean() < 0.7
        # no wedge is used by both materials, or at two positions
        used = [set(level.wedges[primitive == p].ravel()) for p in (0, 1)]
        assert not used[0] & used[1]
        assert all(len(vertices) == 1 for vertices in wedge_owner(level).values())
        if placement != "midpoint":  # the border is where it was: materials meet at the equator
            border = set(level.faces[primitive == 0].ravel()) & set(level.faces[primitive == 1].ravel())
            equator = ball.positions[ball.faces[ball.face_primitive == 0]][..., 2].min()
            assert np.abs(level.positions[sorted(border), 2] - equator).max() < 0.15
        middle = level.positions[level.faces].mean(axis=1)[:, 2]
        assert (middle[primitive == 0] > -0.15).all() and (middle[primitive == 1] < 0.15).all()


@pytest.mark.parametrize("placement", ["optimal", "endpoint"])
def test_charts_do_not_leak_into_each_other(placement):
    """No face of the sphere reaches across its UV seam."""
    level = run(uv_sphere(24, 32), 150, options(placement=placement, keep_topology=True))
    uv = level.values[level.wedges][..., :2]
    assert len(level.faces) <= 150 and np.ptp(uv[..., 0], axis=1).max() < 0.5
    assert uv[..., 0].min() > -0.02 and uv[..., 0].max() < 1.02


def test_a_tiled_tube_keeps_its_texture():
    """UVs run from 0 to 3 round the tube: the seam stays at its place and tiles are not folded back."""
    tube = seam_cylinder(columns=48, rows=24)
    level = run(tube, 200, options(), weights=[0.3, 0.3])
    assert len(level.faces) <= 200 and euler(level.faces) == 0
    corners, uv = level.positions[level.faces], level.values[level.wedges]
    inside, within = inner(corners), inner(uv)
    turn = np.arctan2(inside[..., 1], inside[..., 0]) / (2 * np.pi) % 1
    assert np.abs(within[..., 0] - 3 * turn).max() < 0.06  # 2 % of the way round
    assert within[..., 1] == pytest.approx(inside[..., 2] / 2, abs=0.01)
    ends = np.abs(np.abs(corners[..., 2] - 1) - 1) < 1e-3
    assert corners[ends][:, 2].min() < 1e-3 and corners[ends][:, 2].max() > 1.999


def test_seams_are_held_by_their_weight():
    """Without planes at the seam, a seam on a flat sheet wanders; with them it stays straight."""
    positions, faces = grid(20)
    right = positions[faces].mean(axis=1)[:, 0] > 0.5
    wedges = (faces + len(positions) * right[:, None]).astype(np.int32)
    values = np.concatenate([positions[:, :1], positions[:, :1] + 5]).astype(np.float32)
    arrays = {"wedges": wedges, "values": values, "column_weights": [0.0]}

    def seam(weight):
        level = decimate(positions, faces, [40], options(seam_weight=weight), **arrays).levels[0]
        chart = level.values[level.wedges][..., 0].mean(axis=1) > 3
        shared = set(level.faces[chart].ravel()) & set(level.faces[~chart].ravel())
        assert len(shared) > 1
        return float(np.abs(level.positions[sorted(shared), 0] - 0.5).max())

    assert seam(10.0) < 1e-3 < 1e-2 < seam(0.0)


def test_islands_stay_whole():
    """Every face its own chart: whatever is merged, a corner's UVs are near those of its own chart."""
    patchwork = islands(*bumpy(4))
    level = run(patchwork, 400, options(), weights=[0.0, 0.0])
    assert len(level.faces) == 400
    assert open_edges(level.faces) == 0
    own = patchwork.values[patchwork.wedges[level.face_source]].mean(axis=1)
    middle = level.values[level.wedges].mean(axis=1)
    size = 1 / 128
    assert np.median(np.abs(middle - own).max(axis=1)) < 3 * size


def test_columns_come_back_in_their_order_and_scale():
    """Columns that steer and columns that are carried lie apart inside; nobody sees that."""
    ball = uv_sphere(12, 16)
    values = np.concatenate([ball.values, ball.values[:, :1] * 1000 + 7], axis=1)
    weights = [0.0, 0.2, 0.0, 0.1, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0]
    arrays = {"wedges": ball.wedges, "values": values, "column_weights": weights}
    level = decimate(ball.positions, ball.faces, [100], options(), **arrays).levels[0]
    assert level.values[:, 9] == pytest.approx(level.values[:, 0] * 1000 + 7, rel=1e-3, abs=0.05)
    for target in (len(ball.faces), 100):
        endpoint = decimate(ball.positions, ball.faces, [target], options(placement="endpoint"), **arrays).levels[0]
        assert endpoint.values.tobytes() == values[endpoint.wedge_source].tobytes()


def test_colours_decide_where_a_flat_surface_is_cut():
    """A flat sheet, half black and half white with a sharp border inside: the border's vertices survive."""
    positions, faces = grid(16)
    white = (positions[:, 0] > 0.5).astype(np.float32)[:, None]
    level = decimate(positions, faces, [40], options(), values=white, column_weights=[0.5]).levels[0]
    x, value = level.positions[level.faces][..., 0], level.values[level.wedges][..., 0]
    left, right = 0.5, 0.5 + 1 / 16
    assert np.abs(value[x < left - 0.01]).max() < 0.1 and np.abs(value[x > right + 0.01] - 1).max() < 0.1
