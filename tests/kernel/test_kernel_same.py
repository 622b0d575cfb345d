"""The same result: for any number of threads, twice, and for the same mesh said in another way."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lodpipe.kernel import decimate
from measures import euler, spread
from meshes import bumpy, sphere, uv_sphere
from options import options

WEIGHTS = [0.1] * 2 + [0.05] * 3 + [0.05] * 4


def digest(result):
    """All bytes of all levels and of the record."""
    parts = [*result.levels, *([result.record] if result.record else [])]
    return [
        value.tobytes() if isinstance(value, np.ndarray) else value
        for part in parts
        for value in dataclasses.astuple(part)
    ]


@pytest.fixture(scope="module")
def large():
    """More than 40,000 vertices: enough for blocks that are collapsed side by side."""
    ball = uv_sphere(144, 288)
    assert len(ball.positions) > 40_000
    rough = ball.positions * (1 + 0.01 * np.random.default_rng(0).random((len(ball.positions), 1)))
    return dataclasses.replace(ball, positions=rough)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"placement": "endpoint"},
        {"attribute_cost": False, "keep_topology": False},
        {"attribute_cost": False, "keep_topology": False, "round_share": 0.7},
    ],
    ids=["attributes", "endpoint", "planes", "fast"],
)
def test_any_number_of_threads_gives_the_same_bytes(large, changes):
    arrays = {"wedges": large.wedges, "values": large.values, "column_weights": WEIGHTS}
    results = [
        decimate(
            large.positions, large.faces, [60_000, 20_000], options(record=True, **changes), threads=threads, **arrays
        )
        for threads in (1, 2, 3)
    ]
    assert [len(level.faces) for level in results[0].levels] == pytest.approx([60_000, 20_000], abs=1)
    for other in results[1:]:
        assert digest(other) == digest(results[0])


def test_blocks_do_not_open_or_fold_anything(large):
    arrays = {"wedges": large.wedges, "values": large.values, "column_weights": WEIGHTS}
    level = decimate(large.positions, large.faces, [8000], options(), threads=3, **arrays).levels[0]
    assert euler(level.faces) == 2 and len(level.faces) == 8000
    radius = np.linalg.norm(spread(level.positions, level.faces), axis=1)
    assert radius.min() > 0.995 and radius.max() < 1.015


def test_small_meshes_are_the_same_twice_and_with_threads():
    positions, faces = bumpy(3)
    results = [decimate(positions, faces, [100, 20], options(record=True), threads=t) for t in (0, 1, 1, 2, 3, 8)]
    assert all(digest(result) == digest(results[0]) for result in results)


@pytest.mark.parametrize("scale", [1e-30, 1e-19, 1e-3, 1e5, 1e30, 1e150])
def test_scale_does_not_matter(scale):
    """A power of two changes nothing at all; another factor, only rounding."""
    positions, faces = bumpy(3)
    settings = options(boundary_weight=10)
    plain = decimate(positions, faces, [100], settings).levels[0]
    scaled = decimate(positions * scale, faces, [100], settings).levels[0]
    assert len(scaled.faces) == 100 and euler(scaled.faces) == 2
    assert scaled.error / scale == pytest.approx(plain.error, rel=0.05)
    radius = np.linalg.norm(scaled.positions / scale, axis=1)
    assert radius.min() > 0.95 and radius.max() < 1.2
    doubled = decimate(positions * 2.0**40, faces, [100], settings).levels[0]
    assert np.array_equal(doubled.faces, plain.faces) and np.array_equal(doubled.positions, plain.positions * 2.0**40)


@pytest.mark.parametrize("offset", [[3e7, 0, 0], [-1e5, 2e6, 3e7]])
def test_a_place_far_away_does_not_matter(offset):
    positions, faces = bumpy(3)
    near = decimate(positions, faces, [100], options()).levels[0]
    far = decimate(positions + offset, faces, [100], options()).levels[0]
    assert len(far.faces) == 100 and euler(far.faces) == 2
    assert far.error == pytest.approx(near.error, rel=0.05)
    radius = np.linalg.norm(far.positions - offset, axis=1)
    assert radius.min() > 0.95 and radius.max() < 1.2


def test_coordinates_near_the_limit_of_doubles():
    positions, faces = bumpy(2)
    level = decimate(positions * 1e307, faces, [40], options()).levels[0]
    assert len(level.faces) == 40 and np.isfinite(level.positions).all() and np.isfinite(level.error)


def test_the_order_of_vertices_and_faces_does_not_matter_for_quality():
    rng = np.random.default_rng(5)
    positions, faces = sphere(5)
    shuffled, number = rng.permutation(len(positions)), np.empty(len(positions), int)
    number[shuffled] = np.arange(len(positions))
    scrambled = rng.permutation(number[faces].astype(np.int32))
    scrambled = np.stack(
        [np.roll(face, turn) for face, turn in zip(scrambled, rng.integers(0, 3, len(faces)), strict=True)]
    )
    off = []
    for mesh in ((positions, faces), (positions[shuffled], np.ascontiguousarray(scrambled))):
        level = decimate(*mesh, [400], options()).levels[0]
        assert len(level.faces) == 400
        off.append(float(np.abs(np.linalg.norm(spread(level.positions, level.faces), axis=1) - 1).mean()))
    assert off[1] == pytest.approx(off[0], rel=0.1)


def test_turned_and_mirrored_meshes_are_simplified_as_well():
    positions, faces = bumpy(4)
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    plain, turned, mirrored = (
        decimate(p, f, [300], options()).levels[0]
        for p, f in ((positions, faces), (positions @ turn.T, faces), (positions * [-1, 1, 1], faces[:, ::-1]))
    )
    for level in (turned, mirrored):
        assert level.error == pytest.approx(plain.error, rel=0.15)
        assert euler(level.faces) == 2


def test_inside_out_is_the_same_as_outside():
    """The winding as such says nothing to the decimator."""
    positions, faces = bumpy(3)
    out, turned_over = (decimate(positions, f, [100], options()).levels[0] for f in (faces, faces[:, ::-1].copy()))
    assert set(out.face_source) == set(turned_over.face_source)
