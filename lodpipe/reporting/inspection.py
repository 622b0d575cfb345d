"""What is in an asset, under the field names that `gltf-transform inspect` uses."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lodpipe.core.asset import Asset
from lodpipe.core.mesh import Mesh
from lodpipe.reporting.table import clean, number, size, table

_TABLES = {
    "scenes": ("name", "rootName", "bboxMin", "bboxMax", "renderVertexCount", "uploadVertexCount"),
    "meshes": ("name", "meshPrimitives", "glPrimitives", "vertices", "attributes", "instances", "size"),
    "materials": ("name", "instances", "textures", "alphaMode", "doubleSided"),
    "textures": ("name", "uri", "slots", "mimeType", "resolution", "size", "gpuSize"),
    "animations": ("name", "channels", "samplers", "duration", "keyframes", "size"),
}
_SIZES = {"size", "gpuSize"}
_UV_COLUMNS = {
    "mesh": "mesh",
    "set": "set",
    "charts": "charts",
    "missing_faces": "missing",
    "zero_area_faces": "no area",
    "overlap_percent": "overlap %",
    "overlap_kind": "kind",
    "flipped_percent": "flipped %",
    "out_of_range_percent": "outside %",
    "min_gutter_texels": "gutter",
    "stretch_l2": "stretch",
    "density_cv": "density ±",
    "seam_length": "seams",
}
"""What the table for people shows of a UV set, and its heads there."""


def inspection(
    asset: Asset, topology: Sequence[Mapping[str, Any]], uv: Sequence[Sequence[Mapping[str, Any]]]
) -> dict[str, Any]:
    """The asset as data: `scenes`, `meshes`, `materials`, `textures`, `animations`, each with a list `properties`.

    `topology` and `uv` hold the defects of each mesh, and stand beside them under those names; a mesh's `uv` has the
    figures of its first UV set. Types and sizes are those of the arrays as lodpipe writes them.
    """
    names = [mesh.name for mesh in asset.meshes]
    meshes = [{**_mesh(asset, index), "uv": dict(uv[index][0])} for index in range(len(asset.meshes))]
    return {
        "asset": asset.name,
        "format": asset.format,
        "triangles": asset.triangles,
        "vertices": asset.vertices,
        "scenes": {"properties": _scenes(asset)},
        "meshes": {"properties": meshes},
        "materials": {"properties": [_material(asset, index) for index in range(len(asset.materials))]},
        "textures": {"properties": [_texture(asset, index) for index in range(len(asset.images))]},
        "animations": {"properties": [_animation(asset, entry) for entry in asset.document.get("animations", ())]},
        "topology": [{"mesh": name, **defects} for name, defects in zip(names, topology, strict=True)],
        "uv": [{"mesh": name, **entry} for name, sets in zip(names, uv, strict=True) for entry in sets],
        "warnings": list(asset.warnings),
    }


def inspection_text(data: Mapping[str, Any]) -> list[str]:
    """The same as tables for people."""
    title = f"{data['asset']} ({data['format']}): {number(data['triangles'])} triangles"
    lines = [clean(f"{title}, {number(data['vertices'])} vertices")]
    for part, columns in _TABLES.items():
        rows = data[part]["properties"]
        if rows:
            lines += ["", part, *_rows(columns, rows)]
    if data["topology"]:
        lines += ["", "topology defects", *_rows(tuple(data["topology"][0]), data["topology"])]
    if data["uv"]:
        rows = [{title: row[name] for name, title in _UV_COLUMNS.items()} for row in data["uv"]]
        lines += ["", "uv defects", *_rows(tuple(_UV_COLUMNS.values()), rows)]
    if data["warnings"]:
        lines += ["", "warnings", *(f"  {clean(text)}" for text in data["warnings"])]
    return lines


def _rows(columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> list[str]:
    numeric = {name for name in columns if all(isinstance(row[name], int | float) for row in rows)}
    head = [f">{name}" if name in numeric or name in _SIZES else name for name in columns]
    return table(head, [[_cell(name, row[name]) for name in columns] for row in rows])


def _cell(name: str, value: Any) -> str:
    if name in _SIZES:
        return size(value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return number(value)
    if isinstance(value, list):
        return clean(", ".join(f"{item:.6g}" if isinstance(item, float) else str(item) for item in value)) or "–"
    return clean(str(value)) or "–"


def _scenes(asset: Asset) -> list[dict[str, Any]]:
    nodes = asset.document.get("nodes", ())
    found = []
    for index, scene in enumerate(asset.document.get("scenes", ()) or ({},)):
        placed = dataclasses.replace(asset, document={**asset.document, "scene": index}).instances()
        low, high = _bounds(asset, placed)
        meshes = {mesh for mesh, _ in placed}
        roots = scene.get("nodes", ())
        found.append(
            {
                "name": scene.get("name", ""),
                "rootName": nodes[roots[0]].get("name", "") if roots and nodes else "",
                "bboxMin": low,
                "bboxMax": high,
                "renderVertexCount": sum(3 * len(asset.meshes[mesh].faces) for mesh, _ in placed),
                "uploadVertexCount": sum(asset.meshes[mesh].wedge_count for mesh in meshes),
                "uploadNaiveVertexCount": sum(asset.meshes[mesh].wedge_count for mesh in meshes),
            }
        )
    return found


def _bounds(asset: Asset, placed: Sequence[tuple[int, Any]]) -> tuple[list[float], list[float]]:
    """Corners of the bounding box of the placed meshes, to five digits; zeros for nothing."""
    lows, highs = [], []
    for index, matrix in placed:
        mesh = asset.meshes[index]
        if len(mesh.faces):
            points = mesh.positions[np.unique(mesh.faces)] @ matrix[:3, :3].T + matrix[:3, 3]
            lows.append(points.min(axis=0))
            highs.append(points.max(axis=0))
    if not lows:
        return [0.0] * 3, [0.0] * 3
    return _digits(np.min(lows, axis=0)), _digits(np.max(highs, axis=0))


def _digits(values: Any) -> list[float]:
    return [round(float(value), 5) for value in values]


def _mesh(asset: Asset, index: int) -> dict[str, Any]:
    mesh = asset.meshes[index]
    used = [primitive.attributes for primitive in mesh.primitives]
    labels = {f"{name}:f32" for names in used for name in names} | {"POSITION:f32"}
    counts = [_vertices(mesh, row) for row in range(len(mesh.primitives))]
    return {
        "name": mesh.name,
        "mode": ["TRIANGLES"],
        "meshPrimitives": len(mesh.primitives),
        "glPrimitives": len(mesh.faces),
        "vertices": mesh.wedge_count,
        "indices": sorted({f"u{8 * _index_bytes(count)}" for count in counts}),
        "attributes": sorted(labels),
        "instances": sum(node.get("mesh") == index for node in asset.document.get("nodes", ()))
        or len([1 for placed, _ in asset.instances() if placed == index]),
        "size": sum(_size(mesh, row, count) for row, count in enumerate(counts)),
        "keepReason": mesh.keep_reason,
    }


def _vertices(mesh: Mesh, primitive: int) -> int:
    return len(np.unique(mesh.wedges[mesh.face_primitive == primitive]))


def _index_bytes(count: int) -> int:
    return 2 if count < 65536 else 4  # 65535 itself is the restart index of 16 bits


def _size(mesh: Mesh, primitive: int, count: int) -> int:
    names = [name for name in mesh.primitives[primitive].attributes if name in mesh.attributes]
    floats = 3 + sum(mesh.attributes[name].shape[1] for name in names)
    corners = 3 * int(np.count_nonzero(mesh.face_primitive == primitive))
    total: int = count * 4 * floats + corners * _index_bytes(count)
    return total


def _material(asset: Asset, index: int) -> dict[str, Any]:
    material = asset.materials[index]
    users = [primitive for mesh in asset.meshes for primitive in mesh.primitives if primitive.material == index]
    return {
        "name": material.name,
        "instances": len(users),
        "textures": [slot for slot, _ in _slots(material.gltf)],
        "alphaMode": material.alpha_mode,
        "doubleSided": material.double_sided,
    }


def _slots(value: Any, name: str = "") -> list[tuple[str, int]]:
    """(slot, row of `textures`) for each texture that a glTF material names, its extensions included."""
    if not isinstance(value, Mapping):
        return []
    if name.endswith("Texture") and isinstance(value.get("index"), int):
        return [(name, value["index"])]
    return [slot for key, item in value.items() if key != "extras" for slot in _slots(item, key)]


def _texture(asset: Asset, index: int) -> dict[str, Any]:
    image = asset.images[index]
    textures = asset.document.get("textures", ())
    rows = {row for row, texture in enumerate(textures) if index in _sources(texture)}
    slots = [slot for material in asset.materials for slot, row in _slots(material.gltf) if row in rows]
    return {
        "name": image.name,
        "uri": image.uri,
        "slots": list(dict.fromkeys(slots)),
        "instances": len(slots),
        "mimeType": image.mime_type,
        "compression": "",
        "resolution": f"{image.width}x{image.height}" if image.width else "",
        "size": len(image.data),
        "gpuSize": _gpu_size(image.width, image.height) if image.width else None,
        "problem": image.problem,
    }


def _sources(texture: Mapping[str, Any]) -> set[int]:
    """Rows of the images that a glTF texture names, itself or by an extension (WebP, KTX2)."""
    extensions = texture.get("extensions", {}).values()
    named = [texture.get("source"), *(entry.get("source") for entry in extensions if isinstance(entry, Mapping))]
    return {row for row in named if isinstance(row, int)}


def _gpu_size(width: int, height: int) -> int:
    """Bytes of RGBA8 with all mip levels."""
    total = 0
    while width > 1 or height > 1:
        total += 4 * width * height
        width, height = max(1, width // 2), max(1, height // 2)
    return total + 4


def _animation(asset: Asset, animation: Mapping[str, Any]) -> dict[str, Any]:
    samplers = animation.get("samplers", ())
    inputs = [asset.accessors[sampler["input"]].values for sampler in samplers]
    times = np.concatenate([values.ravel() for values in inputs]) if inputs else np.zeros(1)
    rows = {sampler[end] for sampler in samplers for end in ("input", "output")}
    return {
        "name": animation.get("name", ""),
        "channels": len(animation.get("channels", ())),
        "samplers": len(samplers),
        "duration": round(float(times.max() - times.min()), 3) if times.size else 0.0,
        "keyframes": sum(len(values) for values in inputs),
        "size": sum(asset.accessors[row].values.nbytes for row in rows),
    }


def inspection_json(data: Mapping[str, Any]) -> str:
    """The data as JSON text."""
    return json.dumps(data, indent=2, allow_nan=False)
