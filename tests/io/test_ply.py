from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

import model_files as files
from lodpipe import io
from lodpipe.core.asset import Asset
from lodpipe.core.errors import AssetError
from lodpipe.core.mesh import Mesh

XYZ = "property float x\nproperty float y\nproperty float z\n"
FACES = "property list uchar int vertex_indices\n"
POINTS = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


def read(folder: Path, kind: str, elements: str, body: bytes) -> Asset:
    path = folder / "m.ply"
    path.write_bytes(f"ply\nformat {kind} 1.0\ncomment hi\n{elements}end_header\n".encode() + body)
    return io.load(path)


def corners(asset: Asset) -> list[list[list[float]]]:
    mesh = asset.meshes[0]
    found: list[list[list[float]]] = mesh.positions[mesh.faces].tolist()
    return found


def vertices(order: str, *rows: tuple[float, ...]) -> bytes:
    return b"".join(struct.pack(f"{order}{len(row)}f", *row) for row in rows)


SQUARE = [[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]]


@pytest.mark.parametrize("faces", [[(0, 1, 2, 3)], [(0, 1, 2), (0, 2, 3)], [(0, 1, 2), (0, 1, 2, 3), (0, 2, 3)]])
@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_faces_of_any_size_in_each_encoding(tmp_path: Path, kind: str, faces: list[tuple[int, ...]]) -> None:
    head = f"element vertex 4\n{XYZ}element face {len(faces)}\n{FACES}"
    if kind == "ascii":
        rows = [" ".join(map(str, p)) for p in POINTS] + [f"{len(f)} {' '.join(map(str, f))}" for f in faces]
        body = "\n".join(rows).encode()
    else:
        order = "<" if "little" in kind else ">"
        body = vertices(order, *POINTS) + b"".join(struct.pack(f"{order}B{len(f)}i", len(f), *f) for f in faces)
    asset = read(tmp_path, kind, head, body)
    assert corners(asset) == SQUARE
    assert [w for w in asset.warnings if "doubles" not in w] == []


@pytest.mark.parametrize("count_type", ["uchar", "uint", "int8", "ushort"])
@pytest.mark.parametrize("index_type", ["int", "uint32", "uchar", "short"])
def test_types_of_lists(tmp_path: Path, count_type: str, index_type: str) -> None:
    code = {"uchar": "B", "uint": "I", "int8": "b", "ushort": "H", "int": "i", "uint32": "I", "short": "h"}
    head = f"element vertex 4\n{XYZ}element face 2\nproperty list {count_type} {index_type} vertex_index\n"
    row = f"<{code[count_type]}3{code[index_type]}"
    body = vertices("<", *POINTS) + struct.pack(row, 3, 0, 1, 2) + struct.pack(row, 3, 0, 2, 3)
    assert corners(read(tmp_path, "binary_little_endian", head, body)) == SQUARE


def test_other_elements_and_properties_are_passed_over(tmp_path: Path) -> None:
    head = (
        f"element camera 1\nproperty float f\nproperty list uchar float k\nelement vertex 4\n{XYZ}property uchar q\n"
        f"element face 2\nproperty float area\n{FACES}element edge 1\nproperty int a\n"
    )
    camera = struct.pack("<fB2f", 1, 2, 3, 4)
    rows = b"".join(struct.pack("<3fB", *p, 9) for p in POINTS)
    faces = struct.pack("<fB3i", 0.5, 3, 0, 1, 2) + struct.pack("<fB3i", 0.5, 3, 0, 2, 3)
    asset = read(tmp_path, "binary_little_endian", head, camera + rows + faces + struct.pack("<i", 1))
    assert corners(asset) == SQUARE
    assert asset.warnings == ("vertex properties left out: 'q'", "face properties left out: 'area'")


def test_attributes_of_vertices(tmp_path: Path) -> None:
    head = "element vertex 3\n" + XYZ + "".join(f"property float {n}\n" for n in ("nx", "ny", "nz", "s", "t"))
    head += "".join(f"property uchar {n}\n" for n in ("red", "green", "blue", "alpha")) + f"element face 1\n{FACES}"
    rows = [(*p, 0, 0, 1, 0.25, 0.25, 255, 0, 51, 255) for p in POINTS[:3]]
    for kind in ("ascii", "binary_little_endian"):
        body = b"".join(
            " ".join(map(str, r)).encode() + b"\n" if kind == "ascii" else struct.pack("<8f4B", *r) for r in rows
        )
        face = b"3 0 1 2\n" if kind == "ascii" else struct.pack("<B3i", 3, 0, 1, 2)
        table = read(tmp_path, kind, head, body + face).meshes[0].attributes
        assert table["NORMAL"][0].tolist() == [0, 0, 1]
        assert table["TEXCOORD_0"][0].tolist() == [0.25, 0.75]
        assert np.allclose(table["COLOR_0"][0], [1, 0, 0.2, 1])


