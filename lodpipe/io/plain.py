"""What PLY, STL and OFF have in common: one mesh, at most one texture, no node tree."""

from __future__ import annotations

from pathlib import Path

from lodpipe.core.asset import Asset
from lodpipe.core.material import Image, Material
from lodpipe.core.mesh import Mesh
from lodpipe.io.paths import stem


def single_mesh(path: Path, mesh: Mesh, image: Image | None = None) -> Asset:
    """An asset of one mesh; with an image, its material has it as base colour."""
    materials: tuple[Material, ...] = ()
    document = {"scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, "name": stem(path)}]}
    if image is not None:
        pbr = {"baseColorTexture": {"index": 0}, "metallicFactor": 0.0}
        materials = (Material({"name": Path(image.uri).stem, "pbrMetallicRoughness": pbr}),)
        document["textures"] = [{"source": 0}]
    return Asset(stem(path), (mesh,), materials, () if image is None else (image,), document)
