"""Where a picture is taken from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lodpipe.core.mesh import F32, F64
from lodpipe.geometry.flatten import Soup


def views(count: int) -> F64:
    """(count, 3) float64: unit vectors spread evenly over the sphere (a Fibonacci lattice), y up."""
    i = np.arange(count) + 0.5
    y, turn = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    level = np.sqrt(1 - y * y)
    return np.stack([level * np.sin(turn), y, level * np.cos(turn)], axis=1)


CARDINAL = {
    "front": (0.0, 0.0, 1.0),
    "right": (1.0, 0.0, 0.0),
    "back": (0.0, 0.0, -1.0),
    "left": (-1.0, 0.0, 0.0),
    "top": (0.0, 1.0, 0.0),
    "bottom": (0.0, -1.0, 0.0),
}
"""Where the camera stands for the six cardinal views; a model's front looks along +z, as glTF says. `right` is the
viewer's right of the front view."""


def bounding_sphere(soup: Soup) -> tuple[F64, float]:
    """Centre (3,) of the bounding box, and the radius that holds all triangles; 1 where they have no extent."""
    low, high = soup.bounds
    centre = low + (high - low) / 2
    extent = soup.diagonal
    if extent == 0:
        return centre, 1.0
    offsets = (soup.positions[soup.used] - centre) / extent
    return centre, extent * float(np.sqrt(np.einsum("ij,ij->i", offsets, offsets).max()))


@dataclass(frozen=True)
class Camera:
    """A camera at `position` that looks at `target`, both (3,) in world units.

    fov     vertical angle of view in degrees, 0 < fov < 180; None for an orthographic camera
    height  what an orthographic camera sees from top to bottom, in world units
    """

    position: F64
    target: F64
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    fov: float | None = 30.0
    height: float = 2.0

    @classmethod
    def around(
        cls,
        centre: F64,
        radius: float,
        direction: Sequence[float] | F64 = (0.5, 0.35, 1.0),
        fov: float | None = 30.0,
        margin: float = 1.04,
    ) -> Camera:
        """A camera from `direction` that has a sphere in full view, filling the picture's height but for `margin`."""
        towards = np.asarray(direction, np.float64)
        towards = towards / np.linalg.norm(towards)
        reach = radius * margin
        distance = 3 * reach if fov is None else reach / np.sin(np.radians(fov / 2))
        return cls(centre + towards * distance, centre, fov=fov, height=2 * reach)

    @property
    def axes(self) -> tuple[F64, F64, F64]:
        """Unit vectors (3,) to the right, up and away from what is seen."""
        back = self.position - self.target
        back = back / np.linalg.norm(back)
        up = np.asarray(self.up, np.float64)
        if abs(up @ back) > 0.999 * np.linalg.norm(up):  # looking along it
            up = np.array([0.0, 0.0, -1.0]) if abs(back[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
        right = np.cross(up, back)
        right /= np.linalg.norm(right)
        return right, np.cross(back, right), back

    def rays(self, width: int, height: int, rows: slice, centre: F64, scale: float) -> tuple[F32, F32]:
        """Origins and unit directions (N, 3) float32 through the pixel centres of `rows`, left to right, top first.

        In the coordinates ``(world − centre) / scale``, so that single precision serves everywhere.
        """
        right, up, back = (axis.astype(np.float32) for axis in self.axes)
        x = ((np.arange(width) + 0.5) / width * 2 - 1) * (width / height)
        y = 1 - (np.arange(height)[rows] + 0.5) / height * 2
        across: F32 = x.astype(np.float32)[None, :, None] * right
        shift: F32 = (across + y.astype(np.float32)[:, None, None] * up).reshape(-1, 3)
        start: F32 = ((self.position - centre) / scale).astype(np.float32)
        if self.fov is None:
            return start + shift * np.float32(self.height / 2 / scale), np.broadcast_to(-back, shift.shape)
        directions = shift * np.float32(np.tan(np.radians(self.fov / 2))) - back
        directions /= np.sqrt(np.einsum("nd,nd->n", directions, directions))[:, None]
        return np.broadcast_to(start, shift.shape), directions

    def pixel_size(self, height: int, scale: float) -> tuple[float, float]:
        """(a, b): a pixel of a picture `height` pixels high covers a + b·distance, in units of `scale`."""
        if self.fov is None:
            return self.height / height / scale, 0.0
        return 0.0, 2 * float(np.tan(np.radians(self.fov / 2))) / height
