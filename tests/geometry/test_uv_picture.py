"""Pictures of UV layouts."""

from __future__ import annotations

import numpy as np

from lodpipe.core.mesh import Mesh
from lodpipe.geometry.uv_picture import FLIPPED, OUTSIDE, OVERLAPPED, PAPER, PLAIN, uv_picture
from meshes import box, grid


def square(low, high, mirrored=False):
    positions, faces = grid(1)
    uv = (positions[:, :2] * [1, -1] + [0, 1]) * (np.array(high) - low) + low
    if mirrored:
        uv[:, 0] = low[0] + high[0] - uv[:, 0]
    return Mesh(positions, faces, attributes={"TEXCOORD_0": uv.astype(np.float32)})


def at(picture, u, v):
    """The colour at a place of the texture, in a picture that shows just [0, 1]."""
    size = len(picture) - 8
    return tuple(picture[int(4 + v * size), int(4 + u * size)].tolist())


def test_faces_lie_where_their_uvs_say():
    picture = uv_picture(square((0.1, 0.2), (0.5, 0.4)), size=208)
    assert at(picture, 0.2, 0.33) == PLAIN
    assert at(picture, 0.2, 0.5) == PAPER
    assert at(picture, 0.7, 0.3) == PAPER


def test_defects_are_coloured():
    assert at(uv_picture(square((0, 0), (1, 1), mirrored=True)), 0.3, 0.2) == FLIPPED
    mesh = square((0, 0), (1, 1))
    doubled = Mesh(
        np.concatenate([mesh.positions, mesh.positions + 5]),
        np.concatenate([mesh.faces, mesh.faces + 4]),
        attributes={"TEXCOORD_0": np.tile(mesh.attributes["TEXCOORD_0"], (2, 1))},
    )
    assert at(uv_picture(doubled), 0.3, 0.2) == OVERLAPPED


def test_what_lies_outside_is_seen():
    picture = uv_picture(square((1, 0), (2, 1)), size=208)
    assert tuple(picture[60, 150]) == PLAIN
    assert tuple(picture[180, 20]) == OUTSIDE


def test_a_mesh_without_uvs_is_an_empty_picture():
    picture = uv_picture(Mesh(*box()), size=64)
    assert set(map(tuple, picture.reshape(-1, 3).tolist())) == {PAPER, OUTSIDE}
