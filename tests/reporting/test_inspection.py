"""`inspect`: the names and figures that gltf-transform's users know."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from lodpipe.core.asset import Accessor, Asset
from lodpipe.core.material import Image, Material
from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.geometry.topology import topology_defects
from lodpipe.geometry.uv_defects import uv_defects
from lodpipe.reporting.inspection import inspection, inspection_json, inspection_text
from meshes import box


def asset() -> Asset:
    """A cube in two primitives of two materials, placed twice, with a texture and an animation."""
    positions, faces = box()
    wedges = np.concatenate([faces[:6], faces[6:] + 8])
    mesh = Mesh(
        positions,
        faces,
        wedges,
        {"TEXCOORD_0": np.zeros((16, 2), np.float32), "NORMAL": np.zeros((16, 3), np.float32)},
        [0] * 6 + [1] * 6,
        (Primitive(0, ("TEXCOORD_0", "NORMAL")), Primitive(1, ("NORMAL",))),
        name="cube",
    )
    cloth = {"sheenColorTexture": {"index": 0}}
    materials = (
        Material({"name": "red", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "doubleSided": True}),
        Material({"name": "blue", "alphaMode": "MASK", "extensions": {"KHR_materials_sheen": cloth}}),
    )
    document = {
        "scenes": [{"name": "main", "nodes": [0]}, {"nodes": []}],
        "nodes": [{"name": "root", "children": [1, 2]}, {"mesh": 0}, {"mesh": 0, "translation": [10, 0, 0]}],
        "textures": [{"source": 0}, {"extensions": {"EXT_texture_webp": {"source": 0}}}],
        "animations": [
            {"name": "turn", "channels": [{}, {}], "samplers": [{"input": 0, "output": 1}, {"input": 0, "output": 2}]}
        ],
    }
    accessors = (
        Accessor(np.array([0.5, 1.0, 2.0], np.float32), "SCALAR"),
        Accessor(np.zeros((3, 4), np.float32), "VEC4"),
        Accessor(np.zeros((3, 3), np.float32), "VEC3"),
    )
    image = Image(b"x" * 50, "image/png", "paint", "paint.png", 4, 2)
    return Asset("cubes", (mesh,), materials, (image,), document, accessors, format="glb", warnings=("a hole",))


def inspected(source: Asset):
    topology = [dataclasses.asdict(topology_defects(mesh)) for mesh in source.meshes]
    return inspection(source, topology, [[dataclasses.asdict(e) for e in uv_defects(m)] for m in source.meshes])


def test_scenes():
    first, second = inspected(asset())["scenes"]["properties"]
    assert first == {
        "name": "main",
        "rootName": "root",
        "bboxMin": [-0.5, -0.5, -0.5],
        "bboxMax": [10.5, 0.5, 0.5],
        "renderVertexCount": 72,
        "uploadVertexCount": asset().meshes[0].wedge_count,
        "uploadNaiveVertexCount": asset().meshes[0].wedge_count,
    }
    assert (second["rootName"], second["bboxMin"], second["renderVertexCount"]) == ("", [0.0] * 3, 0)


def test_meshes():
    (mesh,) = inspected(asset())["meshes"]["properties"]
    counts = [len(np.unique(asset().meshes[0].wedges[rows])) for rows in (slice(0, 6), slice(6, 12))]
    assert mesh == {
        "name": "cube",
        "mode": ["TRIANGLES"],
        "meshPrimitives": 2,
        "glPrimitives": 12,
        "vertices": sum(counts),
        "indices": ["u16"],
        "attributes": ["NORMAL:f32", "POSITION:f32", "TEXCOORD_0:f32"],
        "instances": 2,
        "size": counts[0] * 32 + counts[1] * 24 + 36 * 2,
        "keepReason": "",
        "uv": dataclasses.asdict(uv_defects(asset().meshes[0])[0]),
    }


def test_materials_and_textures():
    data = inspected(asset())
    assert data["materials"]["properties"] == [
        {
            "name": "red",
            "instances": 1,
            "textures": ["baseColorTexture"],
            "alphaMode": "OPAQUE",
            "doubleSided": True,
        },
        {
            "name": "blue",
            "instances": 1,
            "textures": ["sheenColorTexture"],
            "alphaMode": "MASK",
            "doubleSided": False,
        },
    ]
    assert data["textures"]["properties"] == [
        {
            "name": "paint",
            "uri": "paint.png",
            "slots": ["baseColorTexture", "sheenColorTexture"],
            "instances": 2,
            "mimeType": "image/png",
            "compression": "",
            "resolution": "4x2",
            "size": 50,
            "gpuSize": 4 * (8 + 2 + 1),
            "problem": "",
        }
    ]


def test_animations():
    (animation,) = inspected(asset())["animations"]["properties"]
    assert animation == {
        "name": "turn",
        "channels": 2,
        "samplers": 2,
        "duration": 1.5,
        "keyframes": 6,
        "size": 12 + 48 + 36,
    }


def test_a_file_without_scenes_has_one():
    positions, faces = box()
    (scene,) = inspected(Asset("box", (Mesh(positions, faces),)))["scenes"]["properties"]
    assert (scene["bboxMin"], scene["renderVertexCount"], scene["rootName"]) == ([-0.5] * 3, 36, "")
    assert inspected(Asset("box", (Mesh(positions, faces),)))["meshes"]["properties"][0]["instances"] == 1


def test_defects_and_warnings_are_beside_them():
    data = inspected(asset())
    assert data["topology"][0] == {"mesh": "cube", **dataclasses.asdict(topology_defects(asset().meshes[0]))}
    (entry,) = data["uv"]
    assert entry == {"mesh": "cube", **dataclasses.asdict(uv_defects(asset().meshes[0])[0])}
    assert (entry["set"], entry["missing_faces"], entry["zero_area_faces"]) == ("TEXCOORD_0", 6, 6)
    assert data["warnings"] == ["a hole"]
    assert json.loads(inspection_json(data)) == data


def test_the_tables_show_it_all():
    text = "\n".join(inspection_text(inspected(asset())))
    for word in ("cubes (glb): 12 triangles", "main", "cube", "red", "paint.png", "turn", "a hole", "topology defects"):
        assert word in text


@pytest.mark.parametrize("name", ["a\x1b[2J", "b\nc"])
def test_names_cannot_write_on_the_terminal(name):
    source = dataclasses.replace(asset(), name=name, meshes=(dataclasses.replace(asset().meshes[0], name=name),))
    text = "\n".join(inspection_text(inspected(source)))
    assert name not in text
