from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from lodpipe import io
from lodpipe.core.asset import Asset
from lodpipe.core.errors import AssetError
from lodpipe.core.mesh import Mesh
from meshes import box

TEXT = """solid cube
 facet normal 0 0 1
  outer loop
   vertex 0 0 0
   vertex 1e0 0 0
   vertex 0 1 -0
  endloop
 endfacet
endsolid cube
"""


def facets(count: int, said: int | None = None, head: bytes = b"") -> bytes:
    one = struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0)
    return head.ljust(80, b"\0") + struct.pack("<I", count if said is None else said) + one * count


@pytest.mark.parametrize("data", [TEXT.encode(), TEXT.upper().encode(), facets(1), facets(1, head=b"solid but binary")])
def test_one_facet(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "m.stl").write_bytes(data)
    asset = io.load(tmp_path / "m.stl")
    mesh = asset.meshes[0]
    assert mesh.positions[mesh.faces].tolist() == [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]
    assert asset.warnings == () and asset.format == "stl"


def test_a_soup_is_welded_and_comes_back(tmp_path: Path) -> None:
    points, faces = box()
    (path,) = io.save(Asset("box", (Mesh(points, faces),)), tmp_path / "box.stl")
    mesh = io.load(path).meshes[0]
    assert len(mesh.positions) == 8
    assert mesh.positions[mesh.faces].tolist() == points[faces].tolist()
    normals = np.frombuffer(path.read_bytes(), np.dtype([("n", "<f4", 3), ("v", "<f4", 9), ("f", "<u2")]), 12, 84)["n"]
    assert (np.einsum("fk,fk->f", normals, points[faces].mean(axis=1)) > 0).all()
    assert np.allclose(np.linalg.norm(normals, axis=1), 1)


@pytest.mark.parametrize(
    ("data", "cause"),
    [
        (b"", "the file is empty"),
        (b"x" * 20, "cut off in its header"),
        (facets(2, said=4_000_000_000), "says 4,000,000,000 facets, but there is data for 2"),
        (facets(2, said=4_000_000_000, head=b"solid"), "says 4,000,000,000 facets"),
        (TEXT.replace("   vertex 1e0 0 0\n", "").encode(), "not threes of three numbers"),
        (TEXT.replace("1e0 0 0", "1e0 0").encode(), "not threes of three numbers"),
        (facets(0), "no triangles"),
    ],
)
def test_damage_is_one_line(tmp_path: Path, data: bytes, cause: str) -> None:
    (tmp_path / "m.stl").write_bytes(data)
    with pytest.raises(AssetError, match=cause):
        io.load(tmp_path / "m.stl")


def test_what_is_odd_is_named(tmp_path: Path) -> None:
    (tmp_path / "m.stl").write_bytes(TEXT.replace("endsolid cube", "").encode())
    assert "endsolid, is missing" in io.load(tmp_path / "m.stl").warnings[0]
    (tmp_path / "m.stl").write_bytes(facets(1) + b"more")
    assert "4 bytes after the last facet" in io.load(tmp_path / "m.stl").warnings[0]
