"""Filling between charts."""

from __future__ import annotations

import numpy as np

from lodpipe.geometry.fill import fill_gaps, spread_colour


def test_known_texels_stay_and_gaps_take_what_is_near():
    image = np.zeros((37, 50, 3), np.uint8)
    known = np.zeros((37, 50), bool)
    image[:, :5], known[:, :5] = (200, 10, 0), True
    image[:, -5:], known[:, -5:] = (0, 10, 200), True
    before = image.copy()
    fill_gaps(image, known)
    assert np.array_equal(image[known], before[known])
    assert (image[:, 6] == (200, 10, 0)).all()
    assert (image[:, -7] == (0, 10, 200)).all()
    assert (image[..., 1] == 10).all()


def test_one_known_texel_fills_all():
    image = np.zeros((9, 1000, 4), np.uint8)
    known = np.zeros((9, 1000), bool)
    image[4, 700], known[4, 700] = (1, 2, 3, 4), True
    fill_gaps(image, known)
    assert (image == (1, 2, 3, 4)).all()


def test_with_all_or_nothing_known_nothing_changes():
    image = np.full((4, 4, 3), 7, np.uint8)
    fill_gaps(image, np.ones((4, 4), bool))
    fill_gaps(image, np.zeros((4, 4), bool))
    assert (image == 7).all()


def test_what_cannot_be_seen_takes_the_colour_of_what_can():
    image = np.zeros((4, 4, 4), np.uint8)
    image[0, 0] = 200, 100, 50, 9
    image[3, 3] = 7, 7, 7, 0
    spread_colour(image)
    assert (image[..., :3] == [200, 100, 50]).all()
    assert image[0, 0, 3] == 9 and image[1:, 1:, 3].max() == 0
