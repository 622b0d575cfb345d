"""The texture slots of materials, and how they are read."""

from __future__ import annotations

import numpy as np
import pytest

from lodpipe.core.asset import Asset
from lodpipe.core.material import Image, Material
from lodpipe.geometry.slots import BASE_COLOR, EMISSIVE, NORMAL, SlotTextures, is_colour, is_normal, map_name, slots

SHEEN = ("extensions", "KHR_materials_sheen", "sheenColorTexture")
BUMPS = ("extensions", "KHR_materials_clearcoat", "clearcoatNormalTexture")
GLTF = {
    "name": "all",
    "pbrMetallicRoughness": {"baseColorTexture": {"index": 2}, "roughnessFactor": 0.5},
    "normalTexture": {"index": 0, "scale": 0.25},
    "extensions": {
        "KHR_materials_sheen": {"sheenColorTexture": {"index": 1, "texCoord": 1}},
        "KHR_materials_clearcoat": {"clearcoatNormalTexture": {"index": 0}},
    },
    "extras": {"oldTexture": {"index": 7}},
}


def two_by_one(left, right) -> np.ndarray:
    return np.array([[left, right]], np.uint8)


def textures(pixels, sampler=None) -> SlotTextures:
    document = {"textures": [{"source": 0, **({"sampler": 0} if sampler else {})}, {}], "samplers": [sampler or {}]}
    image = Image(b"x", width=pixels.shape[1], height=pixels.shape[0])
    return SlotTextures(Asset("a", (), (), (image,), document), {0: pixels})


def test_the_slots_of_extensions_are_found_and_extras_are_not():
    assert {path: info["index"] for path, info in slots(Material(GLTF)).items()} == {
        BASE_COLOR: 2,
        NORMAL: 0,
        SHEEN: 1,
        BUMPS: 0,
    }


@pytest.mark.parametrize(
    ("path", "name", "colour", "normal"),
    [
        (BASE_COLOR, "base_color", True, False),
        (EMISSIVE, "emissive", True, False),
        (NORMAL, "normal", False, True),
        (SHEEN, "sheenColorTexture", True, False),
        (BUMPS, "clearcoatNormalTexture", False, True),
    ],
)
def test_what_a_slot_holds(path, name, colour, normal):
    assert (map_name(path), is_colour(path), is_normal(path)) == (name, colour, normal)


def test_a_slot_is_read_through_its_sampler_and_transform():
    pixels = two_by_one((255, 0, 0), (0, 0, 255))
    info = {
        "index": 0,
        "texCoord": 1,
        "scale": 0.25,
        "extensions": {"KHR_texture_transform": {"offset": [0.5, 0.0], "scale": [0.5, 1.0]}},
    }
    slot = textures(pixels, {"wrapS": 33071, "magFilter": 9728}).slot(NORMAL, info)
    assert (slot.uv_name, slot.strength, slot.nearest, slot.wrap) == ("TEXCOORD_1", 0.25, True, (33071, 10497))
    placed = slot.place(np.array([[0.0, 0.5], [1.0, 0.5], [9.0, 0.5]]))
    assert np.allclose(placed[:, 0], [0.5, 1.0, 5.0])
    assert np.allclose(slot.sample(placed, np.ones(3, np.float32))[:, :3], [0, 0, 1])  # clamped at the right


def test_colours_are_made_linear_and_numbers_are_not():
    pixels = two_by_one((128, 128, 128), (128, 128, 128))
    here, one = np.array([[0.5, 0.5]]), np.ones(1, np.float32)
    made = textures(pixels)
    assert made.slot(BASE_COLOR, {"index": 0}).sample(here, one)[0, 0] == pytest.approx(0.2158, abs=1e-3)
    assert made.slot(NORMAL, {"index": 0}).sample(here, one)[0, 0] == pytest.approx(128 / 255, abs=1e-3)


def test_colours_that_cannot_be_seen_are_not_mixed_in_where_that_is_asked_for():
    pixels = two_by_one((0, 255, 0, 255), (0, 0, 0, 0))
    middle, one = np.array([[0.5, 0.5]]), np.ones(1, np.float32)
    made = textures(pixels)
    assert made.slot(BASE_COLOR, {"index": 0}).sample(middle, one)[0, 1] < 0.6
    assert made.slot(BASE_COLOR, {"index": 0}, spread=True).sample(middle, one)[0] == pytest.approx([0, 1, 0, 0.5])
    assert pixels[0, 1].tolist() == [0, 0, 0, 0]


def test_an_image_that_is_not_there_makes_no_slot():
    assert textures(two_by_one((0, 0, 0), (1, 1, 1))).slot(BASE_COLOR, {"index": 1}) is None
