"""What rays meet."""

from __future__ import annotations

from dataclasses import dataclass

from lodpipe.core.mesh import F32, I32


@dataclass(frozen=True, eq=False)
class Hits:
    """The first triangle that each of N rays meets.

    distance  (N,) float32, in lengths of the ray's direction; infinity where nothing was hit
    faces     (N,) int32, −1 where nothing was hit
    uv        (N, 2) float32: the point is (1 − u − v)·a + u·b + v·c of the triangle's corners a, b, c
    """

    distance: F32
    faces: I32
    uv: F32
