from __future__ import annotations

import copy
import dataclasses
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import model_files as files
from lodpipe import io
from lodpipe.core.asset import Asset
from lodpipe.core.errors import InvalidMesh, OutputError
from lodpipe.core.material import Image
from lodpipe.core.mesh import Mesh, Primitive

ErrorsOf = Callable[[list[Path]], dict[str, list[str]]]


def json_of(path: Path) -> dict[str, Any]:
    data = path.read_bytes()
    if path.suffix == ".gltf":
        return dict(json.loads(data))
    return dict(json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]]))


def without_arrays(asset: Asset) -> dict[str, Any]:
    """All of an asset's JSON, with the content of accessors in the place of their numbers."""

    def content(row: int) -> Any:
        return asset.accessors[row].values.tolist()

    tree = copy.deepcopy(dict(asset.document))
    tree["asset"].pop("generator", None)
    for skin in tree.get("skins", ()):
        skin["inverseBindMatrices"] = content(skin["inverseBindMatrices"])
    for animation in tree.get("animations", ()):
        for sampler in animation["samplers"]:
            sampler.update(input=content(sampler["input"]), output=content(sampler["output"]))
    for node in tree["nodes"]:
        for said in node.get("extensions", {}).get("EXT_mesh_gpu_instancing", {}).values():
            said.update({name: content(row) for name, row in said.items()})
    for mesh in tree.get("meshes", ()):
        for line in mesh.get("primitives", ()):
            line["attributes"] = {name: content(row) for name, row in line["attributes"].items()}
            line["indices"] = content(line["indices"])
    tree["materials"] = [dict(m.gltf) for m in asset.materials]
    return tree


def corners(mesh: Mesh) -> list[Any]:
    """What each corner of each face looks like, whatever the order of the vertices."""
    columns = [mesh.positions[mesh.faces]]
    columns += [mesh.attributes[name][mesh.wedges] for name in sorted(mesh.attributes)]
    return [c.tolist() for c in columns]


def assert_same(a: Asset, b: Asset) -> None:
    assert without_arrays(a) == without_arrays(b)
    assert [(i.data, i.mime_type) for i in a.images] == [(i.data, i.mime_type) for i in b.images]
    assert len(a.meshes) == len(b.meshes)
    for one, two in zip(a.meshes, b.meshes, strict=True):
        assert (one.name, one.keep_reason, one.primitives) == (two.name, two.keep_reason, two.primitives)
        assert set(one.attributes) == set(two.attributes)
        assert corners(one) == corners(two)
        assert one.wedge_count == two.wedge_count and len(one.positions) == len(two.positions)


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_the_whole_document_survives(tmp_path: Path, suffix: str, errors_of: ErrorsOf) -> None:
    source = files.rich().save(tmp_path / f"rich.{suffix}")
    asset = io.load(source)
    out = tmp_path / "out"
    out.mkdir()
    written = io.save(asset, out / f"rich.{suffix}")
    assert_same(asset, io.load(written[0]))
    assert errors_of([source]) == {source.name: []}, "the test's own file must be valid"
    assert errors_of(written[:1]) == {written[0].name: []}


def test_without_the_validator_the_document_survives_too(tmp_path: Path) -> None:
    asset = io.load(files.rich().save(tmp_path / "rich.glb"))
    assert_same(asset, io.load(io.save(asset, tmp_path / "again.glb")[0]))


def test_same_bytes_twice(tmp_path: Path) -> None:
    asset = io.load(files.rich().save(tmp_path / "rich.glb"))
    one, two = (io.save(asset, tmp_path / name)[0].read_bytes() for name in ("one.glb", "two.glb"))
    assert one == two


