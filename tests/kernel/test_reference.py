"""The native kernel against the readable one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lodpipe import kernel
from lodpipe.kernel import PLACEMENTS, WEIGHTINGS, reference
from meshes import book, bow_tie, box, bumpy, folded, grid, messy, moebius, terrain, triangle, uv_sphere
from options import options


def assert_same_costs(positions, faces, setting, **arrays):
    """Native and readable costs agree to 1e-5, and to what 32-bit floats can tell of such an edge."""
    native = kernel.edge_costs(positions, faces, setting, **arrays)
    state = reference.State(positions, faces, setting, **arrays)
    expected = {pair: state.merge(*pair) for pair in [*state.edges(), *state.near]}
    rows = {(int(min(pair)), int(max(pair))): i for i, pair in enumerate(native.edges)}
    assert rows.keys() == expected.keys() and len(rows) == len(native.edges)
    for pair, merge in expected.items():
        cost = native.cost[rows[pair]]
        if merge.cost == np.inf:
            assert cost == np.inf
            continue
        along = state.p[pair[0]] - state.p[pair[1]]
        total = state.q[pair[0]] + state.q[pair[1]]
        size = total.trace * (float(along @ along) + 1e-9)
        assert cost == pytest.approx(merge.cost, rel=1e-5, abs=3e-6 * size), pair
        place = (native.positions[rows[pair]] - state.center) / state.diagonal
        ends = state.p[list(pair)]
        at_an_end = (
            (merge.x == ends).all(axis=1).any()
        )  # which one is a matter of the last bit where they cost the same
        off = np.linalg.norm(place - (ends if at_an_end else merge.x), axis=-1).min()
        assert off <= 1e-2 * np.linalg.norm(along) + 1e-6, pair


@pytest.mark.parametrize(
    ("placement", "weighting"), [("optimal", "area"), ("endpoint", "uniform"), ("midpoint", "area-angle")]
)
@pytest.mark.parametrize("mesh", [bumpy, terrain, moebius, messy, book, bow_tie, triangle, grid, box, folded])
def test_costs_of_named_meshes(mesh, placement, weighting):
    positions, faces = mesh(*{bumpy: (1,), terrain: (4,), folded: (4,), moebius: (12, 3)}.get(mesh, ()))
    setting = options(placement=placement, weighting=weighting, boundary_weight=3.0, seam_weight=2.0, crease_weight=0.5)
    assert_same_costs(positions, faces, setting)


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_costs_with_seams_materials_and_attributes(placement):
    sphere = uv_sphere(6, 8, materials=2)
    rng = np.random.default_rng(3)
    assert_same_costs(
        sphere.positions * (1 + 0.2 * rng.random((len(sphere.positions), 1))),
        sphere.faces,
        options(placement=placement, seam_weight=0.7),
        wedges=sphere.wedges,
        values=sphere.values,
        column_weights=[0.3, 0.2, 0.1, 0.1, 0.1, 0.0, 0.5, 0.5, 0.0],
    )


@st.composite
def cases(draw):
    """A small random surface with everything that may be said about it."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    positions, faces = draw(st.sampled_from([bumpy(1, 0.5), terrain(4, 0.3), moebius(8, 2), book(), box()]))
    positions = positions + rng.normal(size=positions.shape) * 0.05
    used, faces = np.unique(faces[rng.random(len(faces)) < draw(st.sampled_from([1.0, 0.8]))], return_inverse=True)
    positions, faces = positions[used], faces.reshape(-1, 3).astype(np.int32)
    charts = draw(st.integers(1, 3))
    columns = draw(st.integers(0, 4))
    chart = rng.integers(0, charts, len(faces))
    arrays = {
        "wedges": (faces + len(positions) * chart[:, None]).astype(np.int32),
        "values": rng.normal(size=(charts * len(positions), columns)).astype(np.float32),
        "column_weights": rng.choice([0.0, 0.1, 1.0], columns).tolist(),
    }
    if draw(st.booleans()):
        arrays["importance"] = np.exp(rng.normal(size=len(positions))).astype(np.float32)
    if draw(st.booleans()):
        arrays["locked"] = rng.random(len(positions)) < 0.3
    setting = options(
        placement=draw(st.sampled_from(PLACEMENTS)),
        weighting=draw(st.sampled_from(WEIGHTINGS)),
        boundary_weight=draw(st.sampled_from([0.0, 0.1, 10.0])),
        seam_weight=draw(st.sampled_from([0.0, 1.0])),
        crease_weight=draw(st.sampled_from([0.0, 1.0])),
        crease_degrees=draw(st.sampled_from([20.0, 60.0])),
        pair_distance=draw(st.sampled_from([0.0, 0.0, 0.3])),
        attribute_cost=draw(st.booleans()),
    )
    return positions, faces, setting, arrays


