"""Operations on pictures and the look-ups that shading takes: checked wrappers over the compiled module.

Pictures are float32 arrays, (H, W, 3) of sRGB values, or (H, W, 4) of premultiplied RGBA as the renderer makes it.
`picture_reference` has the same functions in plain NumPy.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.errors import InvalidMesh
from lodpipe.core.mesh import F32, I32
from lodpipe.kernel import _column, _indices, _native, _table

Bool = NDArray[np.bool_]
Colour = Sequence[float] | NDArray[np.float64]
Mips = tuple[NDArray[np.uint8], NDArray[np.int64], I32, I32]
"""Texels (T, 4) of all levels of a texture, the finest first, where each level begins, widths and heights."""


def to_srgb(linear: F32) -> F32:
    """sRGB values 0…1 of linear light of any shape, clipped to 0…1 (IEC 61966-2-1), to 1e-6."""
    return cast(F32, _native.srgb(np.ascontiguousarray(linear, np.float32).reshape(-1))).reshape(np.shape(linear))


def finished(premultiplied: F32, background: Colour, linear: bool) -> F32:
    """sRGB values (…, 3) of premultiplied RGBA (…, 4) on a background of three values; those that are `linear` are
    encoded, others are sRGB already."""
    flat = np.ascontiguousarray(premultiplied, np.float32).reshape(-1, 4)
    return cast(F32, _native.finished(flat, _three(background), linear)).reshape(*premultiplied.shape[:-1], 3)


def shrunk(colours: F32, size: int) -> F32:
    """A premultiplied picture (S, S, 4) in `size` rows: each pixel is the mean of its area."""
    if size == len(colours):
        return colours
    return cast(F32, _native.shrunk(_square(colours), size)).reshape(size, size, 4)


def ssim(a: F32, b: F32, shown: Bool, taps: F32) -> tuple[float, float]:
    """Structural similarity of luma (H, W): means over the pixels `shown` (H, W), of the whole and of its
    contrast-and-structure part. `taps` are the window's, from its middle outwards; no side is shorter than they are."""
    a, b = (np.ascontiguousarray(x, np.float32) for x in (a, b))
    if not a.shape == b.shape == shown.shape or min(a.shape) < len(taps):
        raise InvalidMesh(f"pictures of {a.shape} and {b.shape}, mask of {shown.shape}, {len(taps)} taps")
    return cast(tuple[float, float], _native.ssim(a, b, np.ascontiguousarray(shown, np.uint8), taps))


def seen_apart(a: F32, b: F32, height: int, background: Colour, linear: bool, noticed: float) -> tuple[int, int]:
    """How many pixels two premultiplied pictures (S, S, 4) cover, `height` pixels high, and how many of them differ by
    more than a move of a pixel and a change of `noticed`; see geometry.visible. `background` as in `finished`."""
    if a.shape != b.shape or height < 1:
        raise InvalidMesh(f"pictures of {a.shape} and {b.shape}, {height} pixels high")
    found = _native.seen_apart(_square(a), _square(b), height, _three(background), linear, noticed)
    return cast(tuple[int, int], found)


def flip(a: F32, b: F32, density: float) -> F32:
    """FLIP's errors (H, W) 0…1 of two pictures (H, W, 3) of sRGB values 0…1, at `density` pixels a degree."""
    a, b = (np.ascontiguousarray(x, np.float32) for x in (a, b))
    if a.shape != b.shape or a.ndim != 3 or a.shape[2] != 3 or not 1 <= density <= 1000:
        raise InvalidMesh(f"pictures of {a.shape} and {b.shape}, {density} pixels a degree")
    return cast(F32, _native.flip(a, b, density))


def blended(values: F32, corners: I32 | None, faces: I32, weights: F32) -> F32:
    """(N, K) float32 values at places on faces: those of the three rows of `values` (·, K) that `corners` (F, 3) says
    for each of `faces` (N,), weighted by `weights` (N, 3). None: face f has the rows 3f, 3f + 1 and 3f + 2."""
    if corners is not None:
        corners = _table(corners, np.int32, 3, "corners")
    faces = np.ascontiguousarray(faces, np.int32)
    _indices(faces, len(values) // 3 if corners is None else len(corners), "faces")
    weights = _table(np.ascontiguousarray(weights, np.float32), np.float32, 3, "weights")
    if len(weights) != len(faces):
        raise InvalidMesh(f"{len(faces)} faces and {len(weights)} weights")
    found = _native.blended(np.ascontiguousarray(values, np.float32), corners, faces, weights)
    if found is None:
        raise InvalidMesh(f"corners point outside their {len(values)} rows")
    return cast(F32, found)


def sampled(levels: Mips, meaning: F32, uv: F32, footprint: F32 | None, wrap: tuple[int, int], nearest: bool) -> F32:
    """(N, 4) float32 of a texture at `uv` (N, 2): trilinear between mip levels, bilinear within one.

    meaning    (256,) what a byte of a colour means; alpha is 0…1
    footprint  (N,) size of a pixel in texels of the finest level, None: 1
    wrap       glTF's numbers for u and v
    nearest    no blending between texels of a level
    """
    uv = _table(np.ascontiguousarray(uv, np.float32), np.float32, 2, "uv")
    if footprint is not None:
        footprint = _column(np.ascontiguousarray(footprint, np.float32), np.float32, len(uv), "footprint")
    return cast(F32, _native.sampled(*levels, meaning, uv, footprint, *wrap, nearest))


def _three(background: Colour) -> F32:
    return cast(F32, _column(np.array(background, np.float32), np.float32, 3, "background"))


def _square(colours: F32) -> F32:
    colours = np.ascontiguousarray(colours, np.float32)
    if colours.ndim != 3 or colours.shape[0] != colours.shape[1] or colours.shape[2] != 4 or not colours.size:
        raise InvalidMesh(f"a picture of {colours.shape}, not (S, S, 4)")
    return colours
