"""Tiny files for the tests: glTFs put together from arrays, images, and a model that has a bit of everything."""

from __future__ import annotations

import base64
import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image

Json = dict[str, Any]
CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
SQUARE_UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
SQUARE_FACES = np.array([0, 1, 2, 0, 2, 3], np.uint16)
UP = np.array([[0, 0, 1]] * 4, np.float32)


def png(width: int = 2, height: int = 2, mode: str = "RGB") -> bytes:
    """A small PNG whose pixels differ."""
    return image(width, height, mode, "PNG")


def image(width: int, height: int, mode: str, kind: str) -> bytes:
    out = io.BytesIO()
    PIL.Image.radial_gradient("L").resize((width, height)).convert(mode).save(out, kind)
    return out.getvalue()


class Gltf:
    """A glTF under construction: `tree` is its JSON, arrays are added to one buffer."""

    def __init__(self) -> None:
        self.data = b""
        self.tree: Json = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}]}
        self.tree.update(meshes=[], accessors=[], bufferViews=[])

    def view(self, raw: bytes, **more: Any) -> int:
        self.data += bytes(-len(self.data) % 4)
        self.tree["bufferViews"].append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(raw), **more})
        self.data += raw
        return len(self.tree["bufferViews"]) - 1

    def array(self, values: Any, **more: Any) -> int:
        """An accessor for `values` (N,) or (N, K); its row."""
        values = np.asarray(values)
        columns = values.reshape(len(values), -1)
        said = {"componentType": CODES[values.dtype.str[1:]], "count": len(values), "type": TYPES[columns.shape[1]]}
        if values.dtype == np.float32 and np.isfinite(columns).all():
            said |= {"min": columns.min(0).tolist(), "max": columns.max(0).tolist()}
        self.tree["accessors"].append({"bufferView": self.view(columns.tobytes()), **said, **more})
        return len(self.tree["accessors"]) - 1

    def mesh(self, *primitives: Json, **more: Any) -> int:
        self.tree["meshes"].append({"primitives": list(primitives), **more})
        return len(self.tree["meshes"]) - 1

    def square(self, **more: Any) -> Json:
        """A primitive: two triangles with normals and UVs."""
        attributes = {"POSITION": self.array(SQUARE), "NORMAL": self.array(UP), "TEXCOORD_0": self.array(SQUARE_UV)}
        return {"attributes": attributes, "indices": self.array(SQUARE_FACES), **more}

    def save(self, path: Path) -> Path:
        """Write it as .glb, or as .gltf with the buffer inside."""
        if path.suffix == ".glb":
            if self.data:
                self.tree["buffers"] = [{"byteLength": len(self.data)}]
            path.write_bytes(glb(json.dumps(self.tree).encode(), self.data))
        else:
            uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
            self.tree["buffers"] = [{"byteLength": len(self.data), "uri": uri}]
            path.write_text(json.dumps(self.tree), encoding="utf-8")
        return path


