"""Colours for numbers."""

from __future__ import annotations

import numpy as np

from lodpipe.geometry.metrics import LUMA
from lodpipe.geometry.palette import heat, label_colours


def test_more_is_lighter_and_nothing_leaves_the_range():
    light = heat(np.linspace(0, 1, 50)) @ LUMA
    assert (np.diff(light) > 0).all()
    np.testing.assert_array_equal(heat(np.array([-1.0, np.nan, 2.0, np.inf])), heat(np.array([0.0, 0.0, 1.0, 1.0])))
    assert heat(np.zeros((3, 4))).shape == (3, 4, 3)


def test_labels_are_told_apart():
    colours = label_colours(12)
    apart = np.abs(colours[:, None] - colours[None]).max(axis=2) + np.eye(12)
    assert apart.min() > 0.05
    assert label_colours(0).shape == (0, 3)
