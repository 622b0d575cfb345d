from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import model_files as files
from lodpipe import io
from lodpipe.core.asset import Asset
from lodpipe.core.errors import AssetError, LimitError
from lodpipe.io import Limits

SQUARE = [[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]]


def corners(asset: Asset, mesh: int = 0) -> list[list[list[float]]]:
    m = asset.meshes[mesh]
    found: list[list[list[float]]] = m.positions[m.faces].tolist()
    return found


def one(folder: Path, primitive: Any, g: files.Gltf) -> Asset:
    g.mesh(primitive)
    return io.load(g.save(folder / "m.glb"))


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.uint32, None])
@pytest.mark.parametrize(
    ("mode", "order"),
    [(4, [0, 1, 2, 0, 2, 3]), (5, [1, 2, 0, 3]), (5, [1, 2, 0, 0, 0, 0, 3, 2]), (6, [0, 1, 2, 3])],
)
def test_triangles_strips_and_fans(tmp_path: Path, kind: Any, mode: int, order: list[int]) -> None:
    g = files.Gltf()
    primitive: dict[str, Any] = {"mode": mode}
    if kind is None:
        primitive["attributes"] = {"POSITION": g.array(files.SQUARE[order])}
    else:
        primitive["attributes"] = {"POSITION": g.array(files.SQUARE)}
        primitive["indices"] = g.array(np.array(order, kind))
    asset = one(tmp_path, primitive, g)
    real = [face for face in corners(asset) if len(set(map(tuple, face))) == 3]
    assert len(real) == 2 and (kind is None or len(asset.meshes[0].faces) == 2)
    turned = {tuple(map(tuple, np.roll(face, k, axis=0))) for face in real for k in range(3)}
    assert turned == {tuple(map(tuple, np.roll(face, k, axis=0))) for face in SQUARE for k in range(3)}
    assert len(asset.meshes[0].positions) == 4 and asset.warnings == ()


def test_interleaved_and_unaligned_views(tmp_path: Path) -> None:
    g = files.Gltf()
    rows = np.zeros(4, [("p", "<f4", 3), ("c", "u1", 4), ("t", "<f4", 2)])
    rows["p"], rows["c"], rows["t"] = files.SQUARE, 255, files.SQUARE_UV
    view = g.view(rows.tobytes(), byteStride=24)
    said = {"bufferView": view, "count": 4}
    g.tree["accessors"] = [
        {**said, "componentType": 5126, "type": "VEC3"},
        {**said, "byteOffset": 12, "componentType": 5121, "type": "VEC4", "normalized": True},
        {**said, "byteOffset": 16, "componentType": 5126, "type": "VEC2"},
    ]
    attributes = {"POSITION": 0, "COLOR_0": 1, "TEXCOORD_0": 2}
    asset = one(tmp_path, {"attributes": attributes, "indices": g.array(files.SQUARE_FACES)}, g)
    table = asset.meshes[0].attributes
    assert corners(asset) == SQUARE
    assert (table["COLOR_0"] == 1).all() and table["TEXCOORD_0"].tolist() == files.SQUARE_UV.tolist()


def test_sparse_accessors_with_and_without_a_base(tmp_path: Path) -> None:
    g = files.Gltf()
    flat = g.array(files.SQUARE * 0)
    rows, values = g.array(np.array([1, 2, 3], np.uint8)), g.array(files.SQUARE[1:])
    views = [g.tree["accessors"][i]["bufferView"] for i in (rows, values)]
    sparse = {
        "count": 3,
        "indices": {"bufferView": views[0], "componentType": 5121},
        "values": {"bufferView": views[1]},
    }
    g.tree["accessors"][flat]["sparse"] = sparse
    g.tree["accessors"].append({"componentType": 5126, "type": "VEC3", "count": 4, "sparse": sparse})
    indices = g.array(files.SQUARE_FACES)
    g.mesh({"attributes": {"POSITION": flat}, "indices": indices})
    g.mesh({"attributes": {"POSITION": flat + 3}, "indices": indices})
    asset = io.load(g.save(tmp_path / "m.gltf"))
    assert corners(asset) == corners(asset, 1) == SQUARE
    sparse["indices"]["byteOffset"] = 1
    with pytest.raises(AssetError, match="reach beyond"):
        io.load(g.save(tmp_path / "m.gltf"))


