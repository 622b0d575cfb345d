"""Previews: small, complete, the same every time, and where a page expects them."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from lodpipe.core.asset import Asset
from lodpipe.core.material import Image, Material
from lodpipe.core.mesh import Mesh
from lodpipe.io import decode_image, load
from lodpipe.io.images import encode_png
from lodpipe.io.preview import Previews, shrunk
from meshes import box, sphere

CENTRE = np.array([100.0, 0.0, -5.0])


def textured(size: int = 64, alpha: bool = False) -> Asset:
    """A box far from the origin with a noisy texture."""
    positions, faces = box(4.0)
    pixels = np.random.default_rng(0).integers(0, 255, (size, size, 4 if alpha else 3), np.uint8)
    image = Image(encode_png(pixels), "image/png", "noise", "noise.png", size, size)
    uv = np.asarray(positions, np.float32)[:, :2] / 4
    mesh = Mesh(np.asarray(positions) + CENTRE, faces, attributes={"TEXCOORD_0": uv})
    slot = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    return Asset("box", (mesh,), (Material(slot),), (image,), {"textures": [{"source": 0}]})


def small(asset: Asset, size: int) -> Asset:
    """The asset with small images."""
    return replace(asset, images=tuple(shrunk(image, decode_image(image), size) for image in asset.images))


def read(previews: Previews, name: str, folder) -> Asset:
    """The preview as a reader sees it."""
    for file, data in previews.files.items():
        (folder / file).write_bytes(data)
    return load(folder / name)


@pytest.mark.parametrize("alpha", [False, True])
def test_a_preview_lies_at_the_origin_with_a_radius_of_one_and_a_small_texture(tmp_path, alpha):
    asset = textured(512, alpha)
    previews = Previews(CENTRE, 2 * 3**0.5)
    got = read(previews, previews.add("LOD0", small(asset, 128)), tmp_path)
    ((index, matrix),) = got.instances()
    points = got.meshes[index].positions @ matrix[:3, :3].T + matrix[:3, 3]
    assert np.linalg.norm(points, axis=1) == pytest.approx(np.ones(len(points)), abs=1e-3)
    assert (got.images[0].width, got.images[0].height) == (128, 128)
    assert got.images[0].mime_type == ("image/webp" if alpha else "image/jpeg")
    assert got.warnings == ()


def test_levels_share_their_textures():
    asset = textured()
    previews = Previews(CENTRE, 1.0)
    names = [previews.add(f"LOD{n}", small(asset, 1024)) for n in range(2)]
    assert names == ["LOD0.gltf", "LOD1.gltf"]
    assert len(previews.files) == 2 + 1 + 1  # the same buffer and the same image
    assert asset.images[0].data in previews.files.values()  # small enough as it is


def test_a_texture_that_cannot_be_shown_is_left_out(tmp_path):
    asset = textured()
    previews = Previews(CENTRE, 1.0)
    broken = replace(asset, images=(replace(asset.images[0], data=b""),))
    got = read(previews, previews.add("LOD0", broken), tmp_path)
    assert got.images == ()
    assert got.materials[0].base_color_texture is None


def test_rounding_stays_below_a_thousandth(tmp_path):
    positions, faces = sphere(3, radius=1e-4)
    asset = Asset("tiny", (Mesh(positions, faces),))
    previews = Previews(np.zeros(3), 1e-4)
    got = read(previews, previews.add("LOD0", asset), tmp_path)
    assert np.sort(got.meshes[0].positions, axis=0) == pytest.approx(np.sort(positions, axis=0), abs=1e-7)


def test_coloured_surfaces_of_one_shape_share_it(tmp_path):
    positions, faces = sphere(2)
    previews = Previews(np.zeros(3), 1.0)
    colours = [np.full((len(positions), 3), value, np.uint8) for value in (10, 200)]
    names = [previews.add_coloured(f"error{n}", positions, faces, c) for n, c in enumerate(colours)]
    assert len(previews.files) == 2 + 1 + 2
    got = read(previews, names[1], tmp_path)
    assert got.triangles == len(faces)
    assert got.meshes[0].attributes["COLOR_0"][:, :3] == pytest.approx(200 / 255)
    assert np.allclose(np.sort(got.meshes[0].positions, axis=0), np.sort(positions, axis=0), atol=1e-4)


def test_lights_cameras_and_animations_stay_away():
    positions, faces = box()
    document = {
        "nodes": [{"mesh": 0, "camera": 0, "extensions": {"KHR_lights_punctual": {"light": 0}}}],
        "scenes": [{"nodes": [0]}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}],
        "extensions": {"KHR_lights_punctual": {"lights": [{"type": "point"}]}},
    }
    asset = Asset("lit", (Mesh(positions, faces),), document=document)
    before = json.dumps(document)
    previews = Previews(np.zeros(3), 1.0)
    text = previews.files[previews.add("LOD0", asset)].decode()
    assert "camera" not in text
    assert "light" not in text
    assert json.dumps(document) == before


def test_the_same_bytes_every_time():
    asset = textured(256)
    twice = []
    for _ in range(2):
        previews = Previews(CENTRE, 1.0)
        previews.add("LOD0", small(asset, 64))
        twice.append(previews.files)
    assert twice[0] == twice[1]