def test_gltf_has_its_images_beside_it_under_safe_names(tmp_path: Path) -> None:
    g = files.Gltf()
    g.mesh(g.square(material=0))
    names = ["../../up.png", "con.png", "a b?.png", "a b?.png", "same.png"]
    g.tree["images"] = [{"bufferView": g.view(files.png(2 + i % 4))} for i in range(5)]
    g.tree["textures"] = [{"source": i} for i in range(5)]
    slots = [{"index": i} for i in range(4)]
    g.tree["materials"] = [
        {
            "pbrMetallicRoughness": {"baseColorTexture": slots[0], "metallicRoughnessTexture": slots[1]},
            "normalTexture": slots[2],
            "occlusionTexture": slots[3],
            "emissiveTexture": {"index": 4},
        }
    ]
    asset = io.load(g.save(tmp_path / "source.gltf"))
    asset = dataclasses.replace(
        asset, images=tuple(dataclasses.replace(i, uri=n) for i, n in zip(asset.images, names, strict=True))
    )
    out = tmp_path / "out"
    out.mkdir()
    written = io.save(asset, out / "model.gltf")
    assert [p.name for p in written] == [
        "model.gltf",
        "model.bin",
        "up.png",
        "_con.png",
        "a b_.png",
        "a b__1.png",
    ]
    assert all(p.parent == out for p in written)
    assert json_of(written[0])["images"][4]["uri"] == "up.png", "equal bytes are written once"
    assert [i.data for i in io.load(written[0]).images] == [i.data for i in asset.images]


def test_a_broken_image_leaves_with_the_slots_that_use_it(tmp_path: Path, errors_of: ErrorsOf) -> None:
    asset = io.load(files.rich().save(tmp_path / "rich.glb"))
    broken = Image(problem="gone")
    asset = dataclasses.replace(asset, images=(asset.images[0], broken, asset.images[2]))
    (path,) = io.save(asset, tmp_path / "out.glb")
    tree = json_of(path)
    paint = tree["materials"][0]
    assert "normalTexture" not in paint
    assert len(tree["images"]) == len(tree["textures"]) == 2
    assert tree["textures"][1] == {"source": 0, "extensions": {"EXT_texture_webp": {"source": 1}}}
    assert paint["extensions"]["KHR_materials_clearcoat"]["clearcoatTexture"] == {"index": 1}
    assert errors_of([path]) == {"out.glb": []}


def test_a_texture_format_beyond_png_and_jpeg_names_its_extension(tmp_path: Path, errors_of: ErrorsOf) -> None:
    webp = Image(files.image(4, 4, "RGB", "WEBP"), "image/webp", "w")
    bmp = Image(files.image(4, 4, "RGB", "BMP"), "image/bmp", "b", "wall.bmp")
    document = {"textures": [{"source": 0}, {"source": 1}], "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}]}
    mesh = Mesh(files.SQUARE, files.SQUARE_FACES.reshape(-1, 3).astype(int))
    (path,) = io.save(Asset("x", (mesh,), images=(webp, bmp), document=document), tmp_path / "x.glb")
    tree = json_of(path)
    assert tree["textures"] == [{"extensions": {"EXT_texture_webp": {"source": 0}}}, {"source": 1}]
    assert tree["extensionsRequired"] == ["EXT_texture_webp"]
    assert [i["mimeType"] for i in tree["images"]] == ["image/webp", "image/png"]
    assert errors_of([path]) == {"x.glb": []}
    pixels = [io.decode_image(i) for i in (bmp, io.load(path).images[1])]
    assert np.array_equal(*pixels)


def test_indices_are_short_up_to_the_reserved_one(tmp_path: Path) -> None:
    for count, code in ((65535, 5123), (65538, 5125)):
        points = np.arange(count * 3, dtype=float).reshape(-1, 3) ** 1.5 / 1e4
        mesh = Mesh(points.astype(np.float32), np.arange(count).reshape(-1, 3))
        (path,) = io.save(Asset("x", (mesh,)), tmp_path / "x.glb")
        tree = json_of(path)
        row = tree["meshes"][0]["primitives"][0]["indices"]
        assert tree["accessors"][row]["componentType"] == code
        assert tree["accessors"][row]["count"] == count


def test_vertices_are_in_the_order_of_the_faces_and_unused_ones_go(tmp_path: Path) -> None:
    points = np.arange(30, dtype=float).reshape(10, 3) ** 2
    mesh = Mesh(points, [[7, 2, 9], [9, 2, 4]])
    (path,) = io.save(Asset("x", (mesh,)), tmp_path / "x.glb")
    tree = json_of(path)
    data = path.read_bytes()
    start = data.index(b"BIN\0") + 4
    stored = np.frombuffer(data, "<f4", 12, start + tree["bufferViews"][0]["byteOffset"]).reshape(-1, 3)
    assert np.array_equal(stored, points[[7, 2, 9, 4]])


def test_values_are_made_valid(tmp_path: Path, errors_of: ErrorsOf) -> None:
    bad = {
        "NORMAL": np.array([[0, 0, 5], [0, 0, 0], [np.nan, 0, 0], [0, 0, 1]], np.float32),
        "TANGENT": np.array([[2, 0, 0, 1], [0, 0, 0, 0], [1, 0, 0, -3], [1, 0, 0, -1]], np.float32),
        "COLOR_0": np.array([[-1, 0, 0], [2, 0, 0], [0.3, 0, 0], [1, 1, 1]], np.float32),
        "TEXCOORD_0": np.array([[np.inf, 0], [0, 1], [1, 1], [1, 0]], np.float32),
    }
    mesh = Mesh(files.SQUARE, files.SQUARE_FACES.reshape(-1, 3).astype(int), attributes=bad)
    said: list[str] = []
    (path,) = io.save(Asset("x", (mesh,)), tmp_path / "x.glb", warn=said.append)
    assert errors_of([path]) == {"x.glb": []}
    assert any("NORMAL" in s for s in said) and any("TEXCOORD_0" in s for s in said)
    again = io.load(path).meshes[0].attributes
    assert np.allclose(again["NORMAL"], [0, 0, 1])
    assert np.allclose(np.linalg.norm(again["TANGENT"][:, :3], axis=1), 1)
    assert set(again["TANGENT"][:, 3].tolist()) == {1.0, -1.0}


@pytest.mark.parametrize(("top", "code"), [(255, 5121), (65535, 5123), (0, 5126)])
def test_colours_take_the_smallest_type_without_loss(tmp_path: Path, top: int, code: int) -> None:
    colours = np.linspace(0, 1, 12).reshape(4, 3)
    colours = np.rint(colours * top) / top if top else colours**3
    mesh = Mesh(files.SQUARE, files.SQUARE_FACES.reshape(-1, 3).astype(int), attributes={"COLOR_0": colours})
    (path,) = io.save(Asset("x", (mesh,)), tmp_path / "x.glb")
    tree = json_of(path)
    assert tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]["componentType"] == code
    assert np.array_equal(io.load(path).meshes[0].attributes["COLOR_0"], colours.astype(np.float32))


