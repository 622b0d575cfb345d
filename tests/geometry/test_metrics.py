"""Figures of pictures whose differences are known."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.metrics import structural_similarity

from lodpipe.geometry.metrics import TAPS, Sums, difference, facing_angles, flip_map, ms_ssim
from lodpipe.kernel import picture_reference


def ssim_maps(a, b):
    return picture_reference.ssim_maps(a, b, TAPS)


WHOLE = np.ones((96, 128), bool)


def scenery(seed: int = 0):
    """A soft random picture (96, 128, 3)."""
    rng = np.random.default_rng(seed)
    coarse = rng.random((12, 16, 3)).repeat(8, 0).repeat(8, 1)
    return (0.2 + 0.6 * (coarse + np.roll(coarse, 4, 0) + np.roll(coarse, 4, 1)) / 3).astype(np.float32)


def test_a_known_offset():
    a = scenery()
    shown = WHOLE.copy()
    shown[:48] = False
    b = a.copy()
    b[48:] += np.float32(0.1)
    sums = difference(a, b, shown)
    assert sums.psnr == pytest.approx(20.0, abs=1e-4)  # over what is shown
    assert sums.luminance_rms == pytest.approx(255 * np.sqrt(0.01 / 2), rel=1e-5)  # over all pixels


def test_luma_has_the_weights_of_rec_709():
    a = np.zeros((20, 20, 3), np.float32)
    for channel, weight in enumerate((0.2126, 0.7152, 0.0722)):
        b = a.copy()
        b[:, :, channel] = 1
        assert difference(a, b, np.ones((20, 20), bool)).luminance_rms == pytest.approx(255 * weight, rel=1e-5)


def test_equal_pictures():
    sums = difference(scenery(), scenery(), WHOLE, flip=True)
    assert (sums.luminance_rms, sums.psnr) == (0.0, None)
    assert (sums.ssim, sums.ms_ssim, sums.flip) == ([1.0], [1.0], [0.0])


def test_ssim_is_that_of_scikit_image():
    a, b = (scenery(seed)[:, :, 0] for seed in (1, 2))
    whole, _ = ssim_maps(a, b)
    options = {"data_range": 1.0, "gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "full": True}
    _, expected = structural_similarity(a.astype(np.float64), b.astype(np.float64), **options)
    np.testing.assert_allclose(whole, expected, atol=3e-4)
    np.testing.assert_allclose(ssim_maps(a, a)[0], 1.0, atol=3e-4)


def test_ms_ssim_of_one_scale_is_ssim_and_of_more_looks_farther():
    a, b = (scenery(seed)[:20, :, 0] for seed in (1, 2))  # one halving would leave less than a window
    mask = np.ones(a.shape, bool)
    assert ms_ssim(a, b, mask) == pytest.approx(float(ssim_maps(a, b)[0].mean()), rel=1e-5)
    fine = np.tile(np.array([[0.1, -0.1], [-0.1, 0.1]], np.float32), (48, 64))  # vanishes in the first halving
    flat = np.full((96, 128), 0.5, np.float32)
    assert ms_ssim(flat, flat + fine, WHOLE) > float(ssim_maps(flat, flat + fine)[0].mean()) + 0.2


def test_every_figure_falls_along_a_chain_of_noise():
    """More of the same noise is never called better."""
    a = scenery()
    noise = np.random.default_rng(3).normal(size=a.shape).astype(np.float32)
    chain = [difference(a, np.clip(a + s * noise, 0, 1), WHOLE, flip=True) for s in (0.005, 0.01, 0.02, 0.05, 0.1, 0.2)]
    for worse in (
        [sums.luminance_rms for sums in chain],
        [-sums.psnr for sums in chain],
        [-sums.ssim[0] for sums in chain],
        [-sums.ms_ssim[0] for sums in chain],
        [sums.flip[0] for sums in chain],
    ):
        assert (np.diff(worse) > 0).all(), worse


def test_cropping_to_what_is_shown_changes_nothing():
    """Outside of both models the pictures are equal: a wide empty border only thins the mean over all pixels."""
    a, b = scenery(1), scenery(2)
    wide = [np.pad(x, ((70, 60), (40, 90), (0, 0)), constant_values=0.5) for x in (a, b)]
    shown = np.pad(WHOLE, ((70, 60), (40, 90)))
    small, large = difference(a, b, WHOLE), difference(*wide, shown)
    assert large.psnr == pytest.approx(small.psnr)
    assert large.luminance_rms == pytest.approx(small.luminance_rms * np.sqrt(WHOLE.size / shown.size))


def test_flip_is_between_0_and_1_and_black_against_white_is_near_1():
    black, white = np.zeros((40, 40, 3), np.float32), np.ones((40, 40, 3), np.float32)
    assert flip_map(black, white).mean() > 0.9
    assert flip_map(black, black).max() == 0


def test_angles_between_normals():
    a = np.array([[0, 0, 1], [0, 0, 1], [1, 0, 0]], np.float32)
    b = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], np.float32)
    assert facing_angles(a, b) == pytest.approx(270.0)
    assert facing_angles(a, a) == 0.0


def test_pictures_too_small_for_a_window_have_no_ssim():
    a = scenery()[:10, :10]
    sums = difference(a, a + np.float32(0.1), np.ones((10, 10), bool))
    assert (sums.ssim, sums.ms_ssim) == ([], [])
    assert sums.psnr == pytest.approx(20, abs=1e-3)


def test_nothing_shown_is_no_figure_but_no_error_either():
    sums = difference(scenery(), scenery(), np.zeros_like(WHOLE), flip=True)
    sums += Sums()
    assert (sums.luminance_rms, sums.psnr, sums.silhouette_iou, sums.normal_degrees) == (0.0, None, None, None)
