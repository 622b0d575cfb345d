"""The kernel's functions on pictures in plain NumPy: slow, readable, and what the tests hold the native ones to.

FLIP has its authors' library as a reference, in the tests.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.mesh import F32, I32
from lodpipe.kernel.pictures import Bool, Colour, Mips

C1, C2 = 0.01**2, 0.03**2
"""SSIM's constants, for values of 0…1."""
CLAMP, MIRROR = 33071, 33648


def to_srgb(linear: F32) -> F32:
    """See `lodpipe.kernel.pictures.to_srgb`."""
    value = np.clip(np.asarray(linear, np.float32), 0.0, 1.0)
    curve: F32 = np.float32(1.055) * value ** np.float32(1 / 2.4) - np.float32(0.055)
    return np.where(value <= 0.0031308, value * np.float32(12.92), curve)


def finished(premultiplied: F32, background: Colour, linear: bool) -> F32:
    """See `lodpipe.kernel.pictures.finished`."""
    alpha = np.minimum(premultiplied[..., 3:], 1.0)
    values = premultiplied[..., :3] + (1 - alpha) * np.array(background, np.float32)
    return to_srgb(values) if linear else np.clip(values, 0, 1)


def shrunk(colours: F32, size: int) -> F32:
    """See `lodpipe.kernel.pictures.shrunk`."""
    scale = len(colours) / size
    wide = max(scale, 1.0)
    centres = (np.arange(size) + 0.5) * scale
    off = (np.arange(len(colours)) + 0.5 - centres[:, None]) / wide
    share = ((off > -0.5) & (off <= 0.5)).astype(np.float64)
    share /= share.sum(axis=1, keepdims=True)
    means: F32 = np.einsum("yr,xc,rck->yxk", share, share, colours).astype(np.float32)
    return means


def phases(colours: F32, height: int) -> F32:
    """A premultiplied picture (S, S, 4) as it looks `height` pixels high, at the pixels' places and halfway between:
    (2·height − 1, 2·height − 1, 4), each the mean of a pixel's area; pixels themselves are at even places.

    So a picture that is shifted by half a pixel finds itself. A picture that has less than two rows a pixel is
    stretched: means then reach a little farther.
    """
    fine = shrunk(colours, 2 * height)
    rows = (fine[1:] + fine[:-1]) * np.float32(0.5)
    return (rows[:, 1:] + rows[:, :-1]) * np.float32(0.5)


def unexplained(a: F32, b: F32, noticed: float) -> Bool:
    """Pixels (h, h) where one of two pictures cannot be made from the other by moving things up to one pixel.

    Both are given in `phases` (2h − 1, 2h − 1, 3). A pixel is explained if each of its values lies, give or take
    `noticed`, between the least and the greatest that the other picture has, at any phase, within one pixel of it: then
    what is seen there has shifted by less than a pixel, or changed by less than can be noticed.
    """
    return _outside(a, b, noticed) | _outside(b, a, noticed)


def seen_apart(a: F32, b: F32, height: int, background: Colour, linear: bool, noticed: float) -> tuple[int, int]:
    """See `lodpipe.kernel.pictures.seen_apart`."""
    a, b = phases(a, height), phases(b, height)
    shown = (a[::2, ::2, 3] > 0) | (b[::2, ::2, 3] > 0)
    mask = unexplained(finished(a, background, linear), finished(b, background, linear), noticed)
    solid = mask[1:, 1:] & mask[:-1, 1:] & mask[1:, :-1] & mask[:-1, :-1]
    return int(np.count_nonzero(shown)), int(np.count_nonzero(solid))


def ssim_maps(a: F32, b: F32, taps: F32) -> tuple[F32, F32]:
    """Structural similarity at each pixel, and its contrast-and-structure part: (H, W) float32 each, up to 1.

    Wang, Bovik, Sheikh & Simoncelli 2004, equations 13 and 14; the borders are mirrored.
    """
    mean_a, mean_b = _blurred(a, taps), _blurred(b, taps)
    square_a, square_b, product = mean_a * mean_a, mean_b * mean_b, mean_a * mean_b
    variance = _blurred(a * a + b * b, taps) - square_a - square_b
    covariance = _blurred(a * b, taps) - product
    structure = (2 * covariance + np.float32(C2)) / (np.maximum(variance, 0) + np.float32(C2))
    return structure * (2 * product + np.float32(C1)) / (square_a + square_b + np.float32(C1)), structure


