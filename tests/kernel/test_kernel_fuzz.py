"""Random triangle soups under random options: never a crash, and always a mesh."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lodpipe.kernel import PLACEMENTS, STOP_REASONS, WEIGHTINGS, QuadricOptions, decimate, edge_costs
from soups import soups


@st.composite
def attributes(draw, positions, faces):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    arrays = {}
    if draw(st.booleans()):
        charts, columns = draw(st.sampled_from([1, 2, 5])), draw(st.integers(0, 4))
        arrays["wedges"] = (faces + len(positions) * rng.integers(0, charts, (len(faces), 1))).astype(np.int32)
        scale = draw(st.sampled_from([1e-3, 1.0, 1e4]))
        arrays["values"] = (scale * rng.normal(size=(charts * len(positions), columns))).astype(np.float32)
        arrays["column_weights"] = rng.choice([0.0, 0.1, 10.0], columns).tolist()
    if draw(st.booleans()):
        arrays["importance"] = np.exp(4 * rng.normal(size=len(positions))).astype(np.float32)
    if draw(st.booleans()):
        arrays["locked"] = rng.random(len(positions)) < 0.2
    return arrays


CHOICES = st.builds(
    QuadricOptions,
    placement=st.sampled_from(PLACEMENTS),
    weighting=st.sampled_from(WEIGHTINGS),
    boundary_weight=st.sampled_from([0.0, 0.1, 10.0, 1000.0]),
    seam_weight=st.sampled_from([0.0, 1.0, 100.0]),
    crease_weight=st.sampled_from([0.0, 0.1, 10.0]),
    crease_degrees=st.sampled_from([0.0, 30.0, 60.0, 180.0]),
    attribute_cost=st.booleans(),
    keep_topology=st.booleans(),
    may_relax=st.booleans(),
    flip_degrees=st.sampled_from([5.0, 78.0, 90.0]),
    round_share=st.sampled_from([0.0, 1 / 16, 0.5, 1.0]),
    max_error=st.sampled_from([None, None, 0.0, 0.1]),
    record=st.booleans(),
)


@st.composite
def cases(draw):
    positions, faces = draw(soups())
    targets = sorted(draw(st.lists(st.integers(0, len(faces) + 3), min_size=1, max_size=3)), reverse=True)
    size = float(np.linalg.norm(np.ptp(positions, axis=0)))
    reach = draw(st.sampled_from([0.0, 0.0, 0.02])) * size
    return positions, faces, targets, draw(CHOICES), reach, draw(attributes(positions, faces))


def check(case):
    positions, faces, targets, chosen, reach, arrays = case
    setting = QuadricOptions(**{**chosen.__dict__, "pair_distance": reach})
    result = decimate(positions, faces, targets, setting, threads=2, **arrays)
    solid = (np.sort(faces, axis=1)[:, :-1] != np.sort(faces, axis=1)[:, 1:]).all(axis=1)
    previous = int(solid.sum())
    for target, level in zip(targets, result.levels, strict=True):
        assert level.target == target and level.stop in STOP_REASONS[:-1]
        assert (len(level.faces) <= target) == (level.stop == "triangles")
        assert len(level.faces) <= previous
        previous = len(level.faces)
        assert np.array_equal(np.unique(level.faces), np.arange(len(level.positions)))
        assert np.array_equal(np.unique(level.wedges), np.arange(len(level.wedge_source)))
        assert (np.sort(level.faces, axis=1)[:, :-1] != np.sort(level.faces, axis=1)[:, 1:]).all()
        assert len(np.unique(level.face_source)) == len(level.faces) and solid[level.face_source].all()
        assert np.isfinite(level.positions).all() and np.isfinite(level.values).all()
        assert 0 <= level.error < np.inf
        unmoved = level.vertex_source >= 0
        assert np.array_equal(level.positions[unmoved], positions[level.vertex_source[unmoved]])
        if "values" in arrays and arrays["values"].shape[1]:
            same = level.wedge_source >= 0
            assert np.array_equal(level.values[same], arrays["values"][level.wedge_source[same]])
        if setting.placement == "endpoint":
            assert unmoved.all()
    costs = edge_costs(positions, faces, setting, **arrays)
    assert (costs.cost >= 0).all() and len(costs.cost) == len(costs.edges) == len(costs.positions)


@settings(max_examples=300)
@given(cases())
def test_soups(case):
    check(case)


@pytest.mark.slow
@settings(max_examples=5000)
@given(cases())
def test_many_soups(case):
    check(case)
