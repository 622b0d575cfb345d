"""How different two pictures are: luminance RMS, PSNR, SSIM, MS-SSIM, FLIP and the silhouettes' overlap.

Pictures are float32 arrays of sRGB values in 0…1, (H, W, 3), or (H, W) for luma; masks are (H, W) bool.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.mesh import F32
from lodpipe.kernel.pictures import flip, ssim

Bool = NDArray[np.bool_]

LUMA = np.array([0.2126, 0.7152, 0.0722], np.float32)
"""Rec. 709 weights, applied to sRGB values."""
SIGMA, RADIUS = 1.5, 5
"""SSIM's Gaussian window: 11 × 11 (Wang et al. 2004)."""
TAPS = np.exp(-0.5 * np.square(np.arange(RADIUS + 1) / SIGMA))
TAPS = (TAPS / (2 * TAPS.sum() - TAPS[0])).astype(np.float32)
"""Half of the window, from its middle outwards."""
DENSITY = 67.0
"""Pixels a degree for FLIP: a screen 0.7 m wide with 3840 pixels, 0.7 m away, as its authors propose."""
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
        sums.ssim = [ssim(luma_a, luma_b, shown, TAPS)[0]]
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
        whole, structure = ssim(a, b, shown, TAPS)
        result *= max(whole if step == steps - 1 else structure, 0.0) ** float(weight)
        if step < steps - 1:
            a, b, shown = _halved(a), _halved(b), _halved(shown.astype(np.float32)) > 0
    return result


def flip_map(a: F32, b: F32) -> F32:
    """FLIP (H, W) float32, 0…1: how different two pictures look when one takes the other's place, 67 pixels a degree.

    Andersson et al. 2020, "FLIP: a difference evaluator for alternating images"; the authors' library agrees.
    """
    return flip(a, b, DENSITY)


def facing_angles(a: F32, b: F32) -> float:
    """Summed angles in degrees between unit vectors (N, 3); exactly 0 between equal ones."""
    apart = a - b
    half = np.sqrt(np.einsum("nd,nd->n", apart, apart, dtype=np.float64)) / 2
    return float(np.degrees(2 * np.arcsin(np.minimum(half, 1.0))).sum())


def _halved(image: F32) -> F32:
    """Means of 2 × 2 pixels; an odd last row or column is left out."""
    height, width = (size // 2 * 2 for size in image.shape)
    image = image[:height, :width]
    return (image[::2, ::2] + image[1::2, ::2] + image[::2, 1::2] + image[1::2, 1::2]) * np.float32(0.25)
