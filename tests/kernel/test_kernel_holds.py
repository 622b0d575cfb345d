"""What once did not hold: locks, reasons, the box, the record, the gutter."""

from __future__ import annotations

import numpy as np
import pytest

from lodpipe.core.errors import InvalidMesh
from lodpipe.geometry.progressive import rebuild
from lodpipe.kernel import PLACEMENTS, decimate, edge_costs, reference
from meshes import bumpy, cubes, islands, torus, uv_sphere
from options import options

WEIGHTS = [0.1] * 2 + [0.05] * 3 + [0.05] * 4


def test_a_position_that_no_face_uses_does_not_matter():
    """It takes no part in the box in which everything is computed."""
    positions, faces = bumpy(3)
    far = np.concatenate([positions, [[1e9, -1e9, 1e9]]])
    for reach in (0.0, 0.05):
        plain, beside = (decimate(p, faces, [100], options(pair_distance=reach)).levels[0] for p in (positions, far))
        assert np.array_equal(plain.faces, beside.faces) and plain.error == pytest.approx(beside.error, rel=1e-4)
        assert beside.positions == pytest.approx(plain.positions, abs=1e-5)


def test_the_reason_is_seams_where_seams_hold():
    patchwork = islands(*bumpy())
    arrays = {"wedges": patchwork.wedges, "values": patchwork.values, "column_weights": [0.1, 0.1]}
    setting = options(placement="endpoint")
    level = decimate(patchwork.positions, patchwork.faces, [50], setting, **arrays).levels[0]
    assert level.stop == "seams" and len(level.faces) == len(patchwork.faces)


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_the_reason_is_locked_where_locks_hold(placement):
    positions, faces = bumpy()
    for locked in (np.ones(len(positions), bool), np.arange(len(positions)) % 2 == 0):
        level = decimate(positions, faces, [4], options(placement=placement), locked=locked).levels[0]
        assert level.stop == "locked"


def test_a_reason_is_of_now_not_of_long_ago():
    """Flips that were refused on the way do not hide what holds in the end."""
    level = decimate(*torus(48, 24), [8], options(may_relax=False, flip_degrees=40.0)).levels[0]
    assert level.stop == "topology" and len(level.faces) < 60


@pytest.mark.parametrize("keep_topology", [True, False])
@pytest.mark.parametrize("placement", PLACEMENTS)
def test_a_locked_vertex_does_not_lose_its_last_face(placement, keep_topology):
    """Neither as a corner opposite to a collapsed edge, nor at its end."""
    rng = np.random.default_rng(1)
    for seed in range(6):
        positions, faces = cubes(2) if seed < 3 else bumpy(2)
        faces = faces[rng.random(len(faces)) < 0.7]
        locked = rng.random(len(positions)) < 0.2
        setting = options(placement=placement, keep_topology=keep_topology)
        level = decimate(positions, faces, [0], setting, locked=locked).levels[0]
        assert set(np.flatnonzero(locked)) & set(faces.ravel()) <= set(level.vertex_source)


@pytest.mark.parametrize("target", range(14))
def test_components_that_vanish_are_rebuilt(target):
    """A component goes at once: no prefix of the record counts its triangles and keeps some."""
    positions, faces = cubes(3)
    arrays = positions, faces, faces, np.empty((len(positions), 0), np.float32)
    result = decimate(positions, faces, [target], options(record=True))
    built = rebuild(*arrays, result.record, target)
    assert np.array_equal(built.face_source, np.sort(result.levels[0].face_source))
    for between in range(target, 60):
        assert len(rebuild(*arrays, result.record, between).faces) <= between


def test_the_record_keeps_original_values_to_the_last_bit():
    ball = uv_sphere(24, 32)
    setting = options(placement="endpoint", record=True)
    arrays = {"wedges": ball.wedges, "values": ball.values, "column_weights": [0.37] * 9}
    result = decimate(ball.positions, ball.faces, [200], setting, **arrays)
    built = rebuild(ball.positions, ball.faces, ball.wedges, ball.values, result.record, 200)
    assert (built.wedge_source >= 0).all()
    rows = np.argsort(result.levels[0].face_source)
    level = result.levels[0]
    assert built.values[built.wedges].tobytes() == level.values[level.wedges[rows]].tobytes()


@pytest.mark.parametrize("weight", [0.0, 0.01, 0.1, 10.0])
def test_uvs_stay_within_the_gutter_whatever_they_are_worth(weight):
    ball = uv_sphere(48, 64)
    rough = ball.positions * (1 + 0.1 * np.random.default_rng(0).random((len(ball.positions), 1)))
    arrays = {"wedges": ball.wedges, "values": ball.values, "column_weights": [weight] * 2 + [0.05] * 7}

    def beyond(chart_column):
        setting = options(chart_column=chart_column, seam_weight=0.03)
        level = decimate(rough, ball.faces, [600], setting, **arrays).levels[0]
        u = level.values[level.wedges][..., 0]
        return float(max(-u.min(), u.max() - 1))

    assert beyond(0) < min(4 * 4 / 1024, 0.6 * beyond(None))


def test_u_and_v_may_be_worth_different_things():
    ball = uv_sphere(12, 16)
    for weights in ([0.0, 0.1], [0.1, 0.0], [0.1, 0.2]):
        arrays = {"wedges": ball.wedges, "values": ball.values[:, :2], "column_weights": weights}
        level = decimate(ball.positions, ball.faces, [60], options(chart_column=0), **arrays).levels[0]
        assert np.isfinite(level.values).all() and len(level.faces) <= 60


def test_seams_are_held_by_their_scale():
    """The seam of a ball: what holds it may differ from edge to edge, and 0 lets it go."""
    ball = uv_sphere(12, 24)
    arrays = {"wedges": ball.wedges, "values": ball.values, "column_weights": [0.0] * ball.values.shape[1]}
    setting = options(attribute_cost=False, seam_weight=1.0)
    none = edge_costs(ball.positions, ball.faces, options(attribute_cost=False, seam_weight=0.0), **arrays)
    off = np.zeros(ball.faces.shape, np.float32)
    freed = edge_costs(ball.positions, ball.faces, setting, seam_scale=off, **arrays)
    np.testing.assert_array_equal(freed.cost, none.cost)
    half = edge_costs(ball.positions, ball.faces, setting, seam_scale=off + np.float32(0.5), **arrays)
    same = edge_costs(ball.positions, ball.faces, options(attribute_cost=False, seam_weight=0.5), **arrays)
    np.testing.assert_array_equal(half.cost, same.cost)
    rng = np.random.default_rng(0).random(ball.faces.shape).astype(np.float32)
    edges = np.sort(np.stack([ball.faces, np.roll(ball.faces, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
    _, number = np.unique(edges, axis=0, return_inverse=True)
    mixed = rng.ravel()[np.unique(number, return_index=True)[1]][number].reshape(-1, 3)
    fast = edge_costs(ball.positions, ball.faces, setting, seam_scale=mixed, **arrays)
    slow = reference.edge_costs(ball.positions, ball.faces, setting, seam_scale=mixed, **arrays)
    by_edge = {tuple(sorted(e)): c for e, c in zip(slow.edges.tolist(), slow.cost, strict=True)}
    expected = [by_edge[tuple(sorted(e))] for e in fast.edges.tolist()]
    np.testing.assert_allclose(fast.cost, expected, rtol=1e-3, atol=1e-7)
    for bad in (off[:-1], off - 1, off * np.nan):
        with pytest.raises(InvalidMesh, match="seam_scale"):
            edge_costs(ball.positions, ball.faces, setting, seam_scale=bad, **arrays)
