from __future__ import annotations

import io as streams
import struct
import zlib

import numpy as np
import PIL.Image
import pytest

import model_files as files
from lodpipe.core.errors import AssetError, LimitError
from lodpipe.core.material import Image
from lodpipe.io import Limits, decode_image
from lodpipe.io.images import encode_png, read_header, read_image


def saved(picture: PIL.Image.Image, kind: str, **options: object) -> bytes:
    out = streams.BytesIO()
    picture.save(out, kind, **options)  # type: ignore[arg-type]  # options of the format
    return out.getvalue()


@pytest.mark.parametrize(
    ("kind", "mode", "mime", "channels"),
    [
        ("PNG", "RGB", "image/png", 3),
        ("PNG", "LA", "image/png", 2),
        ("JPEG", "L", "image/jpeg", 1),
        ("JPEG", "RGB", "image/jpeg", 3),
        ("WEBP", "RGB", "image/webp", 0),
        ("WEBP", "RGBA", "image/webp", 0),
        ("BMP", "RGB", "image/bmp", 3),
        ("TGA", "RGB", "image/x-tga", 3),
        ("TIFF", "RGB", "image/tiff", 3),
        ("GIF", "L", "image/gif", 1),
    ],
)
def test_headers(kind: str, mode: str, mime: str, channels: int) -> None:
    header = read_header(files.image(7, 5, mode, kind))
    assert (header.mime_type, header.width, header.height, header.complete) == (mime, 7, 5, True)
    assert header.channels == channels
    pixels = decode_image(Image(files.image(7, 5, mode, kind)))
    assert pixels.shape[:2] == (5, 7) and pixels.dtype == np.uint8


def test_lossless_webp_and_progressive_jpeg() -> None:
    picture = PIL.Image.new("RGB", (300, 17))
    for data in (saved(picture, "WEBP", lossless=True), saved(picture, "JPEG", progressive=True)):
        header = read_header(data)
        assert (header.width, header.height) == (300, 17)


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP"])
def test_a_cut_image_is_noticed_without_decoding(kind: str) -> None:
    data = files.image(64, 64, "RGB", kind)
    for length in (12, len(data) // 3, len(data) - 3):
        with pytest.raises(AssetError):
            read_image(data[:length], Limits())
    assert read_image(data + b"more", Limits()).width == 64
    with pytest.raises(AssetError, match="not an image"):
        read_image(b"GIF? no, just text", Limits())


def bomb(width: int, height: int) -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(999))) + chunk(b"IEND", b"")


def test_pixel_bombs_are_refused_before_decoding() -> None:
    data = bomb(30000, 30000)
    with pytest.raises(LimitError, match="30000 × 30000 pixels"):
        read_image(data, Limits())
    with pytest.raises(LimitError, match="30000 × 30000 pixels"):
        decode_image(Image(data))
    with pytest.raises(AssetError, match="no pixels"):
        read_image(bomb(0, 5), Limits())


def test_our_limit_holds_and_not_pillows(monkeypatch: pytest.MonkeyPatch) -> None:
    data = files.png(40, 40)
    monkeypatch.setattr(PIL.Image, "MAX_IMAGE_PIXELS", 100)  # it would warn from here on, and raise from twice that
    assert decode_image(Image(data)).shape == (40, 40, 3)
    assert PIL.Image.MAX_IMAGE_PIXELS == 100, "what others rely on is put back"
    with pytest.raises(LimitError):
        decode_image(Image(data), Limits(texture_pixels=1000))


def test_kinds_of_pixels() -> None:
    ramp = np.linspace(0, 65535, 16).astype(np.uint16).reshape(4, 4)
    grey = decode_image(Image(saved(PIL.Image.fromarray(ramp), "PNG")))
    assert grey.shape == (4, 4, 1)
    assert np.array_equal(grey[:, :, 0], np.rint(ramp / 257).astype(np.uint8))
    palette = PIL.Image.new("P", (2, 1))
    palette.putpalette([255, 0, 0, 0, 0, 255])
    palette.putdata([0, 1])
    assert decode_image(Image(saved(palette, "PNG"))).tolist() == [[[255, 0, 0], [0, 0, 255]]]
    assert decode_image(Image(saved(palette, "PNG", transparency=0))).tolist() == [[[255, 0, 0, 0], [0, 0, 255, 255]]]
    cmyk = decode_image(Image(saved(PIL.Image.new("CMYK", (8, 8), (0, 255, 255, 0)), "JPEG", quality=100)))
    assert cmyk.shape == (8, 8, 3) and np.abs(cmyk[0, 0].astype(int) - (255, 0, 0)).max() < 8
    assert decode_image(Image(files.png(3, 2, "LA"))).shape == (2, 3, 4)
    rgba = np.random.default_rng(0).integers(0, 256, (3, 5, 4)).astype(np.uint8)
    assert np.array_equal(decode_image(Image(encode_png(rgba))), rgba)


def test_what_cannot_be_decoded_is_one_line() -> None:
    with pytest.raises(AssetError, match="lost"):
        decode_image(Image(problem="it is lost"))
    with pytest.raises(AssetError, match="KHR_texture_basisu"):
        decode_image(Image(b"\xabKTX 20\xbb\r\n\x1a\n" + struct.pack("<4I", 0, 1, 4, 4)))
    with pytest.raises(AssetError, match=r"x\.png cannot be decoded"):
        decode_image(Image(bomb(64, 64), uri="x.png"))