def blended(values: F32, corners: I32 | None, faces: I32, weights: F32) -> F32:
    """See `lodpipe.kernel.pictures.blended`."""
    rows = values.reshape(-1, 3, values.shape[1])[faces] if corners is None else values[corners[faces]]
    mean: F32 = np.einsum("nkd,nk->nd", rows, weights).astype(np.float32)
    return mean


def sampled(levels: Mips, meaning: F32, uv: F32, footprint: F32 | None, wrap: tuple[int, int], nearest: bool) -> F32:
    """See `lodpipe.kernel.pictures.sampled`."""
    uv = np.nan_to_num(uv, posinf=0.0, neginf=0.0)
    level = np.zeros(len(uv), np.float32)
    if footprint is not None:
        level = np.log2(np.clip(np.nan_to_num(footprint), 1.0, None))
    level = np.minimum(level, np.float32(len(levels[1]) - 1))
    lower = np.floor(level).astype(np.int64)
    part = (level - lower)[:, None]
    fine = _bilinear(levels, meaning, lower, uv, wrap, nearest)
    coarse = _bilinear(levels, meaning, np.ceil(level).astype(np.int64), uv, wrap, nearest)
    return (fine + (coarse - fine) * part).astype(np.float32)


def _outside(a: F32, b: F32, noticed: float) -> Bool:
    pixels = a[::2, ::2]
    low, high = (_extreme(b, pick) for pick in (np.minimum, np.maximum))
    outside = (pixels > high + np.float32(noticed)) | (pixels < low - np.float32(noticed))
    return outside[..., 0] | outside[..., 1] | outside[..., 2]


def _extreme(image: F32, pick: np.ufunc) -> F32:
    """Of phases (2h − 1, 2h − 1, 3), the least or greatest within one pixel of each pixel (h, h, 3)."""
    for axis in (0, 1):
        padded = np.pad(image, [(2, 2) if k == axis else (0, 0) for k in range(3)], mode="edge")
        length = image.shape[axis]
        parts = [padded[k : k + length : 2] if axis == 0 else padded[:, k : k + length : 2] for k in range(5)]
        image = pick.reduce(parts)
    return image


def _blurred(image: F32, taps: F32) -> F32:
    """`image` (H, W) under a window whose half is `taps`."""
    radius = len(taps) - 1
    for axis in (0, 1):
        padded = np.pad(image, [(radius, radius) if k == axis else (0, 0) for k in (0, 1)], mode="symmetric")
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * radius + 1, axis=axis)
        image = windows @ np.concatenate([taps[:0:-1], taps])
    return image


def _bilinear(
    levels: Mips, meaning: F32, level: NDArray[np.int64], uv: F32, wrap: tuple[int, int], nearest: bool
) -> F32:
    texels, starts, widths, heights = levels
    width, height = widths[level], heights[level]
    x, y = uv[:, 0] * width - 0.5, uv[:, 1] * height - 0.5
    if nearest:
        x, y = np.floor(x + 0.5), np.floor(y + 0.5)
    left, top = np.floor(x), np.floor(y)
    total = np.zeros((len(uv), 4))
    for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
        column = _wrapped(left.astype(np.int64) + dx, width, wrap[0])
        row = _wrapped(top.astype(np.int64) + dy, height, wrap[1])
        found = texels[starts[level] + row * width + column]
        colour = np.column_stack([meaning[found[:, :3]], found[:, 3] / 255])
        share = np.abs(1 - dx - (x - left)) * np.abs(1 - dy - (y - top))
        total += share[:, None] * colour
    return total.astype(np.float32)


def _wrapped(index: NDArray[np.int64], size: I32, mode: int) -> NDArray[np.int64]:
    """Texel numbers in 0 … size − 1 for any integer."""
    if mode == CLAMP:
        return np.clip(index, 0, size - 1)
    if mode == MIRROR:
        folded = index % (2 * size)
        index = np.minimum(folded, 2 * size - 1 - folded)
    return np.asarray(index % size, np.int64)
