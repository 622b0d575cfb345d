"""Image files: what their header says, and their pixels under a limit."""

from __future__ import annotations

import io
import struct
import threading
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.errors import AssetError, LimitError
from lodpipe.core.material import Image
from lodpipe.io.limits import DEFAULT, Limits
from lodpipe.io.paths import Folder, shorten

#: Formats that glTF allows, by extension for the last four; every other one is turned into PNG when a glTF is written.
GLTF_TYPES = {
    "image/png": ".png",
    "image/jpeg": ".jpg",
    "image/webp": ".webp",
    "image/ktx2": ".ktx2",
    "image/vnd-ms.dds": ".dds",
    "image/avif": ".avif",
}
_OTHER_TYPES = {"BMP": "image/bmp", "TGA": "image/x-tga", "TIFF": "image/tiff", "GIF": "image/gif", "PSD": "image/psd"}
if TYPE_CHECKING:  # Pillow is imported where it is needed: it costs 50 ms
    from PIL.Image import Image as Picture

_PNG = b"\x89PNG\r\n\x1a\n"
_KTX2 = b"\xabKTX 20\xbb\r\n\x1a\n"
_PIXEL_GUARD = threading.Lock()


@dataclass(frozen=True)
class Header:
    """What an image file says of itself before its pixels."""

    mime_type: str
    width: int
    height: int
    channels: int = 0
    """Colour channels with alpha; 0: not known without decoding."""
    complete: bool = True
    """False when the end of the file is missing."""


def read_header(data: bytes) -> Header:
    """Format and size of an image file, without decoding it. Raises AssetError for what is not an image."""
    try:
        if data.startswith(_PNG):
            return _png(data)
        if data.startswith(b"\xff\xd8\xff"):
            return _jpeg(data)
        if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
            return _webp(data)
        if data.startswith(_KTX2):
            width, height = struct.unpack_from("<II", data, 20)
            return Header("image/ktx2", width, max(height, 1))
        if data.startswith(b"DDS "):
            height, width = struct.unpack_from("<II", data, 12)
            return Header("image/vnd-ms.dds", width, height)
    except (struct.error, IndexError) as error:
        raise AssetError("the image is cut off in its header") from error
    return _other(data)


def read_image(data: bytes, limits: Limits, *, name: str = "", uri: str = "") -> Image:
    """An Image of the file's bytes. Raises LimitError for too many pixels, AssetError for what is no whole image."""
    header = read_header(data)
    if header.width <= 0 or header.height <= 0:
        raise AssetError("the image has no pixels")
    check_pixels(header.width, header.height, limits)
    if not header.complete:
        raise AssetError("the image is cut off: its end is missing")
    return Image(data, header.mime_type, name, uri, header.width, header.height)


def find_image(folder: Folder, name: str, *, uri: bool = False) -> Image:
    """The image file that the asset calls `name`; one that is missing, unsafe or broken becomes `Image.problem`.

    Raises LimitError for an image of too many pixels.
    """
    base = (unquote(name) if uri else name).replace("\\", "/").rpartition("/")[2]
    try:
        data = folder.read_uri(name) if uri else folder.read(name)
        return read_image(data, folder.limits, uri=base)
    except AssetError as error:
        own = f"{shorten(base)} "
        cause = error.cause if error.cause.startswith(own) else f"{shorten(base)}: {error.cause}"
        return Image(uri=base, problem=f"image {cause}")
    except LimitError as error:
        raise error.at(base) from error


def check_pixels(width: int, height: int, limits: Limits) -> None:
    """Raise LimitError if an image of that size is over the limit."""
    if width * height > limits.texture_pixels:
        raise LimitError(
            f"the image has {width} × {height} pixels, more than the limit of {limits.texture_pixels:,}",
            advice="make the image smaller, or raise limits.texture_pixels",
        )