@settings(max_examples=40)
@given(cases())
def test_costs_of_random_meshes(case):
    positions, faces, setting, arrays = case
    assert_same_costs(positions, faces, setting, **arrays)


@pytest.mark.slow
@settings(max_examples=1000)
@given(cases())
def test_costs_of_many_random_meshes(case):
    positions, faces, setting, arrays = case
    assert_same_costs(positions, faces, setting, **arrays)


def textured_case():
    sphere = uv_sphere(6, 10, materials=2)
    rough = sphere.positions * (1 + 0.05 * np.random.default_rng(1).random((len(sphere.positions), 1)))
    weights = [0.1] * 2 + [0.05] * 3 + [0.1] * 4
    return rough, sphere.faces, {"wedges": sphere.wedges, "values": sphere.values, "column_weights": weights}


def rough_terrain():
    positions, faces = terrain(5, 0.2)
    positions[:, 2] += 0.05 * np.random.default_rng(1).random(len(positions))
    return positions, faces, {}


@pytest.mark.parametrize("placement", PLACEMENTS)
@pytest.mark.parametrize(
    ("case", "target"),
    [(lambda: (*bumpy(2), {}), 40), (rough_terrain, 20), (textured_case, 50)],
    ids=["closed", "open", "textured"],
)
def test_one_collapse_at_a_time_is_the_paper_s_order(case, target, placement):
    """With rounds of one vertex the kernel makes the very collapses that the textbook loop makes."""
    positions, faces, arrays = case()
    setting = options(
        placement=placement, round_share=0.0, may_relax=False, boundary_weight=10, seam_weight=1, crease_weight=0.1
    )
    level = kernel.decimate(positions, faces, [target], setting, **arrays).levels[0]
    state = reference.decimate(positions, faces, target, setting, **arrays)
    assert np.array_equal(np.sort(level.face_source), state.live)
    assert level.error == pytest.approx(state.errors[state.faces[state.live]].max() * state.diagonal, rel=1e-4)
    rows = np.argsort(level.face_source)
    places = state.p[state.faces[state.live]] * state.diagonal + state.center
    assert level.positions[level.faces[rows]] == pytest.approx(places, abs=1e-3)
    if arrays:
        ends = state.values[state.wedges[state.live]] / state.scale
        assert level.values[level.wedges[rows]] == pytest.approx(ends, abs=2e-3)


@pytest.mark.parametrize("reason", ["error", "seams", "locked", "flip"])
def test_the_same_guards_hold(reason):
    """Where the textbook loop is stopped by a guard, the kernel is stopped at the same number of triangles."""
    positions, faces = bumpy(2)
    setting = options(placement="endpoint", round_share=0.0, may_relax=False, crease_weight=0.0, seam_weight=0.0)
    arrays: dict = {}
    if reason == "error":
        setting = dataclasses.replace(setting, max_error=0.03)
    if reason == "flip":
        setting = dataclasses.replace(setting, flip_degrees=10.0)
    if reason == "locked":
        arrays["locked"] = positions[:, 2] > 0
    if reason == "seams":
        arrays["wedges"] = np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3)
        arrays["values"] = np.zeros((3 * len(faces), 1), np.float32)
        arrays["column_weights"] = [0.0]
    level = kernel.decimate(positions, faces, [0], setting, **arrays).levels[0]
    state = reference.decimate(positions, faces, 0, setting, **arrays)
    assert 0 < len(level.faces) == len(state.live)
    assert np.array_equal(np.sort(level.face_source), state.live)
