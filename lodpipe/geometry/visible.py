"""At what size on the screen the difference between two models can be seen: docs/measuring.md, "Seen from afar"."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from lodpipe.core.asset import Asset
from lodpipe.geometry.pictures import MARGIN, Gallery, in_threads
from lodpipe.geometry.render import ground
from lodpipe.geometry.switch import SCREEN_HEIGHT
from lodpipe.kernel.pictures import seen_apart

NOTICED = 6 / 255
"""Difference of an sRGB value from which two colours can be told apart when they lie side by side: about 2.3 CIELAB
units of lightness, the just noticeable difference of Mahy, Van Eycken & Oosterlinck 1994."""


SHARE = 0.0025
"""Part of what a picture shows that may differ unseen, in the picture where it is largest: specks of that size are the
noise of one ray a pixel."""
HEIGHTS = (8, 11, 16, 23, 32, 45, 64, 91, 128, 181, 256, 362, 512, 724, SCREEN_HEIGHT)
"""Heights of pictures, in pixels, at which models are looked at."""


class Sight:
    """Tells from pictures at what size another model's difference from `source` can be seen.

    Sizes are heights in pixels that the source's bounding-box diagonal takes up. A difference of p pixels is seen at a
    height h if one of a pixel is seen at h / p.
    """

    def __init__(self, source: Gallery) -> None:
        self.source = source
        diagonal, frame = source.model.soup.diagonal, source.sphere
        self.scale = diagonal / (2 * MARGIN * frame.radius) if diagonal > 0 else 1.0
        """Of the height of a picture, what the diagonal takes up."""

    def unseen_height(self, other: Gallery, largest: float = 0.0) -> tuple[float, bool]:
        """The largest height up to which no difference of a pixel is seen, and whether one was seen above it: if not,
        no larger pictures were taken. 0 where one is seen at every height.

        Pictures have the set-up's size at most, or what it takes for a height of `largest`. A difference that is seen
        at one of HEIGHTS and not at the next is taken for an accident of sampling. Between two of them the part that
        differs is taken to grow with the height's logarithm.
        """
        top = max(self.source.setup.size, min(math.ceil(largest / self.scale), HEIGHTS[-1]))
        heights = [*(height for height in HEIGHTS if height < top), top]
        found = [(0, 0.0)]
        for height in heights:
            found.append((height, self.differs(other, height)))
            if found[-1][1] > SHARE and found[-2][1] > SHARE:
                break
        if found[-1][1] <= SHARE:
            return self.scale * top, False
        first = -2 if found[-2][1] > SHARE else -1
        return self.scale * _between(*found[first - 1], *found[first]), True

    def of(self, other: Asset, largest: float = 0.0) -> float:
        """The unseen height of an asset that has the source's textures."""
        shown = Gallery(other, self.source.setup, self.source.textures, self.source.sphere, self.source.threads)
        for model in (self.source.model, shown.model):
            model.prepare()
        return self.unseen_height(shown, largest)[0]

    def differs(self, other: Gallery, height: int) -> float:
        """Of what is shown in pictures so many pixels high, the part that differs by more than a pixel, 0…1: that of
        the view where it is largest. Pixels count where all of a square of 2 × 2 differ."""
        size = self.source.setup.size
        while size < height:
            size = min(2 * size, HEIGHTS[-1])

        def part(view: int) -> float:
            background, linear = self.source.setup.background(view), self.source.setup.lighting.linear
            a, b = self.source.shot(view, size).colours, other.shot(view, size).colours
            if a is b or np.array_equal(a, b):
                return 0.0
            shown, differ = seen_apart(a, b, height, ground(background, linear), linear, NOTICED)
            return differ / shown if shown else 0.0

        return max(in_threads(part, self.source.setup.views, self.source.threads), default=0.0)


def coarsest(height_of: Callable[[int], float], wanted: float, known: dict[int, float]) -> int:
    """The least number of triangles, to 2 %, whose unseen height is `wanted` or more.

    height_of  the unseen height at a number of triangles
    known      heights found so far, for this and further searches; it holds the source's number of triangles, which
               has to be high enough

    The next number is taken between the nearest that is too coarse and the nearest that is not, as if the height were a
    power of it, or, where that does not close in, halfway.
    """
    step = 0
    while True:
        high = min(number for number, height in known.items() if height >= wanted)
        low = max((number for number, height in known.items() if number < high and height < wanted), default=0)
        if high - low <= max(1, high // 50):
            return high
        middle = math.sqrt(max(low, 1) * high)
        if step % 3 < 2 and 0 < known[high] < math.inf:
            power = math.log(known[high] / known[low]) / math.log(high / low) if low and known[low] > 0 else 1.0
            middle = high * (wanted / known[high]) ** (1 / max(power, 0.1))
        edge = max(1, (high - low) // 50)
        number = round(min(max(middle, low + edge), high - edge))
        known[number] = height_of(number)
        step += 1


def _between(low: float, differs_low: float, high: float, differs_high: float) -> float:
    """Where what differs passes SHARE, between a height where it is below and one where it is above."""
    return float(low * (high / low) ** ((SHARE - differs_low) / (differs_high - differs_low))) if low else 0.0
