from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lodpipe import io
from lodpipe.core.asset import Asset
from lodpipe.core.errors import AssetError
from lodpipe.core.mesh import Mesh
from meshes import box

SQUARE = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
CORNERS = [[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]]


def read(folder: Path, text: str) -> Asset:
    (folder / "m.off").write_text(text)
    return io.load(folder / "m.off")


@pytest.mark.parametrize(
    "text",
    [
        f"OFF\n4 1 0\n{SQUARE}4 0 1 2 3\n",
        f"OFF 4 2 5\n# note\n\n{SQUARE}3 0 1 2\n3 0 2 3 # last\n",
        f"4 1 0\n{SQUARE}4 0 1 2 3\n",
        f"OFF\r\n4 1 0\r\n{SQUARE}4 0 1 2 3",
    ],
)
def test_ways_to_write_a_square(tmp_path: Path, text: str) -> None:
    asset = read(tmp_path, text)
    mesh = asset.meshes[0]
    assert mesh.positions[mesh.faces].tolist() == CORNERS and asset.warnings == ()


def test_variants(tmp_path: Path) -> None:
    asset = read(
        tmp_path,
        "STCNOFF\n3 1 0\n"
        + "".join(f"{p} 0 0 1 255 0 51 0.25 0.25\n" for p in SQUARE.split("\n")[:3])
        + "3 0 1 2 9 9 9\n",
    )
    table = asset.meshes[0].attributes
    assert table["NORMAL"][0].tolist() == [0, 0, 1] and table["TEXCOORD_0"][0].tolist() == [0.25, 0.75]
    assert np.allclose(table["COLOR_0"][0], [1, 0, 0.2])
    assert asset.warnings == ("colours of faces left out",)


def test_round_trip_with_colours(tmp_path: Path) -> None:
    points, faces = box(0.1)
    colours = np.linspace(0, 1, 32).reshape(8, 4).astype(np.float32)
    asset = Asset("x", (Mesh(points, faces, attributes={"COLOR_0": colours}),))
    again = io.load(io.save(asset, tmp_path / "x.off")[0]).meshes[0]
    assert again.positions[again.faces].tolist() == points[faces].tolist()
    assert np.allclose(again.attributes["COLOR_0"][again.wedges], colours[faces], atol=1e-6)


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        ("", "the file is empty"),
        ("OFF\n353535235358 6 0\n1 2 3\n", "353,535,235,358 vertices and 6 faces, but 1 lines follow"),
        ("OFF\nx y z\n", "numbers of vertices and faces"),
        ("OFF BINARY\n", "binary OFF"),
        ("4OFF\n1 1 1\n", "other than 3 dimensions"),
        (f"OFF\n4 1 0\n{SQUARE}5 0 1 2\n", "fewer corners than it says"),
        (f"OFF\n4 1 0\n{SQUARE}-3 0 1 2\n", "fewer corners than it says"),
        (f"OFF\n4 1 0\n{SQUARE}3 0 x 2\n", "words that are no numbers"),
        (f"OFF\n4 1 0\n{SQUARE}3 0 1 1e99\n", "words that are no numbers"),
        ("OFF\n2 1 0\n0 0 0\n0 0\n3 0 1 1\n", "different lengths"),
        ("COFF\n1 1 0\n0 0 0 1\n3 0 0 0\n", "do not make up COFF"),
        (f"OFF\n4 0 0\n{SQUARE}", "no triangles"),
    ],
)
def test_damage_is_one_line(tmp_path: Path, text: str, cause: str) -> None:
    with pytest.raises(AssetError, match=cause):
        read(tmp_path, text)
