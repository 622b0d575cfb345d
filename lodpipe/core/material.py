"""Materials and images. The glTF material object is the truth; the properties are views of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Image:
    """An image file as it came (PNG, JPEG, WebP, …): bytes, so that it is written back unchanged.

    `uri` is the file name that it had beside the asset, empty when it was embedded. `width` and `height` are in
    pixels. `data` is empty when the file was missing, unsafe or unreadable: `problem` says why, and the
    material's factor colour stands in for it.
    """

    data: bytes = b""
    mime_type: str = "image/png"
    name: str = ""
    uri: str = ""
    width: int = 0
    height: int = 0
    problem: str = ""


@dataclass(frozen=True)
class TextureRef:
    """A material's use of a texture: which one, by which UV set, with which transform (KHR_texture_transform)."""

    texture: int
    texcoord: int = 0
    offset: tuple[float, float] = (0.0, 0.0)
    scale: tuple[float, float] = (1.0, 1.0)
    rotation: float = 0.0
    """Radians, counter-clockwise in UV space about the origin."""


@dataclass(frozen=True)
class Material:
    """A glTF 2.0 material, complete with its extensions and extras.

    Texture indices in it are rows of ``Asset.document["textures"]``.
    """

    gltf: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The material's name, empty if it has none."""
        return str(self.gltf.get("name", ""))

    @property
    def _pbr(self) -> Mapping[str, Any]:
        value: Mapping[str, Any] = self.gltf.get("pbrMetallicRoughness", {})
        return value

    @property
    def base_color_factor(self) -> tuple[float, float, float, float]:
        """Linear RGBA, each 0…1."""
        r, g, b, a = self._pbr.get("baseColorFactor", (1.0, 1.0, 1.0, 1.0))
        return float(r), float(g), float(b), float(a)

    @property
    def base_color_texture(self) -> TextureRef | None:
        """Base colour (sRGB) and alpha."""
        return texture_ref(self._pbr.get("baseColorTexture"))

    @property
    def normal_texture(self) -> TextureRef | None:
        """Tangent-space normal map."""
        return texture_ref(self.gltf.get("normalTexture"))

    @property
    def alpha_mode(self) -> str:
        """OPAQUE, MASK or BLEND."""
        return str(self.gltf.get("alphaMode", "OPAQUE"))

    @property
    def alpha_cutoff(self) -> float:
        """The alpha below which a MASK material is not drawn, 0…1."""
        return float(self.gltf.get("alphaCutoff", 0.5))

    @property
    def double_sided(self) -> bool:
        """Whether back faces are drawn."""
        return bool(self.gltf.get("doubleSided", False))


@dataclass(frozen=True)
class MaterialSet:
    """Materials with all that they name: rows of `textures` are their textures, whose sources are rows of `images`
    and whose samplers rows of `samplers`; both are glTF objects."""

    materials: tuple[Material, ...]
    images: tuple[Image, ...] = ()
    textures: tuple[Mapping[str, Any], ...] = ()
    samplers: tuple[Mapping[str, Any], ...] = ()


def renumbered(tree: Any, shift: Mapping[str, int]) -> Any:
    """A copy of a glTF object in which references are moved on: `shift` has how far by their kind.

    Kinds: ``texture`` (the index of a slot such as baseColorTexture), ``source`` and ``sampler`` (of a texture).
    `extras` are not looked into.
    """
    if isinstance(tree, list | tuple):
        return [renumbered(item, shift) for item in tree]
    if not isinstance(tree, Mapping):
        return tree
    result: dict[str, Any] = {}
    for key, value in tree.items():
        if key in ("source", "sampler") and isinstance(value, int):
            result[key] = value + shift.get(key, 0)
        elif key.lower().endswith("texture") and isinstance(value, Mapping) and isinstance(value.get("index"), int):
            result[key] = {**renumbered(value, shift), "index": value["index"] + shift.get("texture", 0)}
        else:
            result[key] = value if key == "extras" else renumbered(value, shift)
    return result


def texture_ref(info: Mapping[str, Any] | None) -> TextureRef | None:
    """The glTF textureInfo object `info` as a TextureRef, None for None."""
    if info is None:
        return None
    extensions: Mapping[str, Any] = info.get("extensions", {})
    transform: Mapping[str, Any] = extensions.get("KHR_texture_transform", {})
    offset = transform.get("offset", (0.0, 0.0))
    scale = transform.get("scale", (1.0, 1.0))
    return TextureRef(
        texture=int(info["index"]),
        texcoord=int(transform.get("texCoord", info.get("texCoord", 0))),
        offset=(float(offset[0]), float(offset[1])),
        scale=(float(scale[0]), float(scale[1])),
        rotation=float(transform.get("rotation", 0.0)),
    )