def test_quantised_attributes_are_undone(tmp_path: Path) -> None:
    g = files.Gltf()
    attributes = {
        "POSITION": g.array(np.pad(files.SQUARE * 1000, ((0, 0), (0, 1))).astype(np.int16)[:, :3].copy()),
        "NORMAL": g.array(np.array([[0, 0, 127]] * 4, np.int8), normalized=True),
        "TEXCOORD_0": g.array((files.SQUARE_UV * 65535).astype(np.uint16), normalized=True),
        "COLOR_0": g.array(np.array([[0, 128, 255]] * 4, np.uint8), normalized=True),
    }
    lines = {"mode": 1, "attributes": {"POSITION": attributes["POSITION"]}}
    g.tree["extensionsUsed"] = g.tree["extensionsRequired"] = ["KHR_mesh_quantization"]
    g.mesh({"attributes": attributes, "indices": g.array(files.SQUARE_FACES)}, lines)
    asset = io.load(g.save(tmp_path / "m.glb"))
    table = asset.meshes[0].attributes
    assert asset.meshes[0].positions.max() == 1000 and (table["NORMAL"] == [0, 0, 1]).all()
    assert table["TEXCOORD_0"].tolist() == files.SQUARE_UV.tolist()
    assert np.allclose(table["COLOR_0"][0], [0, 128 / 255, 1])
    assert "extensionsUsed" not in asset.document and "extensionsRequired" not in asset.document
    assert asset.accessors[0].values.dtype == np.float32, "the lines' positions are undone too"


def test_primitives_of_a_mesh_are_welded_and_know_their_attributes(tmp_path: Path) -> None:
    g = files.Gltf()
    first = g.square(extras={"id": 1})
    second = {"attributes": {"POSITION": g.array(files.SQUARE + np.array([0, 1, 0], np.float32))}}
    second["attributes"]["COLOR_0"] = g.array(np.ones((4, 3), np.float32))
    second["indices"] = g.array(files.SQUARE_FACES)
    g.mesh(first, second)
    mesh = io.load(g.save(tmp_path / "m.glb")).meshes[0]
    assert len(mesh.positions) == 6, "the two corners that touch are one position each"
    assert mesh.wedge_count == 8
    assert [p.attributes for p in mesh.primitives] == [("NORMAL", "TEXCOORD_0"), ("COLOR_0",)]
    assert mesh.primitives[0].gltf == {"extras": {"id": 1}}
    assert mesh.face_primitive.tolist() == [0, 0, 1, 1]


def test_primitives_that_share_their_vertices(tmp_path: Path) -> None:
    g = files.Gltf()
    attributes = g.square()["attributes"]
    halves = [
        {"attributes": attributes, "indices": g.array(h)} for h in (files.SQUARE_FACES[:3], files.SQUARE_FACES[3:])
    ]
    g.mesh(*halves)
    mesh = io.load(g.save(tmp_path / "m.glb")).meshes[0]
    assert len(mesh.positions) == 4 and mesh.wedge_count == 6 and len(mesh.attributes["NORMAL"]) == 6


def test_colours_with_and_without_alpha_in_one_mesh(tmp_path: Path) -> None:
    g = files.Gltf()
    parts = []
    for width in (3, 4):
        colour = g.array(np.full((4, width), 0.5, np.float32))
        parts.append({"attributes": {"POSITION": g.array(files.SQUARE + width), "COLOR_0": colour}})
        parts[-1]["indices"] = g.array(files.SQUARE_FACES)
    g.mesh(*parts)
    mesh = io.load(g.save(tmp_path / "m.glb")).meshes[0]
    assert mesh.attributes["COLOR_0"][mesh.wedges[0, 0]].tolist() == [0.5, 0.5, 0.5, 1]
    assert mesh.attributes["COLOR_0"][mesh.wedges[2, 0]].tolist() == [0.5] * 4


def test_absent_normals_stay_absent(tmp_path: Path) -> None:
    g = files.Gltf()
    primitive = {"attributes": {"POSITION": g.array(files.SQUARE)}, "indices": g.array(files.SQUARE_FACES)}
    assert one(tmp_path, primitive, g).meshes[0].attributes == {}