def test_a_mesh_that_lost_all_faces_leaves_its_nodes(tmp_path: Path, errors_of: ErrorsOf) -> None:
    asset = io.load(files.rich().save(tmp_path / "rich.glb"))
    gone = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    (path,) = io.save(asset, tmp_path / "out.glb", meshes=(asset.meshes[0], gone, asset.meshes[2]))
    tree = json_of(path)
    assert [m["name"] for m in tree["meshes"]] == ["panel", "tile"]
    assert tree["nodes"][1] == {"name": "body"} and tree["nodes"][5]["mesh"] == 1
    assert [len(a["channels"]) for a in tree["animations"]] == [1], "no channel for the weights of a mesh that is gone"
    assert errors_of([path]) == {"out.glb": []}
    with pytest.raises(OutputError, match="no triangles"):
        io.save(asset, path, meshes=(gone, gone, gone))
    with pytest.raises(InvalidMesh, match="1 meshes are given for an asset of 3"):
        io.save(asset, path, meshes=(gone,))


def test_a_far_model_keeps_its_shape(tmp_path: Path, errors_of: ErrorsOf) -> None:
    far = files.SQUARE.astype(float) * 0.1 + (3e7, -2e7, 5e6)
    mesh = Mesh(far, files.SQUARE_FACES.reshape(-1, 3).astype(int), name="house")
    nodes = [{"mesh": 0, "scale": [2, 2, 2], "children": [1], "name": "n"}, {}]
    asset = Asset("x", (mesh,), document={"nodes": nodes, "scenes": [{"nodes": [0]}], "scene": 0})
    said: list[str] = []
    (path,) = io.save(asset, tmp_path / "x.glb", warn=said.append)
    assert len(said) == 1 and "far from the origin" in said[0]
    again = io.load(path)
    world = [m[:3, :3] @ again.meshes[i].positions.T + m[:3, 3:] for i, m in again.instances()]
    assert np.abs(world[0].T - far * 2).max() < 1e-6
    assert errors_of([path]) == {"x.glb": []}


