"""Pictures side by side, with a line of text under each, as one PNG."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from lodpipe.geometry.texture import U8

GAP = 8
"""Pixels between pictures."""
TEXT = 15
"""Height of the letters in pixels."""


def contact_sheet(
    images: Sequence[U8],
    labels: Sequence[str] = (),
    columns: int | None = None,
    paper: tuple[int, int, int] = (255, 255, 255),
) -> U8:
    """`images` (H, W, 3 or 4) uint8 in a grid on `paper`, each over its label: (H', W', 3) uint8.

    Images may differ in size; `columns` None puts all into one row. Raises ValueError without images, or with
    labels of another number.
    """
    if not images or len(labels) not in (0, len(images)):
        raise ValueError(f"{len(images)} images and {len(labels)} labels")
    across = min(columns or len(images), len(images))
    height, width = max(len(image) for image in images), max(image.shape[1] for image in images)
    cell = width + GAP, height + GAP + (TEXT + GAP if labels else 0)
    down = -(-len(images) // across)
    sheet = Image.new("RGB", (across * cell[0] + GAP, down * cell[1] + GAP), paper)
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(TEXT)
    ink = (20, 20, 20) if sum(paper) > 382 else (235, 235, 235)
    for index, image in enumerate(images):
        left, top = GAP + index % across * cell[0], GAP + index // across * cell[1]
        picture = Image.fromarray(image)
        sheet.paste(picture, (left, top), picture if picture.mode == "RGBA" else None)
        if labels:
            draw.text((left + width // 2, top + height + GAP // 2), labels[index], ink, font, anchor="ma")
    return np.array(sheet)


def png_bytes(image: U8) -> bytes:
    """`image` (H, W, 3 or 4) uint8 as a PNG file's content; the same bytes for the same image."""
    target = io.BytesIO()
    Image.fromarray(image).save(target, "PNG", compress_level=5)
    return target.getvalue()
