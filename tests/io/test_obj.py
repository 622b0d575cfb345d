from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import model_files as files
from lodpipe import io
from lodpipe.core.asset import Asset
from lodpipe.core.errors import AssetError
from lodpipe.kernel import tables

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
UVS = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"


def read(folder: Path, text: str | bytes, **beside: bytes | str) -> Asset:
    for name, data in {"m.obj": text, **{k.replace("__", "."): v for k, v in beside.items()}}.items():
        (folder / name).write_bytes(data.encode() if isinstance(data, str) else data)
    return io.load(folder / "m.obj")


def shape(asset: Asset) -> list[list[list[float]]]:
    mesh = asset.meshes[0]
    found: list[list[list[float]]] = mesh.positions[mesh.faces].tolist()
    return found


@pytest.mark.parametrize(
    "faces",
    [
        "f 1 2 3 4",
        "f -4 -3 -2 -1",
        "f 1 2 3\nf 1 3 4",
        "f 1/1 2/2 3/3 4/4\n" + UVS,
        "f 1//1 2//1 3//1 4//1\nvn 0 0 1",
        "f 1 2/ 3// 4//\n",
        "f 1 2 \\\n 3 4",
        "  f\t1 2 3 4  \r",
        "f 1 2 3 # half\nf 1 3 4#half",
    ],
)
def test_ways_to_write_a_square(tmp_path: Path, faces: str) -> None:
    asset = read(tmp_path, SQUARE + faces)
    a, b, c, d = [0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]
    assert shape(asset) == [[a, b, c], [a, c, d]]
    assert asset.warnings == () and asset.format == "obj" and asset.members == (tmp_path / "m.obj",)


def test_v_counts_from_the_top_and_seams_are_wedges(tmp_path: Path) -> None:
    asset = read(tmp_path, SQUARE + UVS + "vt 5 0.25\nvn 0 0 1\nf 1/1/1 2/2/1 3/3/1\nf 1/5/1 3/3/1 4/4/1\n")
    mesh = asset.meshes[0]
    assert len(mesh.positions) == 4 and mesh.wedge_count == 5
    assert mesh.attributes["TEXCOORD_0"][mesh.wedges[1]].tolist() == [[5, 0.75], [1, 0], [0, 0]]
    assert (mesh.attributes["NORMAL"] == [0, 0, 1]).all()


def test_negative_indices_count_from_where_they_stand(tmp_path: Path) -> None:
    asset = read(tmp_path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 0 0 5\nv 1 0 5\nv 0 1 5\nf -3 -2 -1\n")
    assert [face[0][2] for face in shape(asset)] == [0, 5]


def test_each_material_is_a_primitive_and_borders_stay_connected(tmp_path: Path) -> None:
    mtl = "newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n"
    text = "mtllib m.mtl\n" + SQUARE + "f 1 2 3\nusemtl blue\nf 1 3 4\nusemtl red\nf 2 3 4\nusemtl blue\nf 1 2 4\n"
    asset = read(tmp_path, text, m__mtl=mtl)
    mesh = asset.meshes[0]
    assert [p.material for p in mesh.primitives] == [None, 0, 1]
    assert np.bincount(mesh.face_material + 1).tolist() == [1, 1, 2]
    assert len(mesh.positions) == 4
    assert [m.name for m in asset.materials] == ["red", "blue"]
    assert asset.members == (tmp_path / "m.obj", tmp_path / "m.mtl")


def test_objects_are_meshes_unless_they_share_vertices(tmp_path: Path) -> None:
    far = SQUARE.replace(" 0\n", " 9\n")
    apart = read(tmp_path, f"o near\n{SQUARE}f 1 2 3 4\no far\n{far}f 5 6 7 8\no near\nf 4 3 2 1\n")
    assert [(m.name, len(m.faces)) for m in apart.meshes] == [("near", 4), ("far", 2)]
    assert [n["name"] for n in apart.document["nodes"]] == ["near", "far"]
    shared = read(tmp_path, f"o a\n{SQUARE}f 1 2 3\no b\nf 1 3 4\n")
    assert [(m.name, len(m.faces)) for m in shared.meshes] == [("", 2)]


def test_vertex_colours(tmp_path: Path) -> None:
    asset = read(tmp_path, "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0\nf 1 2 3\n")
    mesh = asset.meshes[0]
    assert mesh.attributes["COLOR_0"][mesh.wedges[0]].tolist() == [[1, 0, 0], [0, 1, 0], [1, 1, 1]]


def test_faces_that_make_no_sense_are_counted(tmp_path: Path) -> None:
    asset = read(tmp_path, SQUARE + UVS + "f 1 2 3\nf 1 2f 3\nf 1/1/1/1 2 3\nf 0 1 2\nf 1 2\nf 1 2 77\nf 1/9 3/3 4/4\n")
    assert len(asset.meshes[0].faces) == 2
    assert len(asset.warnings) == 4
    assert "2 face lines that are not made of indices" in asset.warnings[0]
    assert "1 face with fewer than three corners" in asset.warnings[1]
    assert "2 faces with an index out of range" in asset.warnings[2]
    assert "1 corners name a vt that is not there" in asset.warnings[3]


def test_lines_and_points_are_named(tmp_path: Path) -> None:
    asset = read(tmp_path, SQUARE + "f 1 2 3\nl 1 2\nl 2 3\np 1\n")
    assert asset.warnings == ("2 lines left out", "1 points left out")


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        ("", "it has no vertices"),
        ("v 1 2 3\n", "no triangles"),
        ("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no area"),
        ("ply\nformat ascii 1.0\n", "it is a PLY file; rename it to .ply"),
        (b"v 1 2 3\n" + bytes(200), "binary data"),
    ],
)
def test_what_is_no_model_is_one_line(tmp_path: Path, text: str | bytes, cause: str) -> None:
    with pytest.raises((AssetError, io.reading.InvalidMesh), match=cause) as caught:
        read(tmp_path, text)
    assert str(caught.value).startswith("m.obj: ") and "\n" not in str(caught.value)