def test_what_float32_cannot_hold_is_refused(tmp_path: Path) -> None:
    for scale in (1e60, 1e-60):
        mesh = Mesh(files.SQUARE.astype(float) * scale, files.SQUARE_FACES.reshape(-1, 3).astype(int))
        with pytest.raises(OutputError, match="do not fit in glTF's 32-bit floats"):
            io.save(Asset("x", (mesh,)), tmp_path / "x.glb")


def test_a_wedge_of_two_positions_is_refused(tmp_path: Path) -> None:
    uv = {"TEXCOORD_0": files.SQUARE_UV}
    mesh = Mesh(files.SQUARE, [[0, 1, 2], [0, 2, 3]], wedges=[[0, 1, 2], [1, 2, 3]], attributes=uv)
    with pytest.raises(InvalidMesh, match="belongs to two positions"):
        io.save(Asset("x", (mesh,)), tmp_path / "x.glb")


def test_a_primitive_writes_its_own_attributes_only(tmp_path: Path) -> None:
    uv = {"TEXCOORD_0": np.vstack([files.SQUARE_UV, files.SQUARE_UV])}
    parts = (Primitive(attributes=("TEXCOORD_0",)), Primitive(attributes=()))
    faces = files.SQUARE_FACES.reshape(-1, 3).astype(int)
    mesh = Mesh(files.SQUARE, faces, [[0, 1, 2], [4, 6, 7]], uv, [0, 1], parts)
    (path,) = io.save(Asset("x", (mesh,)), tmp_path / "x.glb")
    first, second = json_of(path)["meshes"][0]["primitives"]
    assert set(first["attributes"]) == {"POSITION", "TEXCOORD_0"} and set(second["attributes"]) == {"POSITION"}
    assert io.load(path).meshes[0].primitives == parts


def test_files_that_cannot_be_written_are_one_line(tmp_path: Path) -> None:
    mesh = Mesh(files.SQUARE, [[0, 1, 2]])
    (tmp_path / "folder.glb").mkdir()
    with pytest.raises(OutputError, match=r"folder\.glb cannot be written"):
        io.save(Asset("x", (mesh,)), tmp_path / "folder.glb")
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputError, match="the folder cannot be made"):
        io.save(Asset("x", (mesh,)), tmp_path / "file" / "x.glb")
    with pytest.raises(OutputError, match="not a model format"):
        io.save(Asset("x", (mesh,)), tmp_path / "x.fbx")


@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.sampled_from(["glb", "gltf"]))
def test_any_mesh_comes_back(tmp_path_factory: pytest.TempPathFactory, seed: int, parts: int, suffix: str) -> None:
    """Random faces, wedges and primitives: each corner keeps its place and its values."""
    rng = np.random.default_rng(seed)
    count, rows = int(rng.integers(1, 40)), int(rng.integers(3, 20))
    points = rng.normal(size=(rows, 3)).astype(np.float32)
    faces = np.array([rng.choice(rows, 3, replace=False) for _ in range(count)])
    faces = faces[np.sort(np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1])]
    owner = np.sort(rng.integers(0, parts, len(faces)))
    # a wedge for each position and primitive, and one more for every other face
    wedges = faces + rows * (2 * owner + np.arange(len(faces)) % 2)[:, None]
    values = {
        "TEXCOORD_0": rng.normal(size=(rows * 2 * parts, 2)),
        "COLOR_0": rng.random(size=(rows * 2 * parts, 3)) ** 3,
        "_ID": rng.integers(0, 1 << 20, (rows * 2 * parts, 1)),
    }
    uses = [tuple(n for n in values if rng.random() < 0.5) for _ in range(parts)]
    primitives = tuple(Primitive(None, names) for names in uses)
    mesh = Mesh(points, faces, wedges, values, owner, primitives, "m")
    path = tmp_path_factory.getbasetemp() / f"any.{suffix}"
    again = io.load(io.save(Asset("x", (mesh,)), path)[0]).meshes[0]
    assert np.array_equal(again.positions[again.faces], points[faces])
    there = np.unique(owner).tolist()
    for new, old in enumerate(there):
        assert again.primitives[new].attributes == uses[old]
        for name in uses[old]:
            got = again.attributes[name][again.wedges[again.face_primitive == new]]
            assert np.array_equal(got, mesh.attributes[name][wedges[owner == old]]), name
