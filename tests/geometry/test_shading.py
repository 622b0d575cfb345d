"""Normals for meshes without: smooth where the surface is, split at creases, others untouched."""

from __future__ import annotations

import dataclasses

import numpy as np

from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.geometry.normals import crease_normals
from lodpipe.geometry.shading import with_normals
from meshes import bow_tie, box, folded, sphere, uv_sphere


def corner_normals(mesh):
    return mesh.attributes["NORMAL"][mesh.wedges]


def test_a_smooth_mesh_gets_no_seams():
    positions, faces = sphere(4)
    made = with_normals(Mesh(positions, faces))
    assert len(made.attributes["NORMAL"]) == len(positions)
    np.testing.assert_allclose(corner_normals(made), crease_normals(positions, faces), atol=1e-6)
    assert made.primitives[0].attributes == ("NORMAL",)


def test_a_box_is_split_along_its_edges():
    made = with_normals(Mesh(*box()))
    assert len(made.attributes["NORMAL"]) == 24
    np.testing.assert_allclose(np.abs(corner_normals(made)).max(axis=2), 1, atol=1e-6)


def test_a_fold_is_one_fan_below_the_limit_and_two_above():
    for degrees, extra in ((50.0, 0), (70.0, 9)):
        positions, faces = folded(8, degrees)
        made = with_normals(Mesh(positions, faces))
        assert len(made.attributes["NORMAL"]) == len(positions) + extra


def test_two_fans_that_meet_in_a_point_have_normals_of_their_own():
    positions, faces = bow_tie()
    made = with_normals(Mesh(positions, faces))
    np.testing.assert_allclose(np.linalg.norm(made.attributes["NORMAL"], axis=1), 1, atol=1e-6)


def test_normals_that_are_there_stay():
    ball = uv_sphere(8, 16).mesh()
    assert with_normals(ball) is ball
    bare = Mesh(*sphere(1))
    assert "NORMAL" not in bare.attributes and with_normals(bare) is not bare
    half = ball.face_primitive.copy()
    half[len(half) // 2 :] = 1
    # split the wedges along the border, as a mesh of two primitives must
    keys, wedges = np.unique(ball.wedges.astype(np.int64) * 2 + half[:, None], return_inverse=True)
    two = Mesh(
        ball.positions,
        ball.faces,
        wedges.reshape(-1, 3).astype(np.int32),
        {name: values[keys // 2] for name, values in ball.attributes.items()},
        half,
        (Primitive(attributes=tuple(ball.attributes)), Primitive(attributes=("TEXCOORD_0", "COLOR_0"))),
    )
    made = with_normals(two)
    own = half == 0
    np.testing.assert_array_equal(corner_normals(made)[own], corner_normals(two)[own])
    assert all("NORMAL" in p.attributes for p in made.primitives)
    assert dataclasses.replace(two).attributes["NORMAL"].shape == two.attributes["NORMAL"].shape
