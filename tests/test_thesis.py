"""The script that makes the tables and pictures of docs/thesis.md."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lodpipe.core.asset import Asset
from lodpipe.core.mesh import Mesh
from lodpipe.io import save
from meshes import bumpy

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("make_thesis", ROOT / "docs" / "make_thesis.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["make_thesis"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def test_a_striped_model_is_measured(script, tmp_path):
    save(Asset("ball", (Mesh(*bumpy(3)),)), tmp_path / "ball.glb")
    asset = script.striped(tmp_path / "ball.glb", 300)
    assert asset.triangles <= 300 and "TEXCOORD_0" in asset.meshes[0].attributes
    case = script.Case.of(asset, [script.SCENE, script.QEM], (100, 40))
    lines = script.distance_table(case).splitlines()
    assert len(lines) == 4 and lines[2].startswith(f"| {script.SCENE} |")
    assert case.loss(script.SCENE, 40, lambda p: p[:, 2] > 0) > case.loss(script.SCENE, 100, lambda p: p[:, 2] > 0) > 0


def test_tables_replace_what_stands_between_their_marks(script, tmp_path):
    page = tmp_path / "page.md"
    page.write_text("above\n<!-- a -->\nold\n<!-- end of a -->\nbelow\n")
    script.insert(page, {"a": "new"})
    assert page.read_text() == "above\n<!-- a -->\nnew\n<!-- end of a -->\nbelow\n"


def test_the_disk_s_ring_is_stretched(script):
    mesh = script.ringed_disk().meshes[0]
    at = mesh.attributes["TEXCOORD_0"] - 0.5
    place = np.empty((len(at), 3))
    place[mesh.wedges] = mesh.positions[mesh.faces]
    radius, flat = np.hypot(place[:, 0], place[:, 2]), np.hypot(*at.T)

    def slope(low, high):
        rows = (radius > low) & (radius < high)
        return np.polyfit(radius[rows], flat[rows], 1)[0]

    assert slope(0.56, 0.64) > 3 * slope(0.1, 0.5)


def test_the_pages_pictures_are_small():
    pictures = sorted((ROOT / "docs" / "images").glob("thesis-*.png"))
    assert len(pictures) == 5
    for path in pictures:
        assert path.stat().st_size < 300_000
        with Image.open(path) as picture:
            assert picture.size[0] > 400
