"""From arrays with values at the corners of faces to assets, and the pictures that show distortion."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Picture
from PIL import ImageDraw, ImageFont

from implicit import F64
from lodpipe.core.asset import Asset
from lodpipe.core.material import Image, Material
from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.geometry.normals import crease_normals

U8 = NDArray[np.uint8]
Ints = NDArray[np.integer[Any]]

COLOURS = [(214, 73, 51), (59, 112, 189), (245, 193, 66), (74, 153, 94), (139, 84, 160), (240, 240, 235)]
REPEAT, MIRROR = 10497, 33648


@dataclass(frozen=True)
class Part:
    """What one material covers: faces (F, 3), UV (F, 3, 2) with v = 0 at the top, and the texture's wrap mode."""

    faces: Ints
    uv: F64
    texture: U8
    name: str
    wrap: int = REPEAT


def asset(name: str, positions: F64, parts: Sequence[Part], crease: float = 40.0) -> Asset:
    """An asset of one mesh with a primitive, a material and a texture for each part, and smooth normals."""
    faces = np.concatenate([part.faces for part in parts]).astype(np.int32)
    normals = crease_normals(positions, faces, crease)
    corners = np.concatenate([np.concatenate([part.uv for part in parts]), normals], axis=2).astype(np.float32)
    owner = np.repeat(np.arange(len(parts)), [len(part.faces) for part in parts]).astype(np.int32)
    keys = np.column_stack([faces.ravel(), np.repeat(owner, 3), corners.reshape(-1, 5)])
    _, first, wedges = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    values = corners.reshape(-1, 5)[first]
    attributes = ("TEXCOORD_0", "NORMAL")
    mesh = Mesh(
        positions,
        faces,
        wedges.reshape(-1, 3).astype(np.int32),
        {"TEXCOORD_0": values[:, :2], "NORMAL": values[:, 2:]},
        owner,
        tuple(Primitive(material=i, attributes=attributes) for i in range(len(parts))),
        name=name,
    )
    return Asset(
        name,
        (mesh,),
        tuple(
            Material(
                {
                    "name": part.name,
                    "pbrMetallicRoughness": {"baseColorTexture": {"index": i}, "metallicFactor": 0},
                }
            )
            for i, part in enumerate(parts)
        ),
        tuple(
            Image(png(part.texture), name=part.name, width=part.texture.shape[1], height=part.texture.shape[0])
            for part in parts
        ),
        document={
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"name": name, "mesh": 0}],
            "textures": [{"source": i, "sampler": i} for i in range(len(parts))],
            "samplers": [{"wrapS": part.wrap, "wrapT": part.wrap} for part in parts],
        },
        format="glb",
    )


def png(texture: U8) -> bytes:
    """The texture (H, W, 3) as a PNG file."""
    target = io.BytesIO()
    Picture.fromarray(texture).save(target, "PNG")
    return target.getvalue()


def board(columns: int, rows: int, cell: int = 64, first: int = 0, tint: int = 0) -> U8:
    """A texture of numbered squares in changing colours, each with finer checks and a border."""
    picture = Picture.new("RGB", (columns * cell, rows * cell))
    draw = ImageDraw.Draw(picture)
    font = ImageFont.load_default(cell * 0.4)
    for row in range(rows):
        for column in range(columns):
            x, y = column * cell, row * cell
            base = COLOURS[(column + 2 * row + tint) % len(COLOURS)]
            dark = (int(base[0] * 0.8), int(base[1] * 0.8), int(base[2] * 0.8))
            small = cell // 8
            for i in range(8):
                for j in range(8):
                    at = (x + i * small, y + j * small)
                    draw.rectangle((*at, at[0] + small - 1, at[1] + small - 1), base if (i + j) % 2 else dark)
            draw.rectangle((x, y, x + cell - 1, y + cell - 1), outline=(30, 30, 30))
            draw.text(
                (x + cell / 2, y + cell / 2), str(first + row * columns + column), (20, 20, 20), font, anchor="mm"
            )
    return np.asarray(picture)


def label(texture: U8, places: F64, texts: Sequence[str], height: int) -> U8:
    """The texture with `texts` written about `places` (N, 2), in texels from the upper left corner."""
    picture = Picture.fromarray(texture)
    draw = ImageDraw.Draw(picture)
    font = ImageFont.load_default(height)
    for (x, y), text in zip(places, texts, strict=True):
        draw.text((x, y), text, (20, 20, 20), font, anchor="mm", stroke_width=2, stroke_fill=(250, 250, 250))
    return np.asarray(picture)
