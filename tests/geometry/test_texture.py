"""Texture look-up: transforms, wrap modes, mip levels."""

from __future__ import annotations

import numpy as np
import pytest

from lodpipe.core.material import TextureRef
from lodpipe.geometry.texture import CLAMP, MIRROR, REPEAT, Texture, Textures, chequer, to_linear, to_srgb, uv_matrix


def grey(values):
    """A texture of plain numbers."""
    return Texture(np.asarray(values, np.uint8)[:, :, None], srgb=False)


def red(texture, u, v, **options):
    return texture.sample(np.array([[u, v]], np.float32), **options)[0, 0] * 255


def test_colour_curves_are_each_others_inverse():
    values = np.arange(256) / 255
    np.testing.assert_allclose(to_srgb(to_linear(values)), values, atol=2e-6)
    assert to_linear(np.array([0.5]))[0] == pytest.approx(0.21404, abs=1e-5)


def test_texel_centres_and_what_lies_between():
    texture = grey([[0, 100], [200, 50]])
    assert red(texture, 0.25, 0.25) == pytest.approx(0)
    assert red(texture, 0.75, 0.25) == pytest.approx(100)
    assert red(texture, 0.25, 0.75) == pytest.approx(200)  # v runs down
    assert red(texture, 0.5, 0.25) == pytest.approx(50)
    assert red(texture, 0.5, 0.5) == pytest.approx(87.5)
    assert red(texture, 0.6, 0.25, nearest=True) == pytest.approx(100)


@pytest.mark.parametrize(
    ("mode", "expected"),
    [(REPEAT, [30, 10, 20, 30, 10]), (CLAMP, [10, 10, 20, 30, 30]), (MIRROR, [10, 10, 20, 30, 30])],
)
def test_wrap_modes_beyond_the_edge(mode, expected):
    texture = grey([[10, 20, 30]])
    got = [red(texture, (k + 0.5) / 3, 0.5, wrap=(mode, REPEAT)) for k in range(-1, 4)]
    assert got == pytest.approx(expected)
    turned = grey([[10], [20], [30]])
    assert [red(turned, 0.5, (k + 0.5) / 3, wrap=(REPEAT, mode)) for k in range(-1, 4)] == pytest.approx(expected)


def test_mirrored_tiles_far_away():
    texture = grey([[10, 20, 30]])
    for k in range(-9, 9):
        period = [10, 20, 30, 30, 20, 10]
        assert red(texture, (k + 0.5) / 3, 0.5, wrap=(MIRROR, REPEAT)) == pytest.approx(period[k % 6])


@pytest.mark.parametrize("shape", [(64, 64), (37, 53), (1, 7), (1025, 3)])
def test_the_smallest_level_is_the_mean(shape):
    pixels = np.random.default_rng(1).integers(0, 256, shape, dtype=np.uint8)
    far = red(grey(pixels), 0.3, 0.7, footprint=np.array([1e6], np.float32))
    assert far == pytest.approx(pixels.mean(), abs=2)


def test_mip_levels_of_odd_sizes_do_not_shift():
    ramp = np.repeat(np.linspace(0, 255, 81).round().astype(np.uint8)[None], 5, axis=0)
    for level in (1, 2, 3):
        half = red(grey(ramp), 0.5, 0.5, footprint=np.array([2.0**level], np.float32))
        assert half == pytest.approx(127.5, abs=1.5)


def test_averages_are_taken_in_linear_light():
    stripes = np.tile(np.array([0, 255], np.uint8), (8, 4))[:, :, None]
    seen = Texture(stripes).sample(np.array([[0.5, 0.5]], np.float32), np.array([2.0], np.float32))
    assert seen[0, 0] == pytest.approx(0.5, abs=0.01)


def test_between_two_levels():
    texture = grey(np.tile(np.array([0, 255], np.uint8), (8, 4)))
    sharp, soft, between = (
        red(texture, 1 / 16, 0.5, footprint=np.array([2.0**level], np.float32)) for level in (0, 1, 0.5)
    )
    assert (sharp, soft) == pytest.approx((0, 127.5), abs=1)
    assert between == pytest.approx(63.75, abs=1)


@pytest.mark.parametrize(
    ("channels", "expected"), [(1, (9, 9, 9, 255)), (2, (9, 9, 9, 8)), (3, (9, 8, 7, 255)), (4, (9, 8, 7, 6))]
)
def test_channels(channels, expected):
    pixels = np.broadcast_to(np.array([9, 8, 7, 6][:channels], np.uint8), (2, 2, channels))
    got = Texture(pixels, srgb=False).sample(np.zeros((1, 2), np.float32))[0] * 255
    assert got.tolist() == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize(
    "pixels", [np.zeros((2, 2, 5), np.uint8), np.zeros((2, 2, 3), np.float32), np.zeros((0, 2, 3), np.uint8)]
)
def test_what_is_not_an_image(pixels):
    with pytest.raises(ValueError, match="uint8"):
        Texture(pixels)


def test_coordinates_that_are_not_finite():
    texture = grey([[10, 20]])
    got = texture.sample(np.array([[np.nan, 0], [np.inf, -np.inf]], np.float32), np.array([np.nan, np.inf], np.float32))
    assert np.isfinite(got).all()


def test_the_transform_scales_turns_and_shifts():
    ref = TextureRef(0, offset=(0.5, 0.25), scale=(2, 3), rotation=np.pi / 2)
    # (1, 0) doubles, then turns counter-clockwise where v points down: to v = −2
    np.testing.assert_allclose(uv_matrix(ref) @ (1, 0, 1), [0.5, 0.25 - 2], atol=1e-12)
    np.testing.assert_allclose(uv_matrix(ref) @ (0, 1, 1), [0.5 + 3, 0.25], atol=1e-12)


def test_textures_are_made_once_and_when_needed():
    asked = []

    def pixels(image):
        asked.append(image)
        return np.full((2, 2, 3), 128, np.uint8) if image == 3 else None

    textures = Textures(pixels)
    assert asked == []
    assert textures.get(3) is textures.get(3)
    assert textures.get(4) is None
    assert textures.get(4) is None
    assert textures.get(None) is None
    assert asked == [3, 4]
    middle = np.array([[0.5, 0.5]], np.float32)
    assert textures.get(3).sample(middle)[0, 0] == pytest.approx(to_linear(np.array(128 / 255)), abs=1e-3)
    assert textures.get(3, plain=True).sample(middle)[0, 0] == pytest.approx(128 / 255, abs=1e-3)


def test_a_huge_image_begins_at_a_smaller_level():
    pixels = np.random.default_rng(0).integers(0, 255, (64, 96, 3), np.uint8)
    whole, bounded = Texture(pixels), Texture(pixels, largest=48)
    assert (bounded.width, bounded.height) == (48, 32)
    uv = np.random.default_rng(1).random((50, 2)).astype(np.float32)
    coarse = np.full(50, 2.0, np.float32)
    np.testing.assert_allclose(bounded.sample(uv), whole.sample(uv, coarse), atol=0.01)


def test_the_chequer_tells_directions():
    """Hue runs along u and lightness along v."""
    board = chequer()
    across = board.sample(np.array([[(k + 0.5) / 16 + 1 / 40, 1 / 40 + 0.5 / 16] for k in range(16)], np.float32))
    assert len(np.unique(across[:, :3].round(3), axis=0)) == 16
    down = board.sample(np.array([[1 / 40 + 0.5 / 16, (k + 0.5) / 16 + 1 / 40] for k in range(0, 16, 2)], np.float32))
    assert (np.diff(down[:, :3].sum(axis=1)) > 0).all()