def test_corner_uvs_and_texture_as_meshlab_writes_them(tmp_path: Path) -> None:
    (tmp_path / "my tex.png").write_bytes(files.png())
    head = f"comment TextureFile my tex.png\nelement vertex 4\n{XYZ}element face 2\n{FACES}"
    head += "property list uchar float texcoord\nproperty int texnumber\n"
    uvs = [(0, 0, 1, 0, 1, 1), (0.5, 0, 1, 1, 0, 1)]
    faces = [struct.pack("<B3iB6fi", 3, *f, 6, *uv, 0) for f, uv in zip([(0, 1, 2), (0, 2, 3)], uvs, strict=True)]
    asset = read(tmp_path, "binary_little_endian", head, vertices("<", *POINTS) + b"".join(faces))
    mesh = asset.meshes[0]
    assert corners(asset) == SQUARE and len(mesh.positions) == 4 and mesh.wedge_count == 5
    assert mesh.attributes["TEXCOORD_0"][mesh.wedges].tolist() == [
        [[0, 1], [1, 1], [1, 0]],
        [[0.5, 1], [1, 0], [0, 0]],
    ]
    assert asset.materials[0].base_color_texture is not None and asset.images[0].data == files.png()
    assert asset.warnings == ()


def test_triangle_strips(tmp_path: Path) -> None:
    head = f"element vertex 5\n{XYZ}element tristrips 1\nproperty list int int vertex_indices\n"
    strip = [0, 1, 3, 2, -1, 0, 1, 1, 4, -1, 2, 3, 4]
    body = vertices("<", *POINTS, (2, 2, 1)) + struct.pack(f"<i{len(strip)}i", len(strip), *strip)
    mesh = read(tmp_path, "binary_little_endian", head, body).meshes[0]
    want = [[0, 1, 3], [3, 1, 2], [2, 3, 4]]
    points = np.array([*POINTS, (2, 2, 1)], float)
    assert mesh.positions[mesh.faces].tolist() == points[want].tolist()


@pytest.mark.parametrize(
    ("head", "body", "cause"),
    [
        (f"element vertex 1000000\n{XYZ}", vertices("<", *POINTS), "1,000,000 rows of 'vertex'"),
        (f"element vertex 4\n{XYZ}element face 9\n{FACES}", vertices("<", *POINTS) + b"\3", "rows of 'face'"),
        (f"element vertex 4\n{XYZ}element face 1\n{FACES}", vertices("<", *POINTS) + b"\xff", "of 'face'"),
        (f"element vertex 4\n{XYZ}", vertices("<", *POINTS), "no triangles"),
        ("element vertex 4\nproperty float x\n", bytes(16), "no vertex element with x, y and z"),
        ("element vertex -4\n", b"", "negative count"),
        ("element vertex four\n", b"", "'element vertex four' cannot be understood"),
        ("property float x\n", b"", "'property float x' cannot be understood"),
        ("element vertex 4\nproperty half x\n", b"", "'property half x' cannot be understood"),
    ],
)
def test_damage_is_one_line(tmp_path: Path, head: str, body: bytes, cause: str) -> None:
    with pytest.raises(AssetError, match=cause):
        read(tmp_path, "binary_little_endian", head, body)


def test_text_that_ends_early(tmp_path: Path) -> None:
    head = f"element vertex 4\n{XYZ}element face 2\n{FACES}"
    for body in (b"0 0 0 1 0 0", b"0 0 0 1 0 0 1 1 0 0 1 0 3 0 1 2 3 0", b"0 0 0 1 0 0 1 1 0 0 1 0 x 0 1 2 3 0 1 2"):
        with pytest.raises(AssetError, match="cut off or damaged"):
            read(tmp_path, "ascii", head, body)


def test_round_trip(tmp_path: Path) -> None:
    g = files.Gltf()
    square = g.square(material=0)
    square["attributes"]["COLOR_0"] = g.array(np.arange(12, dtype=np.uint8).reshape(4, 3) * 20, normalized=True)
    g.mesh(square)
    g.tree["images"] = [{"bufferView": g.view(files.png()), "name": "skin"}]
    g.tree["textures"] = [{"source": 0}]
    g.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    asset = io.load(g.save(tmp_path / "m.glb"))
    said: list[str] = []
    written = io.save(asset, tmp_path / "m.ply", warn=said.append)
    assert [p.name for p in written] == ["m.ply", "skin.png"] and said == []
    again = io.load(written[0])
    assert corners(again) == corners(asset)
    one, two = asset.meshes[0], again.meshes[0]
    for name in ("NORMAL", "TEXCOORD_0", "COLOR_0"):
        assert np.array_equal(one.attributes[name][one.wedges], two.attributes[name][two.wedges]), name
    assert again.images[0].data == files.png()


def test_doubles_are_kept_where_floats_would_not_do(tmp_path: Path) -> None:
    points = np.array(POINTS, float) * 0.1 + 3e7
    asset = Asset("x", (Mesh(points, [[0, 1, 2], [0, 2, 3]]),))
    again = io.load(io.save(asset, tmp_path / "x.ply")[0])
    assert np.array_equal(again.meshes[0].positions, points)
