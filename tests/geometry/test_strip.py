"""Meshes without UVs."""

from __future__ import annotations

import dataclasses

import numpy as np

from lodpipe.core.asset import Asset
from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.geometry.strip import without_uvs
from meshes import box


def test_seams_go_and_skins_stay():
    positions, faces = box()
    wedges = np.arange(36, dtype=np.int32).reshape(12, 3)
    names = ("TEXCOORD_0", "TEXCOORD_1", "NORMAL", "TANGENT", "COLOR_0", "JOINTS_0")
    attributes = {name: np.ones((36, 4), np.float32) for name in names}
    mesh = Mesh(positions, faces, wedges, attributes, primitives=(Primitive(3, names),))
    kept = dataclasses.replace(mesh, keep_reason="morph targets")
    stripped = without_uvs(Asset("a", (mesh, kept)))
    assert list(stripped.meshes[0].attributes) == ["JOINTS_0"]
    assert stripped.meshes[0].primitives == (Primitive(3, ("JOINTS_0",)),)
    assert stripped.meshes[1] is kept
    assert stripped.lods[0].meshes is stripped.meshes
    bare = without_uvs(Asset("a", (Mesh(positions, faces, wedges, {"NORMAL": attributes["NORMAL"]}),))).meshes[0]
    assert bare.wedge_count == 8
