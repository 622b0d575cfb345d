"""Bytes on a graphics card."""

from __future__ import annotations

import numpy as np

from lodpipe.core.asset import Asset, GpuSize
from lodpipe.core.material import Image, Material
from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.geometry.gpu import SHORT, gpu_size
from meshes import box, grid


def test_positions_and_attributes_are_floats_and_indices_short():
    positions, faces = box()
    uv = np.zeros((len(positions), 2), np.float32)
    bare, mapped = Mesh(positions, faces), Mesh(positions, faces, attributes={"TEXCOORD_0": uv})
    assert gpu_size(Asset("a", (bare,))) == GpuSize(8 * 12, 12 * 3 * 2, 0)
    assert gpu_size(Asset("a", (mapped, bare))) == GpuSize(8 * 20 + 8 * 12, 2 * 72, 0)


def test_many_vertices_need_long_indices():
    for side, width in ((254, 2), (255, 4)):  # 255² and 256² vertices
        mesh = Mesh(*grid(side))
        size = gpu_size(Asset("a", (mesh,)))
        assert ((side + 1) ** 2 <= SHORT) is (width == 2)
        assert size.index_bytes == len(mesh.faces) * 3 * width


def test_textures_have_mip_levels_and_only_used_ones_count():
    positions, faces = box()
    images = (Image(b"x", "image/png", width=4, height=2), Image(b"y", "image/ktx2", width=8, height=8), Image(b"z"))
    materials = tuple(
        Material({"pbrMetallicRoughness": {"baseColorTexture": {"index": n}}, "extras": {"aTexture": {"index": 1}}})
        for n in range(3)
    )
    document = {"textures": [{"source": n} for n in range(3)]}
    expected = {0: 4 * (8 + 2 + 1), 1: 64 + 16 + 4 + 1, 2: 0}
    for number, size in expected.items():
        mesh = Mesh(positions, faces, primitives=(Primitive(number),))
        asset = Asset("a", (mesh, mesh), materials, images, document)
        assert gpu_size(asset).texture_bytes == size


def test_a_level_without_triangles_has_nothing():
    empty = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    assert gpu_size(Asset("a", (empty,))) == GpuSize(0, 0, 0)
