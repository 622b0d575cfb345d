"""Levels with materials of their own."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from lodpipe import io
from lodpipe.core.asset import Asset, Lod
from lodpipe.core.material import Image, Material, MaterialSet, renumbered
from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.io.images import encode_png
from meshes import box


def picture(colour: int) -> Image:
    return Image(encode_png(np.full((4, 4, 3), colour, np.uint8)), "image/png", f"grey{colour}", "", 4, 4)


def cube(material: int) -> Mesh:
    positions, faces = box()
    uv = np.zeros((len(positions), 2), np.float32)
    return Mesh(positions, faces, attributes={"TEXCOORD_0": uv}, primitives=(Primitive(material, ("TEXCOORD_0",)),))


def two_levels() -> Asset:
    """Two materials and two textures of the source, and a second level with one of its own."""
    slot = {"index": 1}
    materials = (Material({"name": "plain"}), Material({"name": "source", "emissiveTexture": slot}))
    baked = Material({"name": "baked", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}})
    own = MaterialSet((baked,), (picture(200),), ({"source": 0, "sampler": 0},), ({"wrapS": 33071},))
    document = {
        "textures": [{"source": 1}, {"source": 0, "sampler": 0}],
        "samplers": [{"wrapS": 10497}],
        "images": [{"name": "a"}, {"name": "b"}],
        "extensions": {"KHR_materials_variants": {"variants": [{"name": "x"}]}},
    }
    levels = (Lod((cube(1),)), Lod((cube(0),), estimate=1.0, own=own))
    return Asset("box", (cube(1),), materials, (picture(10), picture(20)), document, lods=levels)


def test_a_level_as_an_asset():
    asset = two_levels()
    first, second = (asset.at(level) for level in asset.lods)
    assert first.materials == asset.materials
    assert first.document == asset.document
    assert (first.lods, second.lods) == ((), ())
    assert [m.name for m in second.materials] == ["baked"]
    assert [i.name for i in second.images] == ["grey200"]
    assert second.document["textures"] == [{"source": 0, "sampler": 0}]
    assert second.document["samplers"] == [{"wrapS": 33071}]
    assert "images" not in second.document
    assert second.document["extensions"] == asset.document["extensions"]


def test_all_levels_in_one_set():
    asset = two_levels()
    whole = asset.with_one_material_set()
    assert [m.name for m in whole.materials] == ["plain", "source", "baked"]
    assert whole.materials[2].base_color_texture.texture == 2
    assert whole.document["textures"][2] == {"source": 2, "sampler": 1}
    assert [p.material for level in whole.lods for p in level.meshes[0].primitives] == [1, 2]
    assert [level.own for level in whole.lods] == [None, None]
    assert asset.lods[1].own is not None  # the input is unchanged


def test_without_materials_of_their_own_nothing_changes():
    asset = dataclasses.replace(two_levels(), lods=(Lod((cube(1),)),))
    whole = asset.with_one_material_set()
    assert whole.fingerprint() == asset.fingerprint()
    assert whole.lods[0].meshes[0] is asset.lods[0].meshes[0]


def test_references_are_renumbered_in_extensions_and_not_in_extras():
    tree = {
        "normalTexture": {"index": 1, "scale": 2},
        "extensions": {"KHR_materials_sheen": {"sheenColorTexture": {"index": 0}}},
        "extras": {"someTexture": {"index": 5}},
    }
    assert renumbered(tree, {"texture": 10}) == {
        "normalTexture": {"index": 11, "scale": 2},
        "extensions": {"KHR_materials_sheen": {"sheenColorTexture": {"index": 10}}},
        "extras": {"someTexture": {"index": 5}},
    }
    webp = [{"extensions": {"EXT_texture_webp": {"source": 1}}, "sampler": 0}]
    assert renumbered(webp, {"source": 2, "sampler": 3}) == [
        {"extensions": {"EXT_texture_webp": {"source": 3}}, "sampler": 3}
    ]


def test_what_a_level_owns_is_part_of_the_fingerprint():
    asset = two_levels()
    plain = dataclasses.replace(asset, lods=(asset.lods[0], dataclasses.replace(asset.lods[1], own=None)))
    assert plain.fingerprint() != asset.fingerprint()


def test_both_ways_of_writing_can_be_read_again(tmp_path: Path):
    asset = two_levels()
    (path, *_) = io.save(asset.at(asset.lods[1]), tmp_path / "level.glb")
    level = io.load(path)
    assert [m.name for m in level.materials] == ["baked"]
    assert level.images[0].data == picture(200).data
    whole = asset.with_one_material_set()
    (path, *_) = io.save_combined(whole, tmp_path / "all.glb", [lod.meshes for lod in whole.lods], [0.5, 0.0])
    combined = io.load(path)
    used = {p.material for mesh in combined.meshes for p in mesh.primitives}
    assert {combined.materials[row].name for row in used} == {"source", "baked"}
    assert {image.data for image in combined.images} == {picture(grey).data for grey in (10, 20, 200)}
