"""Several ways to weigh what is seen, and pictures that tell for each level which of them served it best.

What a texture's slip or a bent normal costs on the screen depends on the model and on how coarse it gets; no one price
is best for all (docs/decisions/008-visual-metric.md). Levels are cheap, and so are small pictures of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from lodpipe.core.asset import Asset
from lodpipe.geometry.pictures import PAPERS, Frame, Gallery, in_threads
from lodpipe.geometry.texture import Textures


@dataclass(frozen=True)
class Way:
    """Multiples of the usual prices of what steers: normals, textures and colours, seams by their contrast."""

    normal: float = 1.0
    slip: float = 1.0
    seam: float = 1.0


WAYS = (Way(), Way(normal=0.0), Way(slip=0.3), Way(normal=2.0), Way(seam=16.0, normal=0.0), Way(slip=3.0, seam=4.0))
"""The first is what is done without trials. More ways add less and less (record 008)."""

SETUP = replace(PAPERS, views=14, size=192, pole="y")
"""How levels are looked at: a light at the camera, mid-grey behind. Neither the number of directions nor their pole is
that of the pictures that reports and papers compare, so that those stay a test."""


@dataclass(eq=False)
class Jury:
    """Tells how far an asset looks from the source."""

    source: Asset
    textures: Textures
    threads: int = 0
    frame: Frame = field(init=False)

    def __post_init__(self) -> None:
        self.frame = self.gallery.sphere

    @cached_property
    def gallery(self) -> Gallery:
        """The pictures of the source."""
        return Gallery(self.source, SETUP, self.textures, threads=self.threads)

    def error(self, other: Asset) -> float:
        """Mean squared difference of the pictures' RGB, 0…1, over the pixels that the source or `other` covers."""
        shown = Gallery(other, SETUP, self.textures, self.frame, self.threads)
        for model in (self.gallery.model, shown.model):
            model.prepare()

        def of(view: int) -> tuple[float, int]:
            a, b = self.gallery.shot(view), shown.shot(view)
            covered = a.hit | b.hit
            off = self.gallery.picture(a, view)[covered] - shown.picture(b, view)[covered]
            return float(np.square(off, dtype=np.float64).sum()) / 3, int(np.count_nonzero(covered))

        found = list(in_threads(of, SETUP.views, self.threads))
        return sum(square for square, _ in found) / max(sum(pixels for _, pixels in found), 1)

    def best(self, candidates: Sequence[Asset]) -> int:
        """The row of the asset that looks most like the source; of equals the first."""
        return int(np.argmin([self.error(asset) for asset in candidates])) if len(candidates) > 1 else 0
