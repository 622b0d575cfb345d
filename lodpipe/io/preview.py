"""Small glTF previews in memory: what a page can hold and any viewer shows without a decoder."""

from __future__ import annotations

import copy
import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.asset import Asset
from lodpipe.core.material import Image
from lodpipe.core.mesh import F32, F64, I32, Mesh
from lodpipe.io.clean import Warn
from lodpipe.io.gltf_write import gltf_files
from lodpipe.io.pack import INDICES, VERTICES, Packer

SMALL = 200_000
"""Bytes up to which an image file is taken as it is, if its size fits."""
QUALITY = 86
"""Of JPEG and WebP."""
STEPS = {"NORMAL": 127.0, "COLOR_0": 255.0}
FINE = 16384.0
"""Values are rounded to these parts of 1 (positions: of about the mesh's extent), which makes them easy to compress."""
LIGHTS = "KHR_lights_punctual"


class Previews:
    """Previews of an asset's levels, with their centre at the origin and a radius of 1; images are shared.

    centre  (3,) world coordinates of what becomes the origin
    radius  > 0, what becomes 1
    """

    def __init__(self, centre: F64, radius: float) -> None:
        self.centre, self.radius = centre, radius
        self.files: dict[str, bytes] = {}

    def add(self, name: str, asset: Asset) -> str:
        """Put `asset` (at a level, with small images) into `files`; returns the name of its glTF."""
        shown = replace(
            asset,
            meshes=tuple(_rounded(mesh) for mesh in asset.meshes),
            document=_at_origin(asset, self.centre, self.radius),
            lods=(),
        )
        quiet: Warn = lambda text: None  # noqa: E731 what cannot be kept has been said by `export`
        written = gltf_files(shown, Path(f"{name}.gltf"), [shown.meshes], (), quiet)
        tree = json.loads(written[0][1])
        renamed = {file: self._keep(file, data) for file, data in written[1:]}
        for entry in (*tree.get("buffers", ()), *tree.get("images", ())):
            if "uri" in entry:
                entry["uri"] = renamed[unquote(entry["uri"])]
        return self._tree(name, tree)

    def add_coloured(self, name: str, positions: F64, faces: I32, colours: NDArray[np.uint8]) -> str:
        """Put a surface with linear RGB `colours` (V, 3) uint8 into `files`; several of the same shape share it."""
        points = _round((positions - self.centre) / self.radius, FINE)
        shape, paint = Packer(), Packer()
        kind = np.uint16 if len(points) < 65535 else np.uint32
        index = shape.accessor(faces.reshape(-1, 1).astype(kind), "SCALAR", target=INDICES)
        position = shape.accessor(points, "VEC3", target=VERTICES, bounds=True)
        rgba = np.column_stack([colours, np.full(len(colours), 255, np.uint8)])
        colour = paint.accessor(rgba, "VEC4", normalized=True, target=VERTICES) + len(shape.accessors)
        for row, view in enumerate(paint.views):
            view["buffer"] = 1
            paint.accessors[row]["bufferView"] += len(shape.views)
        buffers = [
            {"uri": self._keep(f"{name}_{part}.bin", data), "byteLength": len(data)}
            for part, data in (("shape", shape.data), ("colours", paint.data))
        ]
        attributes = {"POSITION": position, "COLOR_0": colour}
        material = {"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.9}, "doubleSided": True}
        tree = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": attributes, "indices": index, "material": 0}]}],
            "materials": [material],
            "accessors": [*shape.accessors, *paint.accessors],
            "bufferViews": [*shape.views, *paint.views],
            "buffers": buffers,
        }
        return self._tree(name, tree)

    def _tree(self, name: str, tree: dict[str, Any]) -> str:
        self.files[f"{name}.gltf"] = json.dumps(tree, separators=(",", ":")).encode()
        return f"{name}.gltf"

    def _keep(self, file: str, data: bytes) -> str:
        """The name under which `files` has `data`; the same content is there once."""
        name = f"{hashlib.blake2b(data, digest_size=8).hexdigest()}{Path(file).suffix}"
        self.files.setdefault(name, data)
        return name


def _at_origin(asset: Asset, centre: F64, radius: float) -> dict[str, Any]:
    """The document without cameras, lights and animations, the whole scene moved and scaled by a node of its own."""
    tree = copy.deepcopy(dict(asset.document))
    for key in ("animations", "cameras"):
        tree.pop(key, None)
    tree.get("extensions", {}).pop(LIGHTS, None)
    nodes = tree.setdefault("nodes", [{"mesh": i} for i in range(len(asset.meshes))])
    for node in nodes:
        node.pop("camera", None)
        node.get("extensions", {}).pop(LIGHTS, None)
    scenes = tree.setdefault("scenes", [{"nodes": list(range(len(nodes)))}])
    scene = scenes[tree.get("scene", 0)]
    scale = 1.0 / radius
    nodes.append({"children": scene.get("nodes", []), "scale": [scale] * 3, "translation": (-centre * scale).tolist()})
    tree["scenes"], tree["scene"] = [{"nodes": [len(nodes) - 1]}], 0
    return tree


def _rounded(mesh: Mesh) -> Mesh:
    """`mesh` with values that compress well, and without tangents, which a viewer makes itself."""
    extent = float(np.ptp(mesh.positions, axis=0).max()) if len(mesh.positions) else 0.0
    steps = FINE / 2.0 ** np.floor(np.log2(extent)) if extent > 0 else FINE
    attributes = {
        name: _round(values, STEPS.get(name, FINE)) for name, values in mesh.attributes.items() if name != "TANGENT"
    }
    kept = tuple(replace(p, attributes=tuple(a for a in p.attributes if a != "TANGENT")) for p in mesh.primitives)
    positions = np.rint(mesh.positions * steps) / steps if np.isfinite(steps) else mesh.positions
    return replace(mesh, positions=positions, attributes=attributes, primitives=kept)


def _round(values: F32 | F64, steps: float) -> F32:
    rounded: F32 = (np.rint(np.asarray(values, np.float64) * steps) / steps).astype(np.float32)
    return rounded


def shrunk(image: Image, pixels: NDArray[np.uint8], size: int) -> Image:
    """`image`, whose pixels are given, at most `size` pixels wide and high: a JPEG, or a WebP if it is transparent."""
    import io

    import PIL.Image

    height, width = pixels.shape[:2]
    if max(height, width) <= size and len(image.data) <= SMALL and image.mime_type in ("image/png", "image/jpeg"):
        return image
    opaque = pixels.shape[2] != 4 or bool((pixels[..., 3] == 255).all())
    shown = pixels[..., 0] if pixels.shape[2] == 1 else pixels[..., :3] if opaque else pixels
    picture = PIL.Image.fromarray(np.ascontiguousarray(shown))
    picture.thumbnail((size, size), PIL.Image.Resampling.BOX, reducing_gap=None)
    out = io.BytesIO()
    if opaque:
        picture.save(out, "JPEG", quality=QUALITY, subsampling=0)
    else:
        picture.save(out, "WEBP", quality=QUALITY, method=2)
    kind, ending = ("image/jpeg", "jpg") if opaque else ("image/webp", "webp")
    stem = image.uri.rpartition(".")[0] or image.uri
    name = f"{stem}.{ending}" if image.uri else ""
    return replace(image, data=out.getvalue(), mime_type=kind, uri=name, width=picture.width, height=picture.height)
