"""How different two pictures are: luminance RMS, PSNR, SSIM, MS-SSIM, FLIP and the silhouettes' overlap.

Pictures are float32 arrays of sRGB values in 0…1, (H, W, 3), or (H, W) for luma; masks are (H, W) bool.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.mesh import F32

Bool = NDArray[np.bool_]

LUMA = np.array([0.2126, 0.7152, 0.0722], np.float32)
"""Rec. 709 weights, applied to sRGB values."""
SIGMA, RADIUS = 1.5, 5
"""SSIM's Gaussian window: 11 × 11 (Wang et al. 2004)."""
C1, C2 = 0.01**2, 0.03**2
SCALES = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
"""MS-SSIM's exponents (Wang, Simoncelli & Bovik 2003)."""
SMALLEST = 2 * RADIUS + 1
"""Pixels along a picture's shorter side that SSIM's window needs."""
MARGIN = 16
"""Pixels kept around what two pictures show: outside of them both are background."""


@dataclass
class Sums:
    """What pairs of pictures have added up to so far; `+=` merges two.

    pixels, shown       all pixels; those that either model covers
    both                those that both cover
    luminance, colour   summed squares of the luma's difference over all pixels; of R, G and B's mean over `shown`
    angle               degrees between the facing normals, over `both`
    ssim, ms_ssim, flip one value for each picture that it was made for
    """

    pixels: int = 0
    shown: int = 0
    both: int = 0
    luminance: float = 0.0
    colour: float = 0.0
    angle: float = 0.0
    ssim: list[float] = field(default_factory=list)
    ms_ssim: list[float] = field(default_factory=list)
    flip: list[float] = field(default_factory=list)

    def __iadd__(self, other: Sums) -> Sums:
        for part in fields(self):
            setattr(self, part.name, getattr(self, part.name) + getattr(other, part.name))
        return self

    @property
    def luminance_rms(self) -> float:
        """Root mean square of the luma's difference over all pixels of all pictures, 0…255 (Lindstrom & Turk 2000)."""
        return 255.0 * float(np.sqrt(self.luminance / self.pixels)) if self.pixels else 0.0

    @property
    def psnr(self) -> float | None:
        """−10 log₁₀ of the mean square difference of R, G and B over what is shown; None for equal pictures."""
        return -10.0 * float(np.log10(self.colour / self.shown)) if self.colour > 0 else None

    @property
    def silhouette_iou(self) -> float | None:
        """Pixels that both cover over pixels that one of the two covers, 0…1; None where nothing is shown."""
        return self.both / self.shown if self.shown else None

    @property
    def normal_degrees(self) -> float | None:
        """Mean angle between the facing normals where both are seen; None where there is no such place."""
        return self.angle / self.both if self.both else None


def difference(a: F32, b: F32, shown: Bool, *, scales: bool = True, flip: bool = False) -> Sums:
    """What the pictures `a` and `b` (H, W, 3) differ by; `shown` (H, W): what either model covers.

    `scales`: MS-SSIM as well; `flip`: FLIP as well, which takes twenty times as long as all the rest.
    """
    sums = Sums(pixels=shown.size, shown=int(np.count_nonzero(shown)))
    if not sums.shown:
        return sums
    box = crop_box(shown)
    a, b, shown = a[box], b[box], shown[box]
    if np.array_equal(a, b):
        sums.ssim, sums.ms_ssim, sums.flip = [1.0], [1.0] * scales, [0.0] * flip
        return sums
    luma_a, luma_b = a @ LUMA, b @ LUMA
    sums.luminance = float(np.square(luma_a - luma_b, dtype=np.float64).sum())
    sums.colour = float(np.square((a - b)[shown], dtype=np.float64).sum()) / 3
    if min(shown.shape) >= SMALLEST:
        sums.ssim = [float(ssim_maps(luma_a, luma_b)[0][shown].mean())]
        sums.ms_ssim = [ms_ssim(luma_a, luma_b, shown)] * scales
    if flip:
        sums.flip = [float(flip_map(a, b)[shown].mean())]
    return sums


