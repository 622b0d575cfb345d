"""Texture look-up as a GPU does it: transform, wrap, mip levels, trilinear filter."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from colorsys import hsv_to_rgb
from functools import cache

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.material import TextureRef
from lodpipe.core.mesh import F32, F64
from lodpipe.kernel import pictures

U8 = NDArray[np.uint8]

CLAMP, MIRROR, REPEAT = 33071, 33648, 10497
NEAREST = 9728
"""glTF's (OpenGL's) numbers of wrap and filter modes."""

LARGEST = 8192
"""No picture of a model shows more texels side by side; it bounds what a texture takes to 360 MB."""
STRIP = 256
"""Rows that are turned into floats at once, which bounds the memory that building mip levels takes."""


def to_linear(srgb: F64 | F32) -> F64:
    """Linear light 0…1 from sRGB values 0…1 (IEC 61966-2-1)."""
    value = np.asarray(srgb, np.float64)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def to_srgb(linear: F64 | F32) -> F32:
    """sRGB values 0…1 from linear light, clipped to 0…1 (IEC 61966-2-1)."""
    return pictures.to_srgb(np.asarray(linear, np.float32))


_LINEAR = to_linear(np.arange(256) / 255).astype(np.float32)
_PLAIN = (np.arange(256) / 255).astype(np.float32)


def uv_matrix(ref: TextureRef) -> F64:
    """The (2, 3) matrix of KHR_texture_transform: offset · rotation · scale, applied to (u, v, 1).

    v points down, so that a counter-clockwise turn takes u towards −v. Khronos' sample viewer and three.js read the
    extension so; the GLSL in its text turns the other way than its words.
    """
    c, s = np.cos(ref.rotation), np.sin(ref.rotation)
    (sx, sy), (ox, oy) = ref.scale, ref.offset
    return np.array([[c * sx, s * sy, ox], [-s * sx, c * sy, oy]])


class Texture:
    """An image with its mip levels.

    pixels   (H, W, C) uint8, C = 1 (grey), 2 (grey, alpha), 3 or 4
    srgb     whether grey and RGB are sRGB-encoded (base colour, emission) or plain numbers
    largest  texels along a side from which the image itself is left out, and its mip levels begin the texture
    """

    def __init__(self, pixels: U8, srgb: bool = True, largest: int = LARGEST) -> None:
        self.meaning = _LINEAR if srgb else _PLAIN
        self._srgb = srgb
        while max(pixels.shape[:2]) > largest:
            pixels = self._halved_bytes(pixels)
        levels = [_rgba(pixels)]
        smaller = self._halved(levels[0])
        while smaller is not None:
            levels.append(self._to_bytes(smaller))
            smaller = self._halved(smaller)
        self.height, self.width = levels[0].shape[:2]
        self.levels: pictures.Mips = (
            np.concatenate([level.reshape(-1, 4) for level in levels]),
            np.cumsum([0, *(level.shape[0] * level.shape[1] for level in levels[:-1])]),
            np.array([level.shape[1] for level in levels], np.int32),
            np.array([len(level) for level in levels], np.int32),
        )

    def sample(
        self, uv: F32, footprint: F32 | None = None, wrap: tuple[int, int] = (REPEAT, REPEAT), nearest: bool = False
    ) -> F32:
        """Linear RGBA (N, 4) float32 at `uv` (N, 2), v = 0 at the top.

        `footprint` (N,) is the size of a pixel in texels of the full image: it chooses the mip level; None or 1 and
        less is the full image. `wrap` holds the modes along u and v. `nearest`: no blending between texels.
        """
        return pictures.sampled(self.levels, self.meaning, uv, footprint, wrap, nearest)

    def _halved(self, image: U8 | F32) -> F32 | None:
        """Half as many rows and columns (rounded down), as linear floats; None for a single texel."""
        height, width = image.shape[:2]
        if height == width == 1:
            return None
        strips = []
        for top in range(0, max(height // 2, 1), STRIP):
            values = self._linear_image(image[2 * top : 2 * (top + STRIP) + 1])
            count = min(STRIP, max(height // 2, 1) - top)
            strips.append(_halve(_halve(values, 0, height, top, count), 1, width, 0, max(width // 2, 1)))
        return np.concatenate(strips)

    def _halved_bytes(self, pixels: U8) -> U8:
        """The same of a large image of any number of channels, as RGBA bytes: never all of it in floats."""
        height, width = (max(size // 2, 1) for size in pixels.shape[:2])
        result = np.empty((height, width, 4), np.uint8)
        for top in range(0, height, STRIP):
            values = self._linear_image(_rgba(pixels[2 * top : 2 * (top + STRIP) + 1]))
            count = min(STRIP, height - top)
            halved = _halve(_halve(values, 0, pixels.shape[0], top, count), 1, pixels.shape[1], 0, width)
            result[top : top + count] = self._to_bytes(halved)
        return result

    def _linear_image(self, image: U8 | F32) -> F32:
        """Linear floats of texels in either form."""
        if image.dtype == np.float32:
            return image.astype(np.float32, copy=False)
        texels = image.astype(np.uint8, copy=False)
        values = self.meaning[texels]
        values[..., 3] = _PLAIN[texels[..., 3]]
        return values

    def _to_bytes(self, image: F32) -> U8:
        colour = to_srgb(image[..., :3]) if self._srgb else image[..., :3]
        texels: U8 = np.rint(np.concatenate([colour, image[..., 3:]], axis=2) * 255).astype(np.uint8)
        return texels


class Textures:
    """Textures by image index, made when first used, and shared by all levels of an asset.

    pixels  decoded images by index, or a function that gives an index' pixels, None for an image that cannot be had;
            what it gives is not kept
    srgb    False takes base colours as plain numbers too, for lights that multiply stored values
    """

    def __init__(self, pixels: Mapping[int, U8] | Callable[[int], U8 | None] = lambda image: None, srgb: bool = True):
        self._pixels = pixels.get if isinstance(pixels, Mapping) else pixels
        self._srgb = srgb
        self._made: dict[tuple[int, bool], Texture | None] = {}

    def get(self, image: int | None, plain: bool = False) -> Texture | None:
        """The texture of an image, as data (a normal map) if `plain`; None if there is no such image."""
        if image is None:
            return None
        key = image, self._srgb and not plain
        if key not in self._made:
            pixels = self._pixels(image)
            self._made[key] = None if pixels is None else Texture(pixels, key[1])
        return self._made[key]


@cache
def chequer(cells: int = 16, texels: int = 64) -> Texture:
    """A chequer with a letter for each column and a number for each row: it shows stretch, turns and mirroring.

    Its hue runs along u and its lightness along v, so that a place can be told from its colour.
    """
    from PIL import Image, ImageDraw, ImageFont

    size = cells * texels
    picture = Image.new("RGB", (size, size))
    draw = ImageDraw.Draw(picture)
    font = ImageFont.load_default(texels * 0.45)
    for row in range(cells):
        for column in range(cells):
            light = 0.55 + 0.4 * row / cells
            value = light if (row + column) % 2 else 0.45 * light
            colour = tuple(round(255 * c) for c in hsv_to_rgb(column / cells, 0.55, value))
            left, top = column * texels, row * texels
            draw.rectangle((left, top, left + texels - 1, top + texels - 1), colour)
            middle = (left + texels // 2, top + texels // 2)
            draw.text(middle, f"{chr(65 + column)}{row + 1}", (255, 255, 255), font, anchor="mm")
    return Texture(np.array(picture))


def _rgba(pixels: U8) -> U8:
    if pixels.ndim != 3 or pixels.dtype != np.uint8 or not 1 <= pixels.shape[2] <= 4 or 0 in pixels.shape:
        raise ValueError(f"pixels must be (height, width, 1…4) uint8 (got {pixels.shape} {pixels.dtype})")
    channels = pixels.shape[2]
    rgba = np.full((*pixels.shape[:2], 4), 255, np.uint8)
    rgba[..., :3] = pixels[..., :3] if channels >= 3 else pixels[..., :1]
    if channels in (2, 4):
        rgba[..., 3] = pixels[..., -1]
    return rgba


def _halve(values: F32, axis: int, size: int, start: int, count: int) -> F32:
    """Rows (or columns) `start` … `start + count` of the next mip level of an image that is `size` long.

    `values` begins at row 2·start. An odd size takes three weighted rows for each, so that nothing shifts (Guthe &
    Heckbert 2005, "Non-power-of-two mipmap creation").
    """
    if size == 1:
        return values
    at = np.arange(count) * 2

    def row(offset: int) -> F32:
        return np.take(values, at + offset, axis=axis)

    if size % 2 == 0:
        return (row(0) + row(1)) * np.float32(0.5)
    half = size // 2
    shape = [1, 1, 1]
    shape[axis] = -1
    i = (np.arange(start, start + count, dtype=np.float32)).reshape(shape)
    result: F32 = (row(0) * (half - i) + row(1) * np.float32(half) + row(2) * (i + 1)) / np.float32(size)
    return result
