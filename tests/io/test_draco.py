from __future__ import annotations

from pathlib import Path
from typing import Any

import DracoPy
import numpy as np
import pytest

import model_files as files
from lodpipe import io
from lodpipe.core.errors import AssetError
from lodpipe.io.draco import EXTENSION
from meshes import sphere


def compressed(points: Any, faces: Any, **attributes: Any) -> bytes:
    return bytes(DracoPy.encode(points.astype(np.float32), faces.astype(np.uint32), quantization_bits=16, **attributes))


def model(stream: bytes, names: dict[str, Any], count: int) -> files.Gltf:
    g = files.Gltf()
    view = g.view(stream)
    for kind in ("VEC3", "VEC2", "VEC4"):
        g.tree["accessors"].append({"componentType": 5126, "type": kind, "count": count})
    g.tree["accessors"][2] |= {"componentType": 5121, "normalized": True}
    rows = {"POSITION": 0, "TEXCOORD_0": 1, "COLOR_0": 2}
    said = {EXTENSION: {"bufferView": view, "attributes": names}}
    g.mesh({"attributes": {name: rows[name] for name in names if name in rows}, "extensions": said})
    g.tree["extensionsUsed"] = g.tree["extensionsRequired"] = [EXTENSION]
    return g


def test_attributes_are_found_by_their_ids(tmp_path: Path) -> None:
    points, faces = sphere(2)
    uv = points[:, :2] * 0.5 + 0.5
    colours = np.tile(np.array([[0, 51, 255, 255]], np.uint8), (len(points), 1))
    stream = compressed(points, faces, tex_coord=uv, colors=colours)
    ids = {a["attribute_type"]: a["unique_id"] for a in DracoPy.decode(stream).attributes}
    names = {"POSITION": ids[0], "COLOR_0": ids[2], "TEXCOORD_0": ids[3]}
    asset = io.load(model(stream, names, len(points)).save(tmp_path / "m.glb"))
    mesh = asset.meshes[0]
    assert len(mesh.faces) == len(faces)
    place = mesh.positions[mesh.faces]
    assert np.abs(np.linalg.norm(place, axis=2) - 1).max() < 1e-3
    assert np.abs(mesh.attributes["TEXCOORD_0"][mesh.wedges] - (place[:, :, :2] * 0.5 + 0.5)).max() < 1e-3
    assert np.allclose(mesh.attributes["COLOR_0"], [0, 0.2, 1, 1])
    assert "extensionsRequired" not in asset.document and mesh.primitives[0].gltf == {}
    a, b, c = (place[:, k] for k in range(3))
    assert (np.einsum("fk,fk->f", np.cross(b - a, c - a), a) > 0).all(), "faces must look outwards"


def test_damage_is_one_line(tmp_path: Path) -> None:
    points, faces = sphere(1)
    stream = compressed(points, faces)
    with pytest.raises(
        AssetError, match=rf"m.glb: meshes\[0\].primitives\[0\]: the {EXTENSION} data cannot be decoded"
    ):
        io.load(model(b"not draco at all", {"POSITION": 0}, len(points)).save(tmp_path / "m.glb"))
    with pytest.raises(AssetError, match="data lacks TEXCOORD_0"):
        io.load(model(stream, {"POSITION": 0, "TEXCOORD_0": 7}, len(points)).save(tmp_path / "m.glb"))
    with pytest.raises(AssetError, match="names no attributes"):
        io.load(model(stream, {"POSITION": "0"}, len(points)).save(tmp_path / "m.glb"))
    g = model(stream, {"POSITION": 0}, len(points))
    g.tree["meshes"][0]["primitives"][0]["extensions"][EXTENSION]["bufferView"] = 5
    with pytest.raises(AssetError, match="names no buffer view"):
        io.load(g.save(tmp_path / "m.glb"))
    cloud = bytes(DracoPy.encode(points.astype(np.float32)))
    with pytest.raises(AssetError, match="point cloud"):
        io.load(model(cloud, {"POSITION": 0}, len(points)).save(tmp_path / "m.glb"))