def crop_box(shown: Bool) -> tuple[slice, slice]:
    """The smallest rectangle that holds all of `shown`, and MARGIN more; it is not empty."""
    rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))

    def around(used: NDArray[np.int64]) -> slice:
        return slice(max(int(used[0]) - MARGIN, 0), int(used[-1]) + MARGIN + 1)

    return around(rows), around(columns)


def ssim_maps(a: F32, b: F32) -> tuple[F32, F32]:
    """Structural similarity at each pixel, and its contrast-and-structure part: (H, W) float32 each, up to 1.

    Wang, Bovik, Sheikh & Simoncelli 2004, equations 13 and 14, with their Gaussian window; the borders are mirrored.
    """
    mean_a, mean_b = _blurred(a), _blurred(b)
    square_a, square_b, product = mean_a * mean_a, mean_b * mean_b, mean_a * mean_b
    variance = _blurred(a * a + b * b) - square_a - square_b
    covariance = _blurred(a * b) - product
    structure = (2 * covariance + np.float32(C2)) / (np.maximum(variance, 0) + np.float32(C2))
    return structure * (2 * product + np.float32(C1)) / (square_a + square_b + np.float32(C1)), structure


def ms_ssim(a: F32, b: F32, shown: Bool) -> float:
    """Multi-scale SSIM over the pixels `shown`, 0…1: each scale's mean, to the power of its weight, multiplied.

    Wang, Simoncelli & Bovik 2003, equation 7, with five scales, halved by 2 × 2 means; pictures too small for all five
    (SMALLEST at the last) use fewer, with their weights scaled to the same sum. Negative means count as 0.
    """
    steps = len(SCALES)
    while steps > 1 and min(a.shape) >> (steps - 1) < SMALLEST:
        steps -= 1
    weights = np.array(SCALES[:steps]) / sum(SCALES[:steps])
    result = 1.0
    for step, weight in enumerate(weights):
        whole, structure = ssim_maps(a, b)
        figure = whole if step == steps - 1 else structure
        result *= max(float(figure[shown].mean()), 0.0) ** float(weight)
        if step < steps - 1:
            a, b, shown = _halved(a), _halved(b), _halved(shown.astype(np.float32)) > 0
    return result


def flip_map(a: F32, b: F32) -> F32:
    """FLIP (H, W) float32, 0…1: how different two pictures look when one takes the other's place, 67 pixels a degree.

    Andersson et al. 2020, "FLIP: a difference evaluator for alternating images", by the authors' library.
    """
    from flip_evaluator import evaluate

    pair = (np.ascontiguousarray(np.clip(x, 0, 1), np.float32) for x in (a, b))
    error, _, _ = evaluate(*pair, "LDR", applyMagma=False, computeMeanError=False)
    return np.asarray(error, np.float32).reshape(a.shape[:2])


def facing_angles(a: F32, b: F32) -> float:
    """Summed angles in degrees between unit vectors (N, 3); exactly 0 between equal ones."""
    apart = a - b
    half = np.sqrt(np.einsum("nd,nd->n", apart, apart, dtype=np.float64)) / 2
    return float(np.degrees(2 * np.arcsin(np.minimum(half, 1.0))).sum())


def _blurred(image: F32) -> F32:
    """`image` (H, W) under SSIM's Gaussian window."""
    taps = np.exp(-0.5 * np.square(np.arange(RADIUS + 1) / SIGMA))
    taps = (taps / (2 * taps.sum() - taps[0])).astype(np.float32)
    for axis in (0, 1):
        size = image.shape[axis]
        padded = np.pad(image, [(RADIUS, RADIUS) if k == axis else (0, 0) for k in (0, 1)], mode="symmetric")

        def shifted(by: int, padded: F32 = padded, axis: int = axis, size: int = size) -> F32:
            start = RADIUS + by
            return padded[start : start + size] if axis == 0 else padded[:, start : start + size]

        image = taps[0] * shifted(0)
        for k in range(1, RADIUS + 1):
            image += taps[k] * (shifted(-k) + shifted(k))
    return image


def _halved(image: F32) -> F32:
    """Means of 2 × 2 pixels; an odd last row or column is left out."""
    height, width = (size // 2 * 2 for size in image.shape)
    image = image[:height, :width]
    return (image[::2, ::2] + image[1::2, ::2] + image[::2, 1::2] + image[1::2, 1::2]) * np.float32(0.25)
