"""The kernel's work on pictures against the same in plain NumPy, and FLIP against its authors' library."""

from __future__ import annotations

import numpy as np
import pytest
from flip_evaluator import evaluate
from hypothesis import given, settings
from hypothesis import strategies as st

from lodpipe.core.errors import InvalidMesh
from lodpipe.geometry.metrics import DENSITY, TAPS
from lodpipe.geometry.texture import CLAMP, MIRROR, REPEAT, Texture
from lodpipe.kernel import picture_reference as reference
from lodpipe.kernel import pictures

LEVELS = st.integers(0, 2**32 - 1)


def shot(seed: int, size: int = 40) -> np.ndarray:
    """A premultiplied picture (size, size, 4) with empty surroundings, soft alpha and hard edges."""
    rng = np.random.default_rng(seed)
    rgba = rng.random((size, size, 4)).astype(np.float32)
    rgba[: size // 2] = rgba[: size // 2].mean(axis=(0, 1))
    rgba[..., 3] = np.where(rng.random((size, size)) < 0.3, rgba[..., 3], 1)
    rgba[..., :3] *= rgba[..., 3:]
    rgba[: size // 5] = rgba[:, : size // 6] = 0
    return rgba


def test_encoding_is_the_curve_and_clips():
    values = np.concatenate([np.linspace(-0.2, 1.2, 20_001), [0, 0.0031308, 1], 10.0 ** np.linspace(-40, 0, 2001)])
    values = values.astype(np.float32)
    np.testing.assert_allclose(pictures.to_srgb(values), reference.to_srgb(values), atol=1e-6)
    assert (np.diff(pictures.to_srgb(np.sort(values))) >= 0).all()
    assert pictures.to_srgb(np.array([[np.nan, np.inf, -np.inf]], np.float32)).tolist() == [[0, 1, 0]]


@pytest.mark.parametrize("linear", [True, False])
def test_a_background_shines_through(linear):
    rgba = shot(1) * np.float32(1.1)  # alpha above 1 counts as 1
    for background in ((0.1, 0.5, 0.9), (0.0, 0.0, 0.0)):
        expected = reference.finished(rgba, background, linear)
        np.testing.assert_allclose(pictures.finished(rgba, background, linear), expected, atol=1e-6)


@pytest.mark.parametrize("size", [1, 3, 16, 23, 39, 41, 64, 80, 97])
def test_shrinking_and_stretching(size):
    np.testing.assert_allclose(pictures.shrunk(shot(2), size), reference.shrunk(shot(2), size), atol=2e-6)


@pytest.mark.parametrize("shape", [(30, 41), (11, 60), (6, 7)])
def test_structural_similarity(shape):
    rng = np.random.default_rng(3)
    a, b = rng.random((2, *shape)).astype(np.float32)
    b = (0.7 * a + 0.3 * b).astype(np.float32)
    shown = rng.random(shape) < 0.4
    maps = reference.ssim_maps(a, b, TAPS)
    assert pictures.ssim(a, b, shown, TAPS) == pytest.approx([float(m[shown].mean()) for m in maps], abs=2e-5)
    assert pictures.ssim(a, b, np.zeros(shape, bool), TAPS) == (0, 0)


@settings(max_examples=40, deadline=None)
@given(LEVELS, st.integers(2, 45), st.booleans(), st.sampled_from([0.0, 6 / 255, 0.2]))
def test_what_is_seen_from_afar(seed, height, linear, noticed):
    a, b = shot(seed), np.roll(shot(seed), 2, axis=seed % 2)
    b[25:28, 25:28, :3] *= 0.5
    expected = reference.seen_apart(a, b, height, (0.9, 0.5, 0.1), linear, noticed)
    found = pictures.seen_apart(a, b, height, (0.9, 0.5, 0.1), linear, noticed)
    assert found[0] == expected[0]
    assert found[1] == pytest.approx(expected[1], abs=2)  # a value on the very border may fall to either side


@pytest.mark.parametrize("shape", [(96, 128), (40, 33), (3, 5), (1, 1)])
@pytest.mark.parametrize("kind", ["moved", "noise", "other", "colours"])
def test_flip_is_that_of_its_authors(shape, kind):
    rng = np.random.default_rng(4)
    a = rng.random((12, 16, 3)).repeat(8, 0).repeat(8, 1)[: shape[0], : shape[1]]
    b = {
        "moved": np.roll(a, 3, axis=1),
        "noise": np.clip(a + 0.02 * rng.normal(size=a.shape), 0, 1),
        "other": rng.random(a.shape),
        "colours": np.broadcast_to([0.0, 1.0, 0.0], a.shape),
    }[kind]
    a, b = (np.ascontiguousarray(x, np.float32) for x in (a, b))
    expected, _, _ = evaluate(a, b, "LDR", applyMagma=False, computeMeanError=False)
    found = pictures.flip(a, b, DENSITY)
    np.testing.assert_allclose(found, np.reshape(expected, shape), atol=3e-3)
    assert found.mean() == pytest.approx(np.mean(expected), abs=2e-4)


@settings(max_examples=40, deadline=None)
@given(LEVELS, st.sampled_from([REPEAT, CLAMP, MIRROR]), st.sampled_from([REPEAT, CLAMP, MIRROR]), st.booleans())
def test_textures_are_read_as_the_reference_reads_them(seed, wrap_u, wrap_v, nearest):
    rng = np.random.default_rng(seed)
    texture = Texture(rng.integers(0, 256, (*rng.integers(1, 20, 2), 4), np.uint8))
    uv = rng.uniform(-3, 3, (200, 2)).astype(np.float32)
    uv[0], uv[1] = np.nan, np.inf
    footprint = rng.uniform(0, 30, 200).astype(np.float32)
    for size in (footprint, None):
        arguments = (texture.levels, texture.meaning, uv, size, (wrap_u, wrap_v), nearest)
        np.testing.assert_allclose(pictures.sampled(*arguments), reference.sampled(*arguments), atol=2e-5)


def test_blending_over_corners():
    rng = np.random.default_rng(5)
    values = rng.random((90, 4)).astype(np.float32)
    corners = rng.integers(0, 90, (50, 3)).astype(np.int32)
    weights = rng.dirichlet(np.ones(3), 70).astype(np.float32)
    faces = rng.integers(0, 30, 70).astype(np.int32)
    for rows in (corners, None):
        expected = reference.blended(values, rows, faces, weights)
        np.testing.assert_allclose(pictures.blended(values, rows, faces, weights), expected, atol=1e-6)
    with pytest.raises(InvalidMesh, match="corners point outside their 90 rows"):
        pictures.blended(values, corners + 80, faces, weights)
    with pytest.raises(InvalidMesh, match="faces point outside"):
        pictures.blended(values, None, faces + 30, weights)
