from __future__ import annotations

from pathlib import Path

import numpy as np
import PIL.Image
import pytest

import model_files as files
from lodpipe import io
from lodpipe.core.asset import Asset
from lodpipe.io.mtl import map_statement

OBJ = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n"


def read(folder: Path, statements: str, *names: str) -> Asset:
    (folder / "m.obj").write_text(OBJ)
    (folder / "m.mtl").write_text(f"newmtl m\n{statements}\n")
    for name in names:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(files.png())
    return io.load(folder / "m.obj")


def test_figures(tmp_path: Path) -> None:
    asset = read(tmp_path, "Kd 0.5 0.25 1\nd 0.5\nNs 30\nKe 1 0 0\nKa 1 1 1\nillum 2")
    material = asset.materials[0]
    assert material.base_color_factor == (0.5, 0.25, 1, 0.5) and material.alpha_mode == "BLEND"
    assert material.gltf["pbrMetallicRoughness"]["roughnessFactor"] == 0.5
    assert material.gltf["pbrMetallicRoughness"]["metallicFactor"] == 0
    assert material.gltf["emissiveFactor"] == [1, 0, 0]
    assert material.gltf["extras"] == {"mtl": {"Ka": "1 1 1", "illum": "2"}}
    assert read(tmp_path, "Tr 0.25").materials[0].base_color_factor == (1, 1, 1, 0.75)
    assert read(tmp_path, "Tr 1").materials[0].alpha_mode == "OPAQUE"  # never invisible


@pytest.mark.parametrize(
    "name", ["t.png", "wood 1.png", r".\t.png", r"maps\t.png", r"C:\work\t.png", "/srv/maps/t.png", "../t.png"]
)
def test_a_map_is_found_under_the_names_that_exporters_write(tmp_path: Path, name: str) -> None:
    place = "maps/t.png" if name.startswith("maps") else name.replace("\\", "/").rpartition("/")[2]
    asset = read(tmp_path, f"map_Kd {name}", place)
    assert asset.warnings == ()
    assert asset.images[0].data == files.png()
    assert asset.materials[0].base_color_texture is not None
    assert asset.members[-1] == (tmp_path / place).resolve()


def test_a_missing_map_is_a_warning(tmp_path: Path) -> None:
    asset = read(tmp_path, "map_Kd gone.png")
    assert asset.images[0].problem and not asset.images[0].data
    assert asset.warnings == ("image 'gone.png' is missing; the material is shown without it",)
    (path,) = io.save(asset, tmp_path / "o.glb")
    assert io.load(path).materials[0].base_color_texture is None


def test_normal_maps_and_height_maps(tmp_path: Path) -> None:
    asset = read(tmp_path, "map_Bump -bm 0.5 t.png", "t.png")
    normal = asset.materials[0].gltf["normalTexture"]
    assert normal == {"index": 0, "scale": 0.5}
    grey = tmp_path / "grey"
    grey.mkdir()
    PIL.Image.new("L", (2, 2)).save(grey / "g.png")
    (grey / "m.obj").write_text(OBJ)
    (grey / "m.mtl").write_text("newmtl m\nbump g.png\n")
    asset = io.load(grey / "m.obj")
    assert "normalTexture" not in asset.materials[0].gltf
    assert "grey height map" in asset.warnings[0]


def test_offset_and_scale_become_a_texture_transform_and_come_back(tmp_path: Path) -> None:
    asset = read(tmp_path, "map_Kd -s 2 4 1 -o 0.5 0.125 -clamp on t.png", "t.png")
    ref = asset.materials[0].base_color_texture
    assert ref is not None and ref.scale == (2, 4)
    u, v = 0.25, 0.75  # as OBJ counts v, from the bottom
    top = np.array([u, 1 - v]) * ref.scale + ref.offset
    assert np.allclose(top, [u * 2 + 0.5, 1 - (v * 4 + 0.125)])
    assert asset.document["samplers"][asset.document["textures"][0]["sampler"]]["wrapS"] == 33071
    assert asset.document["extensionsUsed"] == ["KHR_texture_transform"]
    again = io.load(io.save(asset, tmp_path / "o.obj")[0])
    assert again.materials[0].base_color_texture == ref


def test_maps_without_a_place_are_named(tmp_path: Path) -> None:
    asset = read(tmp_path, "map_Kd t.png\nmap_d t.png\nmap_Ks s.png\ndisp d.png", "t.png")
    assert asset.materials[0].alpha_mode == "BLEND"
    assert [w.split(": ")[1].split(" ")[0] for w in asset.warnings] == ["disp", "map_ks"]


def test_black_under_a_texture_is_white(tmp_path: Path) -> None:
    asset = read(tmp_path, "Kd 0 0 0\nmap_Kd t.png", "t.png")
    assert asset.materials[0].base_color_factor == (1, 1, 1, 1) and "Kd is black" in asset.warnings[0]


@pytest.mark.parametrize(
    ("text", "name", "options"),
    [
        ("a.png", "a.png", {}),
        ("-s 1 2 3 a b.png", "a b.png", {"-s": ["1", "2", "3"]}),
        ("-o 0.5 7.png", "7.png", {"-o": ["0.5"]}),
        ("-blendu on -bm -2 x.tga", "x.tga", {"-blendu": ["on"], "-bm": ["-2"]}),
        ("-strange.png", "-strange.png", {}),
    ],
)
def test_map_statements(text: str, name: str, options: dict[str, list[str]]) -> None:
    assert map_statement(text) == (name, options)
