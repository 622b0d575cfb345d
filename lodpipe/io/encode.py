"""Pixels into image files: PNG, JPEG, WebP, and KTX2 through a tool that the machine has."""

from __future__ import annotations

import io
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.errors import OutputError
from lodpipe.core.material import Image
from lodpipe.io.images import encode_png

Format = Literal["png", "jpeg", "webp", "ktx2"]
ENDINGS = {"png": ".png", "jpeg": ".jpg", "webp": ".webp", "ktx2": ".ktx2"}
KTX_TOOLS = ("toktx", "basisu")
"""Programs that make KTX2 files, the first that is there: of KTX-Software, of Basis Universal."""
SECONDS = 600


def encode_image(
    pixels: NDArray[np.uint8],
    name: str,
    kind: Format,
    *,
    quality: int = 90,
    exact: bool = False,
    srgb: bool = True,
    warn: Callable[[str], None] = lambda text: None,
) -> Image:
    """An image file of uint8 pixels (height, width, 3 or 4).

    `exact` (normal maps) and transparent pixels stay lossless: JPEG becomes PNG for them, WebP its lossless kind.
    `quality` 1…100 is JPEG's and WebP's. `srgb` tells KTX2 what the numbers mean. KTX2 without a tool becomes PNG, and
    `warn` is told. Raises OutputError when the tool fails.
    """
    height, width = pixels.shape[:2]
    if kind == "ktx2" and not any(shutil.which(tool) for tool in KTX_TOOLS):
        warn(f"KTX2 needs one of the programs {', '.join(KTX_TOOLS)}, and none is there; PNG is written")
        kind = "png"
    if kind == "jpeg" and (exact or pixels.shape[2] == 4):
        kind = "png"
    if kind == "png":
        data = encode_png(pixels)
    elif kind == "ktx2":
        data = _ktx2(pixels, srgb, exact)
    else:
        import PIL.Image

        out = io.BytesIO()
        if kind == "jpeg":
            PIL.Image.fromarray(pixels).save(out, "JPEG", quality=quality, subsampling=0)
        else:
            PIL.Image.fromarray(pixels).save(out, "WEBP", quality=quality, lossless=exact, exact=True)
        data = out.getvalue()
    return Image(data, f"image/{kind}", name, f"{name}{ENDINGS[kind]}", width, height)


def _ktx2(pixels: NDArray[np.uint8], srgb: bool, exact: bool) -> bytes:
    """UASTC for normal maps, ETC1S for the rest, both with mip levels (KHR_texture_basisu)."""
    tool = next(tool for tool in KTX_TOOLS if shutil.which(tool))
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder, "image.png"), Path(folder, "image.ktx2")
        source.write_bytes(encode_png(pixels))
        if tool == "toktx":
            codec = ["--encode", "uastc", "--zcmp", "18"] if exact else ["--encode", "etc1s", "--clevel", "2"]
            space = ["--assign_oetf", "srgb" if srgb else "linear"]
            command = [tool, "--t2", "--genmipmap", *codec, *space, str(target), str(source)]
        else:
            codec = ["-uastc"] if exact else []
            command = [tool, "-ktx2", "-mipmap", *codec, *([] if srgb else ["-linear"])]
            command += ["-output_file", str(target), str(source)]
        try:
            done = subprocess.run(command, capture_output=True, timeout=SECONDS, check=False)
        except subprocess.TimeoutExpired as error:
            raise OutputError(f"{tool} took more than {SECONDS} s", advice="write PNG or WebP") from error
        if done.returncode or not target.exists():
            said = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
            raise OutputError(f"{tool} failed ({said[0] if said else done.returncode})", advice="write PNG or WebP")
        return target.read_bytes()
