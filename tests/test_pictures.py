"""The script that makes the documentation's pictures."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lodpipe.core.asset import Asset
from lodpipe.core.mesh import Mesh
from lodpipe.io import save
from meshes import sphere

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("make_pictures", ROOT / "docs" / "make_pictures.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_sheet_for_each_asset(script, tmp_path):
    for name in ("one", "two"):
        save(Asset(name, (Mesh(*sphere(3)),)), tmp_path / f"{name}.glb")
    script.main(["-o", str(tmp_path / "out"), "--size", "40", str(tmp_path / "one.glb"), str(tmp_path / "two.glb")])
    for name in ("one", "two"):
        with Image.open(tmp_path / "out" / f"{name}.png") as opened:
            picture = np.asarray(opened)
        assert picture.shape[1] == 5 * 48 + 8  # the source and four levels
        tiles = [picture[8:48, 8 + 48 * k : 48 + 48 * k].astype(int) for k in range(5)]
        assert min(tile.std() for tile in tiles) > 10
        assert np.abs(tiles[0] - tiles[4]).mean() > np.abs(tiles[0] - tiles[1]).mean()


def test_the_readmes_picture_is_small():
    path = ROOT / "docs" / "images" / "lods.png"
    assert path.stat().st_size < 300_000
    with Image.open(path) as picture:
        assert picture.size[0] > 1000
