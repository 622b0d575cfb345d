"""Filling what lies between the charts of a texture, so that no background shows at any mip level."""

from __future__ import annotations

import numpy as np

from lodpipe.core.mesh import F32
from lodpipe.geometry.flatten import Bool
from lodpipe.geometry.texture import U8

STRIP = 512
"""Rows worked on at once, which bounds the memory."""


def fill_gaps(image: U8, known: Bool) -> None:
    """Give every texel of `image` (H, W, C) that is not `known` (H, W) the mean of what is near it, in place.

    Push and pull (Gortler et al. 1996, "The lumigraph", section 4.2.2): means of the known texels over ever larger
    squares; each gap takes the smallest square that has any. Values are averaged as they are stored: they stand beside
    the charts, not in them.
    """
    if known.all() or not known.any():
        return
    levels = [_halved(image, known)]
    while not (levels[-1][1] > 0).all():
        levels.append(_halved(*levels[-1]))
    filled = levels[-1][0]
    for values, weight in reversed(levels[:-1]):
        missing = weight <= 0
        values[missing] = _doubled(filled, slice(0, len(values)), values.shape[1])[missing]
        filled = values
    for top in range(0, len(image), STRIP):
        rows = slice(top, min(top + STRIP, len(image)))
        gaps = ~known[rows]
        if gaps.any():
            image[rows][gaps] = np.rint(_doubled(filled, rows, image.shape[1])[gaps]).astype(np.uint8)


def spread_colour(image: U8) -> None:
    """Give texels of `image` (H, W, 4) that cannot be seen (alpha 0) the colour of what is near, in place.

    Filters blend it in at the edges of what can be seen.
    """
    colour = np.ascontiguousarray(image[..., :3])
    fill_gaps(colour, image[..., 3] > 0)
    image[..., :3] = colour


def _halved(values: U8 | F32, weight: Bool | F32) -> tuple[F32, F32]:
    """Weighted means over squares of 2 × 2, and whether these have any weight (0 or 1)."""
    height, width = weight.shape
    sums = np.zeros(((height + 1) // 2, (width + 1) // 2, values.shape[2]), np.float32)
    total = np.zeros(sums.shape[:2], np.float32)
    for y in (0, 1):
        for x in (0, 1):
            part = weight[y::2, x::2]
            rows, columns = part.shape
            share = part.astype(np.float32)
            total[:rows, :columns] += share
            for channel in range(values.shape[2]):
                sums[:rows, :columns, channel] += values[y::2, x::2, channel] * share
    sums /= np.maximum(total, 1.0)[..., None]
    return sums, (total > 0).astype(np.float32)


def _doubled(values: F32, rows: slice, width: int) -> F32:
    """The rows `rows` of the image twice as large."""
    lines = np.arange(rows.start, rows.stop) // 2
    larger: F32 = values[lines].repeat(2, axis=1)[:, :width]
    return larger
