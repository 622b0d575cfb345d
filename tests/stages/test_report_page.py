"""What the stage `report` puts aside for the page."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from lodpipe.core.asset import Asset, Lod, Target
from lodpipe.core.errors import Cancelled
from lodpipe.core.material import Image, Material, MaterialSet
from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.geometry import lineup
from lodpipe.geometry.decimate import decimate_asset
from lodpipe.io.images import encode_png
from lodpipe.stage import Context
from lodpipe.stages import _page
from lodpipe.stages.report import ReportParams, report
from meshes import sphere


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch):
    monkeypatch.setattr(lineup, "SIZE", 32)
    monkeypatch.setattr(lineup, "SHEET", 16)


def ball(*ratios: float, **more) -> Asset:
    """A sphere of 512 triangles, and levels of it."""
    asset = Asset("ball", (Mesh(*sphere(3)),), **more)
    return dataclasses.replace(asset, lods=decimate_asset(asset, [Target(ratio=ratio) for ratio in ratios]))


def page_of(asset: Asset, context: Context | None = None, **params):
    context = context or Context()
    report(asset, ReportParams(samples=200, views=0, **params), context)
    return context.page


def triangles(page, name: str) -> int:
    tree = json.loads(page.files[name])
    indices = [p["indices"] for mesh in tree["meshes"] for p in mesh["primitives"]]
    return sum(tree["accessors"][index]["count"] // 3 for index in indices)


def test_every_level_can_be_shown_and_its_error_on_the_source():
    page = page_of(ball(0.5, 0.1))
    assert page.models == {0: "LOD0.gltf", 1: "LOD1.gltf", 2: "LOD2.gltf"}
    assert [triangles(page, page.models[n]) for n in range(3)] == [512, 256, 50]
    (layer,) = page.layers
    assert layer.models == {1: "error_LOD1.gltf", 2: "error_LOD2.gltf"}
    assert {triangles(page, name) for name in layer.models.values()} == {512}
    assert [tick for tick, _ in layer.scale.ticks] == pytest.approx([0, 1 / 3, 2 / 3, 1])
    named = {
        entry["uri"]
        for name in page.files
        if name.endswith("gltf")
        for entry in json.loads(page.files[name])["buffers"]
    }
    assert named | {name for name in page.files if name.endswith("gltf")} == set(page.files)
    assert (page.stand_ins, page.notes) == ({}, [])


def test_levels_too_large_for_a_page_have_a_stand_in(monkeypatch):
    monkeypatch.setattr(_page, "MAX_TRIANGLES", 200)
    page = page_of(ball(0.5, 0.1))
    assert page.stand_ins == {0: 200, 1: 200}
    assert [triangles(page, page.models[n]) for n in range(3)] == [200, 200, 50]
    assert triangles(page, page.layers[0].models[2]) == 200


def test_what_is_still_too_much_is_left_out_and_said(monkeypatch):
    asset = ball(0.5, 0.1)
    monkeypatch.setattr(_page, "MAX_BYTES", 5000)
    page = page_of(asset)
    assert page.layers == []
    assert sorted(page.models) == [1, 2]
    assert [note.partition(":")[0] for note in page.notes] == ["Error", "Level 0 is not shown in 3-D"]
    assert all(name.encode() in b"".join(page.files.values()) for name in page.files if not name.endswith("gltf"))


def test_the_page_can_do_without_models_or_pictures():
    page = page_of(ball(0.5), models=False, pictures=0)
    assert (page.files, page.models, page.layers) == ({}, {}, [])
    assert [picture.kind for picture in page.pictures] == ["sheet", "thumbnail"]


def test_a_level_with_its_own_texture_brings_it():
    def texture(value: int) -> Image:
        return Image(encode_png(np.full((8, 8, 3), value, np.uint8)), "image/png", f"t{value}", "", 8, 8)

    material = Material({"name": "skin", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}})
    positions, faces = sphere(2)
    uv = np.asarray(positions, np.float32)[:, :2]
    mesh = Mesh(positions, faces, attributes={"TEXCOORD_0": uv}, primitives=(Primitive(0, ("TEXCOORD_0",)),))
    own = MaterialSet((material,), (texture(200),), ({"source": 0},))
    textures = {"textures": [{"source": 0}]}
    asset = Asset("ball", (mesh,), (material,), (texture(50),), textures, lods=(Lod((mesh,)), Lod((mesh,), own=own)))
    page = page_of(asset)
    images = [json.loads(page.files[page.models[n]])["images"][0]["uri"] for n in range(2)]
    assert [page.files[name] for name in images] == [texture(50).data, texture(200).data]


def test_an_image_without_a_decoder_is_left_out_with_a_warning():
    image = Image(b"\xabKTX 20\xbb\r\n\x1a\n" + bytes(80), "image/ktx2", "skin", "skin.ktx2", 8, 8)
    material = Material({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}})
    context = Context()
    page = page_of(ball(0.5, materials=(material,), images=(image,), document={"textures": [{"source": 0}]}), context)
    assert "images" not in json.loads(page.files["LOD0.gltf"])
    assert [warning.startswith("pictures are made without a texture: skin.ktx2") for warning in context.warnings] == [
        True
    ]


def test_a_source_without_triangles_has_a_page_that_says_so():
    empty = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    page = page_of(Asset("none", (empty,), lods=(Lod((empty,)),)))
    assert page.notes == ["There is nothing to see: the source has no triangles in its scene."]
    assert page.pictures == []


def test_a_level_without_triangles_is_left_out():
    asset = ball(0.5)
    empty = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    page = page_of(dataclasses.replace(asset, lods=(*asset.lods, Lod((empty,)))))
    assert sorted(page.models) == [0, 1]


def test_it_can_be_stopped():
    with pytest.raises(Cancelled):
        page_of(ball(0.5), Context(cancelled=lambda: True))


def test_the_same_bytes_every_time_and_with_any_threads():
    one, two = (page_of(ball(0.5, 0.1), Context(threads=threads)) for threads in (1, 2))
    assert one == two
