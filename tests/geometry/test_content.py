"""What textures cost: nothing where they are plain, the squared gradient where they run, the contrast at seams."""

from __future__ import annotations

import numpy as np
import pytest

from lodpipe.core.asset import Asset
from lodpipe.core.material import Image, Material
from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.geometry.content import seam_contrasts, slip_price, small
from lodpipe.geometry.surface import Model
from meshes import grid, uv_sphere

SIZE = 64


def textured(mesh, pixels, **material):
    """A model of one mesh with one texture (H, W, 3) float 0…1; None: the image is missing."""
    gltf = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, **material}}}
    asset = Asset(
        name="t",
        meshes=(mesh,),
        materials=(Material(gltf),),
        images=(Image(),),
        document={
            "textures": [{"source": 0}],
            "nodes": [{"mesh": 0}],
            "scenes": [{"nodes": [0]}],
            "scene": 0,
        },
    )
    stored = None if pixels is None else np.rint(pixels * 255).astype(np.uint8)
    return Model(asset, textures=small(lambda index: stored))


def sheet(scale=1.0):
    positions, faces = grid(8)
    uv = (positions[:, :2] - positions[:, :2].min(axis=0)).astype(np.float32)
    uv = np.float32(0.1) + uv / uv.max() * np.float32(scale)  # off the texture's edge, where it begins anew
    return Mesh(positions, faces, attributes={"TEXCOORD_0": uv}, primitives=(Primitive(0, ("TEXCOORD_0",)),))


def ramp():
    return np.repeat(np.tile(np.linspace(0, 1, SIZE)[None, :, None], (SIZE, 1, 1)), 3, axis=2)


def test_a_plain_texture_may_slip_for_nothing():
    assert slip_price(textured(sheet(), np.full((SIZE, SIZE, 3), 0.5)), 0.05) < 1e-12
    assert slip_price(textured(sheet(), None), 0.05) == 0
    assert slip_price(Model(Asset(name="none", meshes=())), 0.05) == 0


def test_a_ramp_costs_its_squared_gradient():
    """From black to white over the sheet's width; half of the slips go along it, half across."""
    model = textured(sheet(0.8), ramp())
    width = float(np.ptp(model.positions[:, 0]))
    assert slip_price(model, 0.02) == pytest.approx((0.8 / width) ** 2 / 2, rel=0.1)


def test_transforms_and_tiling_count():
    once = slip_price(textured(sheet(0.4), ramp()), 0.02)
    transform = {"extensions": {"KHR_texture_transform": {"scale": [2, 2], "offset": [-0.1, -0.1]}}}
    assert slip_price(textured(sheet(0.4), ramp(), **transform), 0.02) == pytest.approx(4 * once, rel=0.15)


def test_grain_finer_than_the_slip_does_not_count():
    noise = np.random.default_rng(0).random((256, 256, 3))
    model = textured(sheet(), noise)
    assert slip_price(model, 0.3) < 0.02 * slip_price(model, 0.004)


def test_large_textures_are_looked_at_small():
    fine = np.zeros((2048, 1024, 3))
    fine[:1024] = 1.0
    textures = small(lambda index: np.rint(fine * 255).astype(np.uint8))
    texture = textures.get(0)
    assert (texture.height, texture.width) == (512, 256)
    seen = texture.sample(np.array([[0.5, 0.25], [0.5, 0.75]], np.float32))[:, 0]
    np.testing.assert_allclose(seen, [1, 0], atol=1e-6)


def test_seams_cost_what_their_sides_differ():
    """A ball whose chart wraps once: a ramp makes its seam black beside white, a plain texture none."""
    ball = uv_sphere(8, 16)
    mesh = ball.mesh()
    model = textured(mesh, ramp())
    found = seam_contrasts(model, model.soup.wedges)
    assert 0.3 < found.max() <= 1  # a half of it is lost where the texture's two ends are blended
    corners = model.positions[model.faces]
    middle = (corners + np.roll(corners, -1, axis=1)) / 2
    at = middle[found > 0.02]
    assert len(at) > 4 and np.ptp(at[:, :2] / np.linalg.norm(at[:, :2], axis=1, keepdims=True), axis=0).max() < 0.2
    plain = textured(mesh, np.full((SIZE, SIZE, 3), 0.3))
    assert seam_contrasts(plain, plain.soup.wedges).max() < 1e-4


def test_no_seams_without_wedges():
    model = textured(sheet(), ramp())
    assert seam_contrasts(model, model.soup.wedges).max() == 0