def glb(text: bytes, data: bytes = b"") -> bytes:
    """The container of a GLB round its two chunks."""
    text += b" " * (-len(text) % 4)
    data += bytes(-len(data) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    if data:
        chunks += struct.pack("<II", len(data), 0x004E4942) + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def rich() -> Gltf:
    """A model with a bit of everything that glTF knows and lodpipe has to keep."""
    g = Gltf()
    uv = {"KHR_texture_transform": {"offset": [0.5, 0], "scale": [2, 2], "rotation": 0.25, "texCoord": 1}}
    g.tree["images"] = [
        {"bufferView": g.view(png()), "mimeType": "image/png", "name": "colour", "extras": {"by": "hand"}},
        {"bufferView": g.view(image(4, 4, "RGB", "JPEG")), "mimeType": "image/jpeg"},
        {"bufferView": g.view(image(4, 2, "RGB", "WEBP")), "mimeType": "image/webp"},
    ]
    g.tree["samplers"] = [{"magFilter": 9728, "wrapS": 33071, "name": "clamped"}, {"wrapT": 33648}]
    g.tree["textures"] = [
        {"source": 0, "sampler": 0, "name": "first"},
        {"source": 1, "sampler": 1},
        {"source": 0, "extensions": {"EXT_texture_webp": {"source": 2}}},
    ]
    g.tree["materials"] = [
        {
            "name": "paint",
            "pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "extensions": uv}, "roughnessFactor": 0.25},
            "normalTexture": {"index": 1, "scale": 0.5, "texCoord": 1},
            "alphaMode": "MASK",
            "alphaCutoff": 0.25,
            "extensions": {"KHR_materials_clearcoat": {"clearcoatFactor": 0.5, "clearcoatTexture": {"index": 2}}},
            "extras": {"price": 3},
        },
        {"name": "lamp", "emissiveFactor": [1, 0.5, 0], "doubleSided": True, "extensions": {"KHR_materials_unlit": {}}},
    ]
    variants = {"KHR_materials_variants": {"mappings": [{"material": 1, "variants": [0]}]}}
    painted = g.square(material=0, extensions=variants, extras={"id": "front"})
    painted["attributes"] |= {
        "TEXCOORD_1": g.array(SQUARE_UV * 3 - 1),
        "TANGENT": g.array(np.array([[1, 0, 0, -1]] * 4, np.float32)),
        "COLOR_0": g.array(np.arange(16, dtype=np.uint8).reshape(4, 4) * 17, normalized=True),
        "_TEMPERATURE": g.array(np.arange(4, dtype=np.float32)),
    }
    above = g.array(SQUARE + np.array([0, 1, 0], np.float32))
    plain = {"attributes": {"POSITION": above}, "material": 1, "indices": g.array(SQUARE_FACES.astype(np.uint8))}
    lines = {"attributes": {"POSITION": g.array(SQUARE)}, "mode": 1, "indices": g.array(np.array([0, 1, 1, 2], "u2"))}
    g.mesh(painted, plain, lines, name="panel", extras={"weight": 12})
    skinned = g.square()
    skinned["attributes"] |= {
        "JOINTS_0": g.array(np.array([[0, 1, 0, 0]] * 4, np.uint16)),
        "WEIGHTS_0": g.array(np.array([[0.25, 0.75, 0, 0]] * 4, np.float32)),
    }
    skinned["targets"] = [{"POSITION": g.array(SQUARE * 2), "NORMAL": g.array(UP * 0)}, {"POSITION": g.array(SQUARE)}]
    g.mesh(skinned, name="arm", weights=[0.25, 0.5], extras={"targetNames": ["wide", "high"]})
    g.mesh(g.square(), name="tile")
    times = g.array(np.array([0, 1], np.float32), name="times")
    turns = g.array(np.array([[0, 0, 0, 1], [0, 0, 1, 0]], np.float32))
    g.tree["skins"] = [
        {"joints": [2, 3], "inverseBindMatrices": g.array(np.eye(4, dtype=np.float32).reshape(1, 16).repeat(2, 0))}
    ]
    g.tree["animations"] = [
        {
            "name": "wave",
            "samplers": [
                {"input": times, "output": turns},
                {"input": times, "output": g.array(np.array([0, 1, 1, 0], np.float32)), "interpolation": "STEP"},
            ],
            "channels": [
                {"sampler": 0, "target": {"node": 3, "path": "rotation"}},
                {"sampler": 1, "target": {"node": 1, "path": "weights"}},
            ],
        }
    ]
    g.tree["cameras"] = [{"type": "perspective", "perspective": {"yfov": 0.75, "znear": 0.125}, "name": "eye"}]
    instances = {"attributes": {"TRANSLATION": g.array(np.array([[0, 0, 1], [0, 0, 2]], np.float32))}}
    g.tree["nodes"] = [
        {"mesh": 0, "name": "root", "children": [2, 4, 5], "translation": [1, 2, 3], "extras": {"note": ["kept"]}},
        {"mesh": 1, "skin": 0, "name": "body"},
        {"name": "hip", "children": [3]},
        {"name": "knee"},
        {"camera": 0, "extensions": {"KHR_lights_punctual": {"light": 0}}},
        {"mesh": 2, "extensions": {"EXT_mesh_gpu_instancing": instances}},
    ]
    g.tree["scenes"] = [{"nodes": [0, 1], "name": "main", "extras": 7}, {"nodes": [0]}]
    g.tree["extensions"] = {
        "KHR_lights_punctual": {"lights": [{"type": "point", "intensity": 2}]},
        "KHR_materials_variants": {"variants": [{"name": "evening"}]},
        "ACME_owner": {"name": "somebody"},
    }
    g.tree["extensionsUsed"] = [
        "KHR_lights_punctual",
        "KHR_materials_variants",
        "KHR_materials_clearcoat",
        "KHR_materials_unlit",
        "KHR_texture_transform",
        "EXT_texture_webp",
        "EXT_mesh_gpu_instancing",
        "ACME_owner",
    ]
    g.tree["asset"] |= {"copyright": "nobody", "extras": {"made": "by a test"}}
    g.tree["extras"] = {"top": True}
    return g