def decode_image(image: Image, limits: Limits = DEFAULT) -> NDArray[np.uint8]:
    """The pixels as uint8 of shape (height, width, channels): 1 grey, 3 RGB or 4 RGBA, top row first.

    Values are as stored (sRGB or data, as the material slot says); 16-bit channels are reduced to 8, a palette and
    CMYK become RGB or RGBA. An orientation tag is ignored, as glTF asks. Raises AssetError for an image that is
    missing, broken or of a format without a decoder (KTX2), LimitError before decoding when it has too many pixels.
    """
    label = image.uri or image.name or "image"
    if not image.data:
        raise AssetError(image.problem or f"{label} has no data")
    header = read_header(image.data)
    try:
        check_pixels(header.width, header.height, limits)
    except LimitError as error:
        raise error.at(label) from error
    if header.mime_type == "image/ktx2":
        raise AssetError(
            f"{label}: KTX2 textures (KHR_texture_basisu) are carried along but cannot be decoded",
            advice="store the texture as PNG, JPEG or WebP where its pixels are needed",
        )
    import PIL.Image

    try:
        with _PIXEL_GUARD, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            pillows_limit, PIL.Image.MAX_IMAGE_PIXELS = PIL.Image.MAX_IMAGE_PIXELS, None  # ours has been checked
            try:
                with PIL.Image.open(io.BytesIO(image.data)) as picture:
                    return _pixels(picture)
            finally:
                PIL.Image.MAX_IMAGE_PIXELS = pillows_limit
    except (OSError, ValueError, SyntaxError, EOFError, MemoryError) as error:
        raise AssetError(f"{label} cannot be decoded ({error})", advice="save the image again") from error


def encode_png(pixels: NDArray[np.uint8]) -> bytes:
    """A PNG file of uint8 pixels (height, width, 1, 3 or 4)."""
    import PIL.Image

    out = io.BytesIO()
    shaped = pixels[:, :, 0] if pixels.shape[2] == 1 else pixels
    PIL.Image.fromarray(shaped).save(out, "PNG")
    return out.getvalue()


def _pixels(picture: Picture) -> NDArray[np.uint8]:
    if picture.mode.startswith(("I", "F")):  # one channel of 16 or 32 bits
        values = np.asarray(picture).astype(np.float64)
        top = 65535.0 if picture.mode.startswith("I") else 1.0
        grey: NDArray[np.uint8] = np.rint(np.clip(values / top, 0, 1) * 255).astype(np.uint8)[:, :, None]
        return grey
    transparent = picture.mode in ("LA", "PA", "RGBa", "La") or "transparency" in picture.info
    target = "RGBA" if transparent or picture.mode == "RGBA" else "L" if picture.mode in ("L", "1") else "RGB"
    array = np.asarray(picture if picture.mode == target else picture.convert(target))
    return np.ascontiguousarray(array if array.ndim == 3 else array[:, :, None])


def _png(data: bytes) -> Header:
    width, height, _, colour = struct.unpack_from(">IIBB", data, 16)
    channels = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}.get(colour, 0)
    offset, complete = len(_PNG), False
    while offset + 8 <= len(data) and not complete:
        length, kind = struct.unpack_from(">I4s", data, offset)
        offset += 12 + length
        complete = kind == b"IEND"
    return Header("image/png", width, height, channels, complete and offset <= len(data))


def _jpeg(data: bytes) -> Header:
    offset = 2
    while True:
        while data[offset] == 0xFF and data[offset + 1] == 0xFF:
            offset += 1  # fill bytes
        marker = data[offset + 1]
        if data[offset] != 0xFF or marker in (0xD9, 0xDA):
            raise AssetError("the JPEG has no frame header")
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width, channels = struct.unpack_from(">HHB", data, offset + 5)
            return Header("image/jpeg", width, height, channels, data.rfind(b"\xff\xd9") > offset)
        offset += 2 + struct.unpack_from(">H", data, offset + 2)[0]


def _webp(data: bytes) -> Header:
    kind = data[12:16]
    complete = len(data) >= 8 + struct.unpack_from("<I", data, 4)[0]
    if kind == b"VP8X":
        width = 1 + int.from_bytes(data[24:27], "little")
        height = 1 + int.from_bytes(data[27:30], "little")
    elif kind == b"VP8L":
        bits = struct.unpack_from("<I", data, 21)[0]
        width, height = 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    else:
        width, height = (v & 0x3FFF for v in struct.unpack_from("<HH", data, 26))
    return Header("image/webp", width, height, 0, complete)


def _other(data: bytes) -> Header:
    """Formats that only OBJ and PLY files name (BMP, TGA, TIFF, GIF …): Pillow reads the header."""
    import PIL.Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with PIL.Image.open(io.BytesIO(data)) as picture:
                mime = _OTHER_TYPES.get(picture.format or "", f"image/{(picture.format or 'unknown').lower()}")
                return Header(mime, picture.width, picture.height, len(picture.getbands()))
    except PIL.Image.DecompressionBombError as error:
        raise LimitError("the image has more pixels than any texture", advice="make the image smaller") from error
    except (OSError, ValueError, SyntaxError) as error:
        raise AssetError("it is not an image that can be read") from error