def test_a_mesh_that_is_placed_beyond_all_numbers_is_refused(tmp_path: Path) -> None:
    g = files.Gltf()
    g.mesh({"attributes": {"POSITION": g.array(files.TRIANGLE)}})
    g.tree["nodes"] = [{"scale": [1e200, 1, 1], "children": [1]}, {"scale": [1e200, 1, 1], "mesh": 0}]
    with pytest.raises(AssetError, match=r"meshes\[0\]: it is placed beyond 1e\+60 units"):
        io.load(g.save(tmp_path / "m.glb"))


def test_skins_and_morph_targets(tmp_path: Path) -> None:
    asset = io.load(files.rich().save(tmp_path / "m.glb"))
    assert [m.keep_reason for m in asset.meshes] == ["", "", ""]
    arm = asset.meshes[1]
    assert arm.attributes["JOINTS_0"][0].tolist() == [0, 1, 0, 0]
    assert arm.attributes["MORPH_0_POSITION"].max() == 2 and "MORPH_1_POSITION" in arm.attributes


def test_positions_that_move_apart_are_not_welded(tmp_path: Path) -> None:
    """Lips that touch: two vertices at one place, bound to different joints, or moved differently by a target."""
    g = files.Gltf()
    points = np.vstack([files.TRIANGLE, files.TRIANGLE])
    joints = np.repeat(np.array([[0, 0, 0, 0], [1, 0, 0, 0]], np.uint8), 3, axis=0)
    weights = np.array([[1, 0, 0, 0]] * 6, np.float32)
    attributes = {"POSITION": g.array(points), "JOINTS_0": g.array(joints), "WEIGHTS_0": g.array(weights)}
    g.mesh({"attributes": attributes})
    moved = {"POSITION": g.array(points + np.repeat([[0], [1]], 3, axis=0).astype(np.float32))}
    g.mesh({"attributes": {"POSITION": attributes["POSITION"]}, "targets": [moved]})
    g.tree["nodes"] = [{"mesh": 0, "skin": 0}, {}, {"mesh": 1}]
    g.tree["skins"] = [{"joints": [0, 1]}]
    asset = io.load(g.save(tmp_path / "m.glb"))
    assert [len(m.positions) for m in asset.meshes] == [6, 6]


def test_repairs_are_named_with_their_counts(tmp_path: Path) -> None:
    g = files.Gltf()
    points = np.vstack([files.SQUARE, [[np.nan, 0, 0], [5, 5, 5]]]).astype(np.float32)
    uv = np.vstack([files.SQUARE_UV, [[0, 0], [0, 0]]]).astype(np.float32)
    uv[2] = np.inf
    normal = np.vstack([files.UP, files.UP[:2]])
    normal[1], normal[3] = np.nan, 0
    faces = np.array([0, 1, 2, 0, 2, 3, 2, 0, 1, 2, 1, 0, 0, 1, 4, 0, 1, 99, 0, 1], np.uint16)
    attributes = {"POSITION": g.array(points), "TEXCOORD_0": g.array(uv), "NORMAL": g.array(normal)}
    asset = one(tmp_path, {"attributes": attributes, "indices": g.array(faces)}, g)
    mesh = asset.meshes[0]
    assert len(mesh.faces) == 3, "the square, and one face of it turned over"
    assert asset.warnings == (
        "meshes[0].primitives[0]: 20 indices are not threes; the last 2 left out",
        "meshes[0]: 1 face with an index out of range left out",
        "meshes[0]: 1 position is not finite; 1 face left out",
        "meshes[0]: 1 of 4 TEXCOORD_0 values are not finite; set to 0",
        "meshes[0]: 1 of 4 NORMAL values are not finite; set to 0",
        "meshes[0]: 1 face that are exact doubles of others left out",
        "meshes[0]: 2 normals of no length; taken from the faces round them",
    )
    assert np.isfinite(mesh.attributes["TEXCOORD_0"]).all()
    assert np.abs(mesh.attributes["NORMAL"][:, 2]).min() == 1


