"""Colours for numbers: heat maps and labels."""

from __future__ import annotations

from colorsys import hls_to_rgb
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.mesh import F32

_HEAT = np.array([[0.02, 0.02, 0.10], [0.30, 0.06, 0.42], [0.76, 0.17, 0.33], [0.97, 0.52, 0.10], [1.0, 0.96, 0.70]])
_GOLDEN = 0.6180339887498949


def heat(values: NDArray[Any]) -> F32:
    """sRGB (…, 3) float32 for values 0…1 (…): dark blue, violet, red, orange, pale yellow; lighter is more, so that it
    reads in grey and by colour-blind eyes. Values outside, and NaN, take the nearer end, NaN the lower."""
    at = np.clip(np.nan_to_num(np.asarray(values, np.float64)), 0, 1) * (len(_HEAT) - 1)
    lower = np.minimum(at.astype(int), len(_HEAT) - 2)
    part = (at - lower)[..., None]
    colours: F32 = (_HEAT[lower] * (1 - part) + _HEAT[lower + 1] * part).astype(np.float32)
    return colours


def label_colours(count: int) -> F32:
    """`count` sRGB colours (count, 3) float32 for segments and other labels: neighbours in number differ in hue."""
    return np.array(
        [hls_to_rgb(i * _GOLDEN % 1, 0.62 - 0.14 * (i % 3 - 1), 0.62) for i in range(count)], np.float32
    ).reshape(-1, 3)
