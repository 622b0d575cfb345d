"""What a level takes on a graphics card, from what its file stores."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lodpipe.core.asset import Asset, GpuSize
from lodpipe.geometry.surface import image_index

SHORT = 65_535
"""Up to so many vertices in a primitive an index has two bytes; the number itself is the mark of a restart."""


def gpu_size(asset: Asset) -> GpuSize:
    """Bytes of vertex buffers, index buffers and textures, each mesh once however often it is placed.

    Positions and attributes as 32-bit floats, interleaved; indices of 2 bytes where they suffice, else 4. Textures
    as a renderer uploads PNG and JPEG: four bytes a texel, with all mip levels; KTX2 and DDS as one byte a texel
    (BC7, ASTC 4×4). Images that no material of a face uses are not counted.
    """
    vertices = indices = 0
    materials: set[int] = set()
    for mesh in asset.meshes:
        for number, primitive in enumerate(mesh.primitives):
            rows = mesh.face_primitive == number
            used = mesh.wedges if rows.all() else mesh.wedges[rows]
            if not len(used):
                continue
            mask = np.zeros(int(used.max()) + 1, bool)
            mask[used] = True
            wedges = int(np.count_nonzero(mask))
            width = 3 + sum(mesh.attributes[name].shape[1] for name in primitive.attributes if name in mesh.attributes)
            vertices += 4 * width * wedges
            indices += 3 * int(np.count_nonzero(rows)) * (2 if wedges <= SHORT else 4)
            if primitive.material is not None:
                materials.add(primitive.material)
    used = {image for row in materials for image in _images(asset.materials[row].gltf, asset.document)}
    return GpuSize(vertices, indices, sum(_texture_bytes(asset, image) for image in used))


def _images(tree: Any, document: Mapping[str, Any]) -> set[int]:
    """Images that a material's slots use."""
    found: set[int] = set()
    textures = document.get("textures", ())
    for key, value in tree.items() if isinstance(tree, Mapping) else ():
        if key.lower().endswith("texture") and isinstance(value, Mapping) and "index" in value:
            image = image_index(textures[value["index"]])
            found |= set() if image is None else {image}
        if key != "extras":
            found |= _images(value, document)
    return found


def _texture_bytes(asset: Asset, index: int) -> int:
    image = asset.images[index]
    width, height, total = image.width, image.height, 0
    texel = 1 if image.mime_type in ("image/ktx2", "image/vnd-ms.dds") else 4
    while width and height:
        total += texel * width * height
        width, height = (0, 0) if width == height == 1 else (max(width // 2, 1), max(height // 2, 1))
    return total
