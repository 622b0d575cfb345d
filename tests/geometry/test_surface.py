"""Normal maps on sheets whose UVs run in known directions."""

from __future__ import annotations

import numpy as np
import pytest

from lodpipe.core.asset import Asset
from lodpipe.core.material import Material
from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.geometry.camera import Camera
from lodpipe.geometry.render import buffers
from lodpipe.geometry.surface import Model
from lodpipe.geometry.texture import Textures
from meshes import grid

FRONT = Camera(np.array([0.5, 0.5, 3.0]), np.array([0.5, 0.5, 0.0]), fov=None, height=1.0)
UP = np.array([[0, 0, 1]], np.float32)
LAYOUTS = {
    "upright": lambda p: np.stack([p[:, 0], 1 - p[:, 1]], axis=1),
    "mirrored": lambda p: np.stack([1 - p[:, 0], 1 - p[:, 1]], axis=1),
    "turned": lambda p: np.stack([p[:, 1], p[:, 0]], axis=1),  # u runs up, v (down in the image) to the right
}


def mapped(layout: str, colour, stored=None, scale: float = 1.0):
    """The normal (3,) that is seen of a sheet under a normal map of one colour."""
    positions, faces = grid(1)
    attributes = {"TEXCOORD_0": LAYOUTS[layout](positions).astype(np.float32), "NORMAL": np.repeat(UP, 4, 0)}
    if stored is not None:
        attributes["TANGENT"] = np.repeat(np.array([stored], np.float32), 4, 0)
    mesh = Mesh(positions, faces, attributes=attributes, primitives=(Primitive(0, tuple(attributes)),))
    material = Material({"normalTexture": {"index": 0, "scale": scale}})
    asset = Asset("sheet", (mesh,), (material,), document={"textures": [{"source": 0}]})
    textures = Textures({0: np.full((4, 4, 3), colour, np.uint8)})
    return buffers(Model(asset, textures=textures), FRONT, 8, 8).normals[4, 4]


RED, GREEN = [218, 128, 218], [128, 218, 218]  # 45° along the tangent, along the bitangent


@pytest.mark.parametrize(
    ("layout", "colour", "expected"),
    [
        ("upright", [128, 128, 255], [0, 0, 1]),
        ("upright", RED, [1, 0, 1]),
        ("upright", GREEN, [0, 1, 1]),
        ("mirrored", RED, [-1, 0, 1]),
        ("mirrored", GREEN, [0, 1, 1]),
        ("turned", RED, [0, 1, 1]),
        ("turned", GREEN, [-1, 0, 1]),
    ],
)
def test_a_normal_map_leans_the_way_it_says(layout, colour, expected):
    np.testing.assert_allclose(mapped(layout, colour), np.array(expected) / np.linalg.norm(expected), atol=0.02)


def test_stored_tangents_go_first_and_scale_counts():
    np.testing.assert_allclose(mapped("upright", RED, [0, -1, 0, 1]), np.array([0, -1, 1]) / np.sqrt(2), atol=0.02)
    np.testing.assert_allclose(mapped("upright", GREEN, [1, 0, 0, -1]), np.array([0, -1, 1]) / np.sqrt(2), atol=0.02)
    np.testing.assert_allclose(mapped("upright", RED, scale=0.0), [0, 0, 1], atol=0.02)


def test_without_uvs_the_map_is_left_out():
    positions, faces = grid(1)
    mesh = Mesh(positions, faces, primitives=(Primitive(0),))
    asset = Asset("s", (mesh,), (Material({"normalTexture": {"index": 0}}),), document={"textures": [{"source": 0}]})
    seen = buffers(Model(asset, textures=Textures({0: np.full((2, 2, 3), RED, np.uint8)})), FRONT, 4, 4)
    np.testing.assert_allclose(seen.normals[2, 2], [0, 0, 1], atol=1e-6)
