"""The native similarity decimator against the readable one: every cost, and whole runs, to 1e-5."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dressed import small
from lodpipe.kernel import similarity_costs, similarity_decimate
from lodpipe.kernel import similarity_reference as reference
from lodpipe.kernel.similarity import SimilarityOptions

MESHES = small()
ROUNDING = 4e-5
"""Of a sum over some 300 rays in single precision: 1e-7 a ray."""
RAY = SimilarityOptions(views=3)
METHODS = {
    "local": dataclasses.replace(RAY, reference="previous"),
    "scene": RAY,
    "view penalty": dataclasses.replace(RAY, penalty="view"),
    "uv": dataclasses.replace(RAY, correspondence="uv"),
    "deviation": SimilarityOptions(metric="texture_deviation"),
    "local deviation": SimilarityOptions(metric="texture_deviation", reference="previous"),
    "image": SimilarityOptions(metric="image", image_size=16),
}
UNTEXTURED = {"local", "scene", "view penalty", "image"}
CASES = [(mesh, method) for mesh in MESHES for method in METHODS if mesh != "plain" or method in UNTEXTURED]
EVERYDAY = [
    ("plain", "scene"),
    ("ball", "local"),
    ("two materials", "view penalty"),
    ("tube", "uv"),
    ("sheet", "scene"),
    ("sheet", "deviation"),
    ("lace", "local"),
    ("glass", "scene"),
    ("sheet", "image"),
]
# a vertex of four faces costs the same towards two sides without a texture; a mask decides by the last bit
RUNS = [case for case in CASES if case[0] not in ("plain", "lace") and case[1] not in ("view penalty", "image")]
EVERYDAY_RUNS = [("ball", "scene"), ("two materials", "uv"), ("sheet", "local"), ("sheet", "deviation")]


def options_of(method, collapse):
    return dataclasses.replace(METHODS[method], collapse=collapse)


@pytest.mark.parametrize("collapse", ["half", "full"])
@pytest.mark.parametrize(("mesh", "method"), EVERYDAY)
def test_costs(mesh, method, collapse):
    check_costs(mesh, method, collapse, 12 if method == "image" else 4)


@pytest.mark.slow
@pytest.mark.parametrize("collapse", ["half", "full"])
@pytest.mark.parametrize(("mesh", "method"), CASES)
def test_costs_of_all_candidates(mesh, method, collapse):
    check_costs(mesh, method, collapse, 12 if method == "image" else 1)


def check_costs(mesh, method, collapse, every):
    one, options = MESHES[mesh], options_of(method, collapse)
    pairs, cost, places = similarity_costs(one.positions, one.faces, one.appearance, options, **one.arrays)
    state = reference.State(one.positions, one.faces, one.appearance, options, **one.arrays)
    expected = {pair: state.plan(*pair) for pair in state.candidates()}
    assert sorted(map(tuple, pairs.tolist())) == sorted(expected)
    known = 0
    for pair, found, place in list(zip(pairs, cost, places, strict=True))[::every]:
        plan = expected[tuple(pair.tolist())]
        if plan is None:
            assert found == np.inf
            continue
        known += 1
        assert found == pytest.approx(state.cost(plan), rel=1e-5, abs=ROUNDING), pair
        if collapse == "full":
            assert np.abs((place - state.center) / state.diagonal - plan.place).max() < 1e-5
    assert known > 2


@pytest.mark.parametrize("collapse", ["half", "full"])
@pytest.mark.parametrize(("mesh", "method"), EVERYDAY_RUNS)
def test_short_runs(mesh, method, collapse):
    check_run(mesh, method, collapse, 0.8)


@pytest.mark.slow
@pytest.mark.parametrize("collapse", ["half", "full"])
@pytest.mark.parametrize(("mesh", "method"), RUNS)
def test_long_runs(mesh, method, collapse):
    check_run(mesh, method, collapse, 0.6)


def check_run(mesh, method, collapse, share):
    """The same collapses for the same costs: the queue, the lists S_t and the boxes are kept alike."""
    one, options = MESHES[mesh], options_of(method, collapse)
    target = int(len(one.faces) * share)
    state = reference.State(one.positions, one.faces, one.appearance, options, **one.arrays)
    expected = reference.simplify(state, target)
    found = similarity_decimate(
        one.positions, one.faces, [target], one.appearance, dataclasses.replace(options, record=True), **one.arrays
    )
    assert len(found.costs) == len(expected) > 2
    assert np.allclose(found.costs, [cost for cost, _, _ in expected], rtol=1e-5, atol=ROUNDING)
    assert found.record.removed.tolist() == [gone for _, gone, _ in expected]
    assert found.record.kept.tolist() == [kept for _, _, kept in expected]
