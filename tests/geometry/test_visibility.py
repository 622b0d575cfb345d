"""What is seen from outside: all of a convex shape, nothing within a closed one, glass hides nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lodpipe.core.asset import Asset, Target
from lodpipe.core.material import Material
from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.geometry.decimate import decimate_asset
from lodpipe.geometry.visibility import vertex_visibility
from meshes import bumpy, grid, sphere


def model(*meshes, nodes=None, materials=()):
    nodes = [{"mesh": i} for i in range(len(meshes))] if nodes is None else nodes
    document = {"nodes": nodes, "scenes": [{"nodes": list(range(len(nodes)))}], "scene": 0}
    return Asset(name="test", meshes=meshes, document=document, materials=materials)


def test_a_convex_shape_is_seen_all_over():
    (share,) = vertex_visibility(model(Mesh(*sphere(4))))
    assert share.min() > 0.9 and share.max() <= 1


def test_what_lies_within_is_not_seen():
    positions, faces = sphere(3)
    outer, inner = vertex_visibility(model(Mesh(positions, faces), Mesh(positions * 0.5, faces)))
    assert outer.min() > 0.9 and inner.max() == 0


def test_glass_and_cut_outs_hide_nothing():
    positions, faces = sphere(3)
    for mode in ("BLEND", "MASK"):
        shell = Mesh(positions, faces, primitives=(Primitive(material=0),))
        outer, inner = vertex_visibility(
            model(shell, Mesh(positions * 0.5, faces), materials=(Material({"alphaMode": mode}),))
        )
        assert outer.min() == 1 and inner.min() > 0.9


def test_detail_smaller_than_a_pixel_is_seen():
    """A part of a thousandth of the model's size, seen from all round, and the same within the model."""
    positions, faces = sphere(4)
    detail = Mesh(positions * 0.001 + [0, 1.2, 0], faces)
    _, seen = vertex_visibility(model(Mesh(positions, faces), detail))
    assert seen.min() > 0.9
    _, hidden = vertex_visibility(model(Mesh(positions, faces), replace(detail, positions=positions * 0.001)))
    assert hidden.max() == 0


def test_both_sides_of_a_sheet_count_and_the_best_placement():
    sheet, ball = Mesh(*grid(8)), Mesh(*sphere(3, radius=5.0))
    (alone,) = vertex_visibility(model(sheet))
    assert alone.min() > 0.9
    hidden, _ = vertex_visibility(model(sheet, ball))
    assert hidden.max() == 0
    nodes = [{"mesh": 0}, {"mesh": 1}, {"mesh": 0, "translation": [20, 0, 0]}]
    twice, _ = vertex_visibility(model(sheet, ball, nodes=nodes))
    assert twice.min() > 0.4 and twice.mean() > 0.9


def test_no_faces_no_scene():
    empty = Mesh(np.zeros((3, 3)), np.zeros((0, 3), np.int32))
    assert [s.tolist() for s in vertex_visibility(model(empty))] == [[0, 0, 0]]
    assert vertex_visibility(Asset(name="nothing", meshes=())) == []


def test_triangles_go_to_what_is_seen():
    positions, faces = bumpy(4)
    source = model(Mesh(positions, faces), Mesh(positions * 0.6, faces))
    level = decimate_asset(source, [Target(ratio=0.2)], metric="visual")[1]
    outer, inner = (len(m.faces) for m in level.meshes)
    assert outer > 1.5 * inner > 0 and outer + inner == pytest.approx(819, abs=2)