def test_attributes_of_the_wrong_length_are_left_out(tmp_path: Path) -> None:
    g = files.Gltf()
    primitive = g.square()
    primitive["attributes"]["COLOR_0"] = g.array(np.ones((3, 3), np.float32))
    asset = one(tmp_path, primitive, g)
    assert asset.warnings == ("meshes[0].primitives[0]: COLOR_0 has 3 rows for 4 positions; left out",)
    assert asset.meshes[0].primitives[0].attributes == ("NORMAL", "TEXCOORD_0")


def test_files_beside_the_gltf(tmp_path: Path) -> None:
    g = files.Gltf()
    g.mesh(g.square(material=0))
    g.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    g.tree["textures"] = [{"source": 0}, {"source": 1}]
    data = "data:image/png;base64," + base64.b64encode(files.png(3)).decode()
    g.tree["images"] = [{"uri": "tex%20tures/a%C3%B6.png"}, {"uri": data, "name": "inside"}]
    g.tree["buffers"] = [{"byteLength": len(g.data), "uri": "b.bin"}]
    (tmp_path / "tex tures").mkdir()
    (tmp_path / "tex tures" / "aö.png").write_bytes(files.png())
    (tmp_path / "b.bin").write_bytes(g.data + b"trailing")
    path = tmp_path / "m.gltf"
    path.write_text(json.dumps(g.tree))
    asset = io.load(path)
    assert asset.members == (path, tmp_path / "b.bin", tmp_path / "tex tures" / "aö.png")
    assert [(i.uri, i.name, i.width) for i in asset.images] == [("aö.png", "", 2), ("", "inside", 3)]
    assert asset.path == path and asset.format == "gltf" and asset.lods[0].meshes == asset.meshes
    (tmp_path / "b.bin").write_bytes(g.data[:-1])
    with pytest.raises(AssetError, match=r"buffers\[0\]: it has \d+ bytes instead of"):
        io.load(path)
    (tmp_path / "b.bin").unlink()
    with pytest.raises(AssetError, match=r"m.gltf: buffers\[0\]: 'b.bin' is missing"):
        io.load(path)


def test_broken_images_are_warnings_and_bombs_are_refused(tmp_path: Path) -> None:
    g = files.Gltf()
    g.mesh(g.square())
    g.tree["images"] = [{"uri": "gone.png"}, {"uri": "data:image/png;base64,!!"}, {}, {"bufferView": g.view(b"text")}]
    asset = io.load(g.save(tmp_path / "m.gltf"))
    assert [bool(i.problem) for i in asset.images] == [True] * 4 == [not i.data for i in asset.images]
    assert len(asset.warnings) == 4 and all("shown without it" in w for w in asset.warnings)
    g.tree["images"] = [{"bufferView": g.view(files.png(9, 9))}]
    path = g.save(tmp_path / "m.gltf")
    with pytest.raises(LimitError, match=r"images\[0\]: the image has 9 × 9 pixels"):
        io.load(path, Limits(texture_pixels=80))


def test_triangles_are_counted_before_anything_is_read(tmp_path: Path) -> None:
    g = files.Gltf()
    square = g.square()
    for _ in range(5):
        g.mesh(square, square)
    path = g.save(tmp_path / "m.glb")
    assert io.load(path, Limits(triangles=20)).triangles == 20
    with pytest.raises(LimitError, match="20 triangles, more than the limit of 19"):
        io.load(path, Limits(triangles=19))
    g.tree["accessors"].append({"componentType": 5126, "type": "VEC3", "count": 3_000_000_000})
    g.tree["meshes"] = [{"primitives": [{"attributes": {"POSITION": square["attributes"]["POSITION"]}, "indices": 0}]}]
    g.tree["meshes"][0]["primitives"][0] = {"attributes": {"POSITION": len(g.tree["accessors"]) - 1}, "mode": 1}
    with pytest.raises(LimitError, match="3,000,000,000 elements need 36,000,000,000 bytes"):
        io.load(g.save(tmp_path / "m.glb"))


