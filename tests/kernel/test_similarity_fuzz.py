"""Random triangle soups under random options through the similarity decimator: never a crash, and always a mesh."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lodpipe.kernel import STOP_REASONS, similarity_costs, similarity_decimate
from lodpipe.kernel.similarity import WRAPS, Appearance, Look, LookImage, SimilarityOptions
from soups import soups

CHOICES = st.builds(
    SimilarityOptions,
    metric=st.sampled_from(["ray", "ray", "texture_deviation", "image"]),
    collapse=st.sampled_from(["half", "full"]),
    reference=st.sampled_from(["original", "previous"]),
    correspondence=st.sampled_from(["scene", "uv"]),
    views=st.sampled_from([1, 4]),
    spacing=st.sampled_from([0.5, 1.0, 100.0]),
    penalty=st.sampled_from(["constant", "view"]),
    image_size=st.just(16),
    flip_degrees=st.sampled_from([5.0, 60.0, 90.0]),
    keep_topology=st.booleans(),
    may_relax=st.booleans(),
    cross_seams=st.booleans(),
    keep_last=st.booleans(),
    record=st.booleans(),
)


@st.composite
def cases(draw):
    positions, faces = draw(soups())
    faces = faces[:160]
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    charts = draw(st.sampled_from([1, 2, 5]))
    wedges = (faces + len(positions) * rng.integers(0, charts, (len(faces), 1))).astype(np.int32)
    values = rng.normal(size=(charts * len(positions), 9)).astype(np.float32)
    values *= np.float32(draw(st.sampled_from([0.0, 1e-3, 1.0, 1e6, 1e30])))
    image = LookImage(
        rng.integers(0, 256, (int(rng.integers(1, 9)), int(rng.integers(1, 9)), 2)).astype(np.uint8),
        (draw(st.sampled_from(WRAPS)), draw(st.sampled_from(WRAPS))),
        draw(st.booleans()),
    )
    look = Look(
        image=draw(st.sampled_from([None, 0])),
        luminance=draw(st.sampled_from([0.0, 1.0])),
        alpha=draw(st.sampled_from([0.0, 1.0])),
        uv_column=draw(st.sampled_from([0, 2])),
        matrix=tuple(rng.normal(size=6)),
        cutoff=draw(st.sampled_from([None, 0.5])),
    )
    face_look = rng.integers(0, 2, len(faces)).astype(np.int32)
    appearance = Appearance(face_look, [look, Look()], [image], draw(st.sampled_from([None, 4])), 0)
    arrays = {"wedges": wedges, "values": values, "column_weights": [*rng.choice([0.0, 1.0, 100.0], 2), *[0.0] * 7]}
    if draw(st.booleans()):
        arrays["importance"] = np.exp(4 * rng.normal(size=len(positions))).astype(np.float32)
    if draw(st.booleans()):
        arrays["locked"] = rng.random(len(positions)) < 0.2
    targets = sorted(draw(st.lists(st.integers(0, len(faces) + 3), min_size=1, max_size=3)), reverse=True)
    return positions, faces, targets, appearance, draw(CHOICES), arrays


def check(case):
    positions, faces, targets, appearance, options, arrays = case
    result = similarity_decimate(positions, faces, targets, appearance, options, threads=2, **arrays)
    alone = similarity_decimate(positions, faces, targets, appearance, options, threads=1, **arrays)
    for one, two in zip(alone.levels, result.levels, strict=True):
        assert np.array_equal(one.faces, two.faces) and np.array_equal(one.positions, two.positions)
        assert np.array_equal(one.values, two.values)
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
        same = level.wedge_source >= 0
        assert np.array_equal(level.values[same], arrays["values"][level.wedge_source[same]])
        if options.collapse == "half":
            assert unmoved.all()
    assert np.isfinite(result.costs).all()
    pairs, cost, places = similarity_costs(positions, faces, appearance, options, **arrays)
    assert not np.isnan(cost).any() and np.isfinite(places).all() and len(pairs) == len(cost)


@settings(max_examples=150)
@given(cases())
def test_soups(case):
    check(case)


@pytest.mark.slow
@settings(max_examples=5000)
@given(cases())
def test_many_soups(case):
    check(case)
