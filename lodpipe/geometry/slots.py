"""The texture slots of a glTF material: which there are, what they hold, and how they are read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lodpipe.core.asset import Asset
from lodpipe.core.material import Material, TextureRef, texture_ref
from lodpipe.core.mesh import F32, F64
from lodpipe.geometry.fill import spread_colour
from lodpipe.geometry.surface import image_index
from lodpipe.geometry.texture import NEAREST, REPEAT, U8, Texture, uv_matrix

Path = tuple[str, ...]

BASE_COLOR: Path = ("pbrMetallicRoughness", "baseColorTexture")
METALLIC_ROUGHNESS: Path = ("pbrMetallicRoughness", "metallicRoughnessTexture")
NORMAL: Path = ("normalTexture",)
OCCLUSION: Path = ("occlusionTexture",)
EMISSIVE: Path = ("emissiveTexture",)

MAPS: dict[str, Path] = {
    "base_color": BASE_COLOR,
    "normal": NORMAL,
    "metallic_roughness": METALLIC_ROUGHNESS,
    "occlusion": OCCLUSION,
    "emissive": EMISSIVE,
}
"""The maps of glTF's core; an extension's are named by their slot: sheenColorTexture, …"""


def map_name(path: Path) -> str:
    """What users call the map in a slot."""
    return next((name for name, known in MAPS.items() if known == path), path[-1])


def is_colour(path: Path) -> bool:
    """Whether the slot's RGB are sRGB-encoded (glTF 2.0, and its extensions: names that end in ColorTexture …)."""
    return path[-1] in ("emissiveTexture", "diffuseTexture", "specularGlossinessTexture") or path[-1].endswith(
        "ColorTexture"
    )


def is_normal(path: Path) -> bool:
    """Whether the slot holds directions in tangent space."""
    return path[-1].lower().endswith("normaltexture")


def slots(material: Material) -> dict[Path, Mapping[str, Any]]:
    """Path -> textureInfo of every texture that the material names, its extensions' included."""
    return dict(_slots(material.gltf, ()))


def _slots(tree: Mapping[str, Any], path: Path) -> Iterator[tuple[Path, Mapping[str, Any]]]:
    for key, value in tree.items():
        if key == "extras" or not isinstance(value, Mapping):
            continue
        if key.lower().endswith("texture") and isinstance(value.get("index"), int):
            yield (*path, key), value
        else:
            yield from _slots(value, (*path, key))


@dataclass(frozen=True, eq=False)
class Slot:
    """A texture as one slot of one material reads it."""

    ref: TextureRef
    texture: Texture
    wrap: tuple[int, int]
    nearest: bool
    strength: float
    """The normal map's scale."""
    is_normal: bool = False

    @property
    def uv_name(self) -> str:
        """The UV set that it is read with."""
        return f"TEXCOORD_{self.ref.texcoord}"

    def place(self, uv: F64) -> F64:
        """`uv` (…, 2) of the set under the slot's KHR_texture_transform."""
        matrix = uv_matrix(self.ref)
        return uv @ matrix[:, :2].T + matrix[:, 2]

    def sample(self, uv: F64, footprint: F32) -> F32:
        """Linear RGBA (N, 4) at `uv` (N, 2), which `place` has moved; `footprint` (N,) in texels."""
        return self.texture.sample(uv.astype(np.float32), footprint, self.wrap, self.nearest)


class SlotTextures:
    """Textures of an asset's slots, each made when first used; `pixels` holds the decoded images by their rows."""

    def __init__(self, asset: Asset, pixels: Mapping[int, U8]) -> None:
        self._asset, self._pixels = asset, pixels
        self._made: dict[tuple[int, bool, bool], Texture] = {}

    def slot(self, path: Path, info: Mapping[str, Any], spread: bool = False) -> Slot | None:
        """The slot's texture; None where its image is not there. With `spread` texels that cannot be seen (alpha 0)
        take the colour of what is near, which mip levels and filters then mix in."""
        ref = texture_ref(info)
        assert ref is not None  # there is an info
        said = self._asset.document["textures"][ref.texture]
        image = image_index(said)
        if image is None or image not in self._pixels:
            return None
        pixels = self._pixels[image]
        key = image, is_colour(path), spread and pixels.shape[2] == 4
        if key not in self._made:
            if key[2]:
                pixels = pixels.copy()
                spread_colour(pixels)
            self._made[key] = Texture(pixels, srgb=is_colour(path))
        sampler = self._asset.document["samplers"][said["sampler"]] if "sampler" in said else {}
        wrap = sampler.get("wrapS", REPEAT), sampler.get("wrapT", REPEAT)
        nearest = sampler.get("magFilter") == NEAREST
        return Slot(ref, self._made[key], wrap, nearest, float(info.get("scale", 1.0)), is_normal(path))