@pytest.mark.parametrize(
    ("data", "cause"),
    [
        (b"", "the file is empty"),
        (b"glTF\2\0\0\0", "cut off in its header"),
        (b"glTF\1\0\0\0" + bytes(20), "GLB version 1"),
        (files.glb(b"{}")[:-1], "a chunk of 4 bytes begins at byte 12 of 23"),
        (b"glTF\2\0\0\0" + bytes(12), "no JSON chunk"),
        (files.glb(b"{}"), "'asset' is missing"),
        (files.glb(b'{"asset": {"version": "1.0"}}'), "glTF 1.0 is not supported"),
        (files.glb(b'{"asset": {"version": "2.0"}}'), "no triangles"),
        (b'{"asset": {"version": "2.0"}}', "no triangles"),
        (b"<xml>", "not valid"),
    ],
)
def test_what_is_no_gltf(tmp_path: Path, data: bytes, cause: str) -> None:
    path = tmp_path / "m.glb"
    path.write_bytes(data)
    with pytest.raises(AssetError, match=cause):
        io.load(path)


def test_extensions(tmp_path: Path) -> None:
    g = files.Gltf()
    g.mesh(g.square(extensions={"CESIUM_primitive_outline": {"indices": 0}, "ACME_ok": {"a": 1}}))
    g.tree["extensions"] = {"EXT_structural_metadata": {"propertyTables": []}, "ACME_ok": {}}
    g.tree["extensionsUsed"] = ["CESIUM_primitive_outline", "EXT_structural_metadata", "ACME_ok", "ACME_silent"]
    asset = io.load(g.save(tmp_path / "m.glb"))
    assert [w.split()[1] for w in asset.warnings] == ["CESIUM_primitive_outline", "EXT_structural_metadata", "ACME_ok"]
    assert asset.meshes[0].primitives[0].gltf == {"extensions": {"ACME_ok": {"a": 1}}}
    assert asset.document["extensions"] == {"ACME_ok": {}}
    assert asset.document["extensionsUsed"] == ["ACME_ok", "ACME_silent"]
    for name, cause in [
        ("CESIUM_primitive_outline", "is not supported"),
        ("ACME_ok", "is not supported"),
        ("EXT_structural_metadata", "cannot be carried along"),
        ("ACME_silent", "ACME_silent, which is not supported"),
    ]:
        g.tree["extensionsRequired"] = [name]
        with pytest.raises(AssetError, match=cause):
            io.load(g.save(tmp_path / "m.glb"))


@given(st.data())
def test_damage_anywhere_is_an_error_of_ours(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    """Bytes of a valid GLB changed at random: it loads, or it raises one of our errors; nothing else."""
    whole = bytearray(_RICH)
    for _ in range(data.draw(st.integers(1, 8))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / "fuzz.glb"
    path.write_bytes(
        whole[: data.draw(st.integers(len(whole) // 2, len(whole)))] if data.draw(st.booleans()) else whole
    )
    try:
        io.load(path)
    except io.reading.LodpipeError as error:
        assert "\n" not in str(error)


def _rich() -> bytes:
    g = files.rich()
    g.tree["buffers"] = [{"byteLength": len(g.data)}]
    return files.glb(json.dumps(g.tree).encode(), g.data)


_RICH = _rich()


def test_attributes_of_a_form_that_gltf_does_not_know_are_left_out(tmp_path: Path) -> None:
    g = files.Gltf()
    wide, narrow = g.array(files.SQUARE), g.array(np.asarray(files.SQUARE, np.float32)[:, :2].copy())
    odd = {"TEXCOORD_0": wide, "TANGENT": wide, "COLOR_0": narrow, "NORMAL": narrow}
    attributes = {"POSITION": wide, **odd, "_OWN": narrow}
    targets = [{"POSITION": wide, "TANGENT": wide, "NORMAL": narrow}]
    asset = one(tmp_path, {"attributes": attributes, "targets": targets}, g)
    assert set(asset.meshes[0].attributes) == {"_OWN", "MORPH_0_POSITION", "MORPH_0_TANGENT"}
    said = [text for text in asset.warnings if "which glTF does not know" in text]
    assert len(said) == 5 and "TEXCOORD_0 has 3 components" in said[0]


def test_what_follows_the_length_in_the_header_is_no_chunk(tmp_path: Path) -> None:
    g = files.Gltf()
    g.mesh(g.square())
    path = g.save(tmp_path / "m.glb")
    path.write_bytes(path.read_bytes() + b"garbage!" * 10)
    asset = io.load(path)
    assert asset.triangles == 2 and "the file has" in asset.warnings[0]
