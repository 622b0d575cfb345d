"""Tangents: MikkTSpace's published behaviour."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lodpipe import io
from lodpipe.geometry.tangents import corner_tangents
from meshes import grid, sphere

ASSETS = Path(__file__).parents[3] / "shared" / "assets" / "dev"
UP = np.float32([0, 0, 1])


def sheet(uv_of, n=2):
    """Tangents of a flat sheet whose UVs are a function of its positions."""
    positions, faces = grid(n)
    normals = np.broadcast_to(UP, (len(faces), 3, 3))
    return corner_tangents(positions, faces, normals, uv_of(positions[:, :2])[faces])


def test_a_sheet_as_gltf_lays_it():
    """u to the right and v down: the bitangent, up, is normal × tangent."""
    tangents = sheet(lambda p: p * [1, -1] + [0, 1])
    assert np.allclose(tangents, [1, 0, 0, 1])


def test_a_mirrored_sheet_has_the_other_sign():
    assert np.allclose(sheet(lambda p: p * [-1, -1]), [-1, 0, 0, -1])


@pytest.mark.parametrize("turn", [0.3, 1.7, 4.0])
def test_a_turned_chart_turns_its_tangents(turn):
    c, s = np.cos(turn), np.sin(turn)
    tangents = sheet(lambda p: (p @ np.array([[c, -s], [s, c]])) * [1, -1])
    assert np.allclose(tangents, [c, s, 0, 1], atol=1e-6)


def test_mirrored_halves_do_not_mix_at_their_seam():
    """u = |x|: the corners on the seam agree in everything, and their tangents differ."""
    positions, faces = grid(2)
    uv = np.stack([np.abs(positions[:, 0] - 0.5), -positions[:, 1]], axis=1)
    tangents = corner_tangents(positions, faces, np.broadcast_to(UP, (8, 3, 3)), uv[faces])
    right = positions[faces][:, :, 0].mean(axis=1) > 0.5
    assert np.allclose(tangents[right], [1, 0, 0, 1])
    assert np.allclose(tangents[~right], [-1, 0, 0, -1])


def test_faces_count_by_their_angle_and_not_by_their_area():
    """At the tip of two faces of equal angle the mean of their directions lies halfway, though one is far larger."""
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-9, 0, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    uv = np.array([[0, 0], [1, 0], [0, -1], [-9, 3]], float)  # the second face's u is sheared
    tangents = corner_tangents(positions, faces, np.broadcast_to(UP, (2, 3, 3)), uv[faces])
    # where u grows and v does not, by Cramer's rule
    p, q = positions[2], positions[3]
    s, t = uv[2], uv[3]
    along = p * t[1] - q * s[1]
    along = -along / np.linalg.norm(along) * np.sign(-(s[0] * t[1] - s[1] * t[0]))
    half = np.array([1.0, 0, 0]) + along
    assert np.allclose(tangents[0, 0, :3], half / np.linalg.norm(half), atol=1e-6)


def test_faces_that_only_touch_at_a_point_keep_their_own():
    positions = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [-1, 0, 0], [-1, -1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 3, 4]], np.int32)
    uv = np.array([[0, 0], [1, 0], [1, -1], [0, 1], [-1, 1]], float)  # the second is turned by a quarter
    tangents = corner_tangents(positions, faces, np.broadcast_to(UP, (2, 3, 3)), uv[faces])
    assert np.allclose(tangents[0, 0, :3], [1, 0, 0])
    assert not np.allclose(tangents[1, 0, :3], tangents[0, 0, :3], atol=0.1)


def test_degenerate_faces_and_uvs_get_unit_tangents():
    positions, faces = sphere(1)
    faces = np.concatenate([faces, [[0, 0, 1], [2, 3, 4]]]).astype(np.int32)
    uv = positions[:, :2][faces].copy()
    uv[-1] = 0.5
    normals = positions[faces]
    tangents = corner_tangents(positions, faces, normals, uv)
    assert np.allclose(np.linalg.norm(tangents[..., :3], axis=2), 1, atol=1e-5)
    assert np.isin(tangents[..., 3], (-1, 1)).all()


def test_tangents_lie_across_normals():
    positions, faces = sphere(2)
    tangents = corner_tangents(positions, faces, positions[faces], positions[:, :2][faces])
    assert np.abs(np.einsum("fkd,fkd->fk", tangents[..., :3], positions[faces])).max() < 1e-5


def test_nothing_is_no_error():
    empty = np.zeros((0, 3, 3))
    assert corner_tangents(np.zeros((0, 3)), np.zeros((0, 3), np.int32), empty, empty[..., :2]).shape == (0, 3, 4)


@pytest.mark.skipif(not ASSETS.is_dir(), reason="needs the shared assets")
def test_a_model_with_tangents_of_blender_s():
    """Its exporter uses the reference implementation."""
    mesh = io.load(ASSETS / "barrel.glb").meshes[0]
    normals, uv = (mesh.attributes[name][mesh.wedges] for name in ("NORMAL", "TEXCOORD_0"))
    made, stored = corner_tangents(mesh.positions, mesh.faces, normals, uv), mesh.attributes["TANGENT"][mesh.wedges]
    cosine = np.einsum("fkd,fkd->fk", made[..., :3], stored[..., :3])
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 0.2
    assert (made[..., 3] == stored[..., 3]).all()