def test_round_trip(tmp_path: Path) -> None:
    mtl = "newmtl a\nKd 1 0.5 0\nmap_Kd t.png\nnewmtl b\nKd 0 0 1\n"
    uvs = "vt 0.1 0.2\nvt 3 -1\nvt 0.5 0.5\n"
    text = f"mtllib m.mtl\n{SQUARE}v 0.1 0.2 1e-7\n{uvs}usemtl a\nf 1/1 2/2 3/3\nusemtl b\nf 1/3 3/3 5/2\n"
    asset = read(tmp_path, text, m__mtl=mtl, t__png=files.png())
    out = tmp_path / "out"
    out.mkdir()
    written = io.save(asset, out / "m.obj")
    assert [p.name for p in written] == ["m.obj", "m.mtl", "t.png"]
    again = io.load(written[0])
    assert shape(asset) == shape(again)
    one, two = asset.meshes[0], again.meshes[0]
    assert np.allclose(one.attributes["TEXCOORD_0"][one.wedges], two.attributes["TEXCOORD_0"][two.wedges], atol=1e-7)
    assert one.primitives == two.primitives and one.wedge_count == two.wedge_count
    assert [m.base_color_factor for m in again.materials] == [(1, 0.5, 0, 1), (0, 0, 1, 1)]
    assert again.images[0].data == files.png()


def test_the_node_tree_is_applied_when_an_obj_is_written(tmp_path: Path) -> None:
    g = files.Gltf()
    g.mesh(g.square())
    g.tree["nodes"] = [{"children": [1, 2], "translation": [10, 0, 0]}, {"mesh": 0}, {"mesh": 0, "scale": [-1, 1, 1]}]
    asset = io.load(g.save(tmp_path / "m.glb"))
    said: list[str] = []
    again = io.load(io.save(asset, tmp_path / "m.obj", warn=said.append)[0])
    assert len(again.meshes) == 2 and len(said) == 1 and "node tree" in said[0]
    for mesh in again.meshes:
        a, b, c = (mesh.positions[mesh.faces[:, k]] for k in range(3))
        assert (np.cross(b - a, c - a)[:, 2] > 0).all(), "a mirrored copy must be turned to face outwards"
        assert (mesh.attributes["NORMAL"] == [0, 0, 1]).all()
    assert sorted(p for m in again.meshes for p in m.positions[:, 0]) == [9, 9, 10, 10, 10, 10, 11, 11]


ODD_WORDS = [
    "1",
    "2",
    "-1",
    "1/1",
    "2/2/2",
    "3//1",
    "1/",
    "2/1/",
    "/1",
    "1//",
    "nan",
    "inf",
    "1e3",
    "+",
    "-",
    ".5",
    "5.",
    "1e400",
    "x",
    "99999999999",
    "1.5",
    "--1",
    "1_0",
    "0",
    "-0",
    "1/2/3/4",
    "#c",
    "1.0.0",
    "3/-1/-1",
    "9223372036854775808",
    "2147483648",
    "infinity",
    "1,0",
]
LINES = st.one_of(
    st.tuples(st.sampled_from(["v", "vt", "vn"]), st.lists(st.sampled_from(["0", "1", "-.5", "2e0"]), max_size=7)),
    st.tuples(
        st.just("f"), st.lists(st.sampled_from(["1", "2", "3/1", "4//1", "-1", "-2/-1"]), min_size=2, max_size=5)
    ),
    st.tuples(st.sampled_from(["v", "f", "vt", "o", "usemtl", "#"]), st.lists(st.sampled_from(ODD_WORDS), max_size=6)),
)


@settings(max_examples=80, deadline=None)
@given(st.lists(LINES, max_size=10), st.sampled_from(["\n", "\r\n", " \n\t"]))
def test_the_quick_reader_and_the_careful_one_agree(rows: list[tuple[str, list[str]]], end: str) -> None:
    """Words that are not plain are left to array operations in Python; those can read all the others as well."""
    square = "v 0 0 0|v 1 0 0|v 1 1 0|v 0 1 0|vt 0 0|vn 0 0 1|f 1 2 3".replace("|", end)
    text = end.join([square, *(" ".join([keyword, *words]) for keyword, words in rows)])
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        path = Path(folder, "m.obj")
        path.write_bytes(text.encode())
        quick = io.load(path)
        for name in ("text_numbers", "text_corners"):
            patch.setattr(tables, name, lambda *args: None)
        careful = io.load(path)
    assert (quick.fingerprint(), quick.warnings) == (careful.fingerprint(), careful.warnings)
