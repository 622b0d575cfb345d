"""The pictures that models are compared by: where from, under which lights, taken once and kept."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.asset import Asset
from lodpipe.core.cache import Cache
from lodpipe.core.mesh import F32, F64
from lodpipe.geometry.camera import Camera, views
from lodpipe.geometry.render import DARK, HEADLIGHT, LIGHT, STUDIO, Lighting, Mode, Style, finished, shoot
from lodpipe.geometry.surface import Model
from lodpipe.geometry.texture import Textures

T = TypeVar("T")

MARGIN = 1.02
"""What a picture shows, over the diameter of the model's bounding sphere."""
Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Setup:
    """How models are photographed: orthographic views from a Fibonacci sphere, the reference's sphere filling them.

    views        number of directions
    size         pixels along a picture's sides
    mode         shaded or clay, see `Style`
    lighting     see `Lighting`
    backgrounds  sRGB 0…1, taken in turn by the views: what vanishes against one is seen against the other
    pole         the axis about which the directions are spread, and which is up
    flip_every   FLIP is measured on each so-many-th view, beginning with the first
    """

    views: int = 6
    size: int = 512
    mode: Mode = "shaded"
    lighting: Lighting = STUDIO
    backgrounds: tuple[Colour, ...] = (LIGHT, DARK)
    pole: Literal["y", "z"] = "y"
    flip_every: int = 3

    def directions(self) -> F64:
        """(views, 3) unit vectors towards the cameras."""
        around = views(self.views)
        return around if self.pole == "y" else around[:, [2, 0, 1]]

    def background(self, view: int) -> Colour:
        """What the pictures of a view stand on."""
        return self.backgrounds[view % len(self.backgrounds)]


PAPERS = Setup(24, 512, "shaded", HEADLIGHT, ((0.5, 0.5, 0.5),), "z", 5)
"""The set-up that papers on simplification use: one light at the camera, stored values multiplied as they are, base
colour alone, mid-grey behind."""


def setup_named(protocol: Literal["studio", "papers"], views: int, size: int) -> Setup:
    """The set-up of a name, with so many views of so many pixels a side."""
    return dataclasses.replace(PAPERS if protocol == "papers" else Setup(), views=views, size=size)


@dataclass(frozen=True)
class Shot:
    """One view: premultiplied RGBA (H, W, 4), silhouette (H, W), the triangles' facing normals (H, W, 3)."""

    colours: F32
    hit: NDArray[np.bool_]
    facing: F32

    @property
    def bytes(self) -> int:
        """Its size in memory."""
        return self.colours.nbytes + self.hit.nbytes + self.facing.nbytes


@dataclass(frozen=True)
class Frame:
    """What the pictures show: a sphere, and how far all that may be shown reaches from its centre."""

    centre: F64
    radius: float
    reach: float

    def camera(self, setup: Setup, view: int) -> Camera:
        """The camera of a view."""
        direction = setup.directions()[view]
        up = (0.0, 1.0, 0.0) if setup.pole == "y" else (0.0, 0.0, 1.0)
        position = self.centre + direction * (1.5 * self.reach)
        return Camera(position, self.centre, up, fov=None, height=2 * MARGIN * self.radius)


@dataclass(eq=False)
class Gallery:
    """The pictures of one model, each taken when it is first asked for, and kept in `cache`.

    `frame` is the reference's: all models of a comparison are taken with the same cameras.
    """

    asset: Asset
    setup: Setup
    textures: Textures | None = None
    frame: Frame | None = None
    threads: int = 0
    cache: Cache = field(default_factory=Cache)

    @cached_property
    def model(self) -> Model:
        """The model, ready for rendering; shared by all galleries of the cache that show the same."""
        return self.cache.get(
            ("model", self.key, self.setup.lighting.linear, self.threads),
            lambda: Model(self.asset, None, self.textures, self.threads),
            lambda model: 200 * len(model.faces),
        )

    @cached_property
    def key(self) -> str:
        """What is shown, as a fingerprint."""
        return dataclasses.replace(self.asset, lods=()).fingerprint()

    @cached_property
    def sphere(self) -> Frame:
        """The frame that is given, or the model's own sphere."""
        if self.frame is not None:
            return self.frame
        return Frame(self.model.centre, self.model.radius, 2 * self.model.radius)

    def shot(self, view: int, size: int | None = None) -> Shot:
        """The picture from a direction, of the set-up's size or another."""
        size = size or self.setup.size
        frame = self.sphere
        place = (*frame.centre, frame.radius, frame.reach)
        key = ("shot", self.key, dataclasses.replace(self.setup, flip_every=1), place, view, size)
        return self.cache.get(key, lambda: self._take(view, size), lambda shot: shot.bytes)

    def _take(self, view: int, size: int) -> Shot:
        style = Style(self.setup.mode, self.setup.lighting)
        colours, seen = shoot(self.model, self.sphere.camera(self.setup, view), size, size, style)
        return Shot(colours, seen.hit, seen.facing)

    def picture(self, shot: Shot, view: int) -> F32:
        """sRGB values (H, W, 3) of a shot on the background of its view."""
        return finished(shot.colours, self.setup.background(view), self.setup.lighting.linear)


def framed(a: Model, b: Model) -> Frame:
    """The frame of a comparison with `a`: its sphere, and room for the cameras outside of both."""
    far = float(np.linalg.norm(b.centre - a.centre)) + b.radius
    return Frame(a.centre, a.radius, 2 * max(a.radius, far))


def in_threads(work: Callable[[int], T], count: int, threads: int) -> Iterator[T]:
    """`work` of 0 … count − 1, in that order, done by up to `threads` threads (0: one for each core); who stops asking
    saves what is left but for the few that run."""
    workers = threads or os.cpu_count() or 1
    with ThreadPoolExecutor(workers) as pool:
        for start in range(0, count, workers):
            yield from pool.map(work, range(start, min(start + workers, count)))
