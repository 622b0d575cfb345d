"""Unfolding and packing: every face has a place of its own, whatever xatlas does."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lodpipe.core.errors import Cancelled, InvalidMesh
from lodpipe.geometry import atlas
from lodpipe.geometry.atlas import lay_out, pack, unfold, without_folds
from lodpipe.kernel import layout
from meshes import book, box, grid, messy, moebius, sphere, torus


def overlaps(uv, slack=1e-7) -> bool:
    each, one = np.arange(len(uv), dtype=np.int32), np.zeros(len(uv), np.int32)
    return bool(layout.uv_overlaps(uv, each, one, slack).faces.any())


def areas(corners):
    sides = corners[:, 1:] - corners[:, :1]
    if corners.shape[2] == 2:
        return np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]) / 2
    return np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2


@pytest.mark.parametrize("shape", [box, sphere, torus, messy, moebius, book, grid])
@pytest.mark.parametrize("fails", [False, True])
def test_no_two_faces_share_a_place(shape, fails, monkeypatch):
    positions, faces = shape()
    if fails:
        monkeypatch.setattr(atlas, "MAX_FACES", 0)
    found = unfold(positions, faces)
    assert bool(found.problem) == fails
    placed = pack(found.uv, found.label, (256, 256), 4)
    solid = areas(positions[faces]) > 1e-12
    assert not overlaps(placed[solid], 1e-4)
    assert placed[solid].min() >= 2 - 1e-9
    assert placed[solid].max() <= 254 + 1e-9
    assert (areas(placed)[solid] > 0).all()
    assert found.left_out == int((~solid).sum())


@pytest.mark.parametrize("scale", [1e-6, 1e-2, 1e4])
def test_small_and_large_models_lose_no_face(scale):
    positions, faces = sphere(4, 1.0)
    found = unfold(positions * scale + 5 * scale, faces)
    assert found.problem == ""
    assert areas(found.uv).sum() == pytest.approx(areas(positions[faces]).sum() * scale**2, rel=1e-3)


def test_faces_that_lie_on_one_another_stay_in_few_charts():
    """Exact doubles made xatlas give a chart to each face."""
    positions, faces = sphere(3)
    found = unfold(positions, np.concatenate([faces, faces[:, ::-1]]))
    assert int(found.label.max()) + 1 <= 20


def test_charts_are_not_mirrored():
    positions, faces = sphere(2)
    uv = unfold(positions, faces).uv
    sides = uv[:, 1:] - uv[:, :1]
    doubled = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    assert (doubled < 0).all()  # v points down


def test_xatlas_is_stopped_and_told(monkeypatch):
    positions, faces = sphere(5)
    found = unfold(positions, faces, seconds=0.01)
    assert "xatlas was stopped after 0.01 s" in found.problem
    assert not overlaps(found.uv[found.label == 0])


def test_a_program_that_dies_is_told(monkeypatch):
    monkeypatch.setattr(atlas.sys, "executable", "/bin/false")
    assert "xatlas failed" in unfold(*box()).problem


def test_it_can_be_cancelled():
    with pytest.raises(Cancelled):
        unfold(*sphere(6), cancelled=lambda: True)


def test_charts_by_direction_fold_nowhere():
    for shape in (sphere, torus, moebius):
        uv, label = lay_out(*shape())
        assert not layout.uv_overlaps(uv, label, label).faces.any()


def test_folds_become_charts_of_their_own():
    flat = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]], [[0, 0], [1, 0], [0.5, 0.1]]], float)
    label = without_folds(flat, np.zeros(3, np.int32))
    assert len(set(label.tolist())) == 3
    assert without_folds(flat[:2], np.zeros(2, np.int32)).tolist() == [0, 0]


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 30), st.floats(0, 6))
def test_packed_charts_keep_their_distance_and_shape(seed, count, padding):
    rng = np.random.default_rng(seed)
    uv = rng.random((count, 3, 2)) * rng.uniform(0.2, 3.0, (count, 1, 1)) + rng.random((count, 1, 2)) * 10
    uv[np.abs(areas(uv)) < 0.01, 2] += (0.5, 0.9)
    label = np.arange(count, dtype=np.int32)
    size = (160, 96)
    placed = pack(uv, label, size, padding)
    assert placed.min() >= padding / 2 - 1e-6
    assert (placed.max(axis=(0, 1)) <= np.array(size) - padding / 2 + 1e-6).all()
    sides = np.linalg.norm(placed - np.roll(placed, 1, axis=1), axis=2)
    before = np.linalg.norm(uv - np.roll(uv, 1, axis=1), axis=2)
    assert np.ptp(sides / before) < 1e-6 * (sides / before).max() + 1e-9
    rows = np.repeat(label, 3)
    segments = np.stack([placed, np.roll(placed, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    gap = layout.uv_gaps(segments, rows, np.zeros(len(rows), np.int32), 1, 100.0)[0]
    assert gap >= padding - 1e-6
    assert not overlaps(placed)


def test_too_many_charts_for_a_texture_are_refused():
    uv = np.tile(np.array([[[0, 0], [1, 0], [0, 1]]], float), (5000, 1, 1))
    with pytest.raises(InvalidMesh, match="5,000 UV charts do not fit into 16 × 16 texels; ask for a larger texture"):
        pack(uv, np.arange(5000, dtype=np.int32), (16, 16), 2)


def test_nothing_is_packed_into_nothing():
    empty = np.zeros((0, 3, 2))
    assert pack(empty, np.zeros(0, np.int32), (16, 16), 2).shape == (0, 3, 2)
