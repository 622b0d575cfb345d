"""All instances of an asset in world space."""

from __future__ import annotations

import numpy as np
import pytest

from lodpipe.core.asset import Asset
from lodpipe.core.errors import InvalidMesh
from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.geometry.flatten import flatten
from meshes import box, grid


def signed_volume(soup):
    a, b, c = (soup.positions[soup.faces[:, k]] for k in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


def placed(mesh, *nodes):
    document = {"scenes": [{"nodes": list(range(len(nodes)))}], "nodes": [{"mesh": 0, **node} for node in nodes]}
    return Asset("placed", (mesh,), document=document)


def test_a_single_unmoved_mesh_is_not_copied():
    mesh = Mesh(*box())
    soup = flatten(Asset("box", (mesh,)))
    assert soup.positions is mesh.positions
    assert soup.faces is mesh.faces
    assert soup.face_material.tolist() == [-1] * 12


def test_instances_are_placed_one_after_the_other():
    soup = flatten(placed(Mesh(*box()), {"translation": [10, 0, 0]}, {"translation": [0, 5, 0], "scale": [2, 2, 2]}))
    assert [part.first_face for part in soup.parts] == [0, 12]
    assert soup.faces.shape == (24, 3)
    np.testing.assert_allclose(soup.bounds, [[-1, -0.5, -1], [10.5, 6, 1]])
    assert soup.diagonal == pytest.approx(np.linalg.norm([11.5, 6.5, 2]))
    assert signed_volume(soup) == pytest.approx(1 + 8)


def test_a_mirroring_matrix_keeps_the_outside_outside():
    mesh = Mesh(*box(), attributes={"_ROW": np.arange(8.0, dtype=np.float32)[:, None]})
    plain, mirrored = flatten(placed(mesh, {})), flatten(placed(mesh, {"scale": [-1, 1, 1]}))
    assert signed_volume(mirrored) == pytest.approx(signed_volume(plain))
    values, has = mirrored.attribute("_ROW")
    assert has.all()
    # each corner still has the attributes of the vertex that it is
    np.testing.assert_array_equal(values[mirrored.wedges][:, :, 0], mirrored.faces)
    np.testing.assert_allclose(mirrored.positions[:, 0], -mesh.positions[:, 0])


@pytest.mark.parametrize("scale", [[1, 1, 4], [-1, 1, 4], [1, -2, -3], [1e-12, 1e-12, 2e-12]])
def test_normals_stay_at_right_angles_to_their_faces(scale):
    positions, faces = box()
    corners = positions[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    wedges = np.arange(36, dtype=np.int32).reshape(12, 3)
    mesh = Mesh(positions, faces, wedges, {"NORMAL": np.repeat(normals, 3, axis=0).astype(np.float32)})
    node = {"scale": scale, "rotation": [0.5, 0.1, np.sqrt(1 - 0.26 - 0.49), 0.7]}
    soup = flatten(placed(mesh, node))
    values, _ = soup.attribute("NORMAL")
    a, b, c = (soup.positions[soup.faces[:, k]] for k in range(3))
    outwards = np.cross(b - a, c - a)
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    np.testing.assert_allclose(values[soup.wedges[:, 0]], outwards, atol=1e-6)


def test_attributes_of_parts_that_differ():
    positions, faces = grid()
    coloured = Mesh(positions, faces, attributes={"COLOR_0": np.full((4, 3), 0.25, np.float32)})
    both = Mesh(
        positions,
        faces,
        attributes={"COLOR_0": np.full((4, 4), 0.5, np.float32)},
        face_primitive=np.array([0, 1], np.int32),
        primitives=(Primitive(material=3, attributes=("COLOR_0",)), Primitive(material=None, attributes=())),
    )
    soup = flatten(Asset("two", (coloured, Mesh(positions, faces), both)))
    values, has = soup.attribute("COLOR_0")
    assert has.tolist() == [True, True, False, False, True, False]
    assert values.shape == (12, 4)
    np.testing.assert_array_equal(values[soup.wedges[0]], [[0.25, 0.25, 0.25, 1.0]] * 3)
    np.testing.assert_array_equal(values[soup.wedges[4]], [[0.5] * 4] * 3)
    assert soup.face_material.tolist() == [-1, -1, -1, -1, 3, -1]
    assert soup.attribute("TEXCOORD_0") is None


def test_unused_vertices_do_not_count():
    positions, faces = box()
    soup = flatten(Asset("loose", (Mesh(np.concatenate([positions, [[100.0, 0, 0]]]), faces),)))
    assert soup.diagonal == pytest.approx(np.sqrt(3))


def test_a_diagonal_of_any_size():
    for size in (1e-200, 1e31, 1e200):
        assert flatten(Asset("box", (Mesh(*box(size)),))).diagonal == pytest.approx(np.sqrt(3) * size)


def test_nothing_to_place():
    soup = flatten(Asset("empty", ()))
    assert soup.faces.shape == (0, 3)
    assert soup.wedges.shape == (0, 3)
    assert soup.diagonal == 0.0


def test_a_level_must_match_the_asset():
    with pytest.raises(InvalidMesh, match="2 meshes where the asset has 1"):
        flatten(Asset("box", (Mesh(*box()),)), [Mesh(*box())] * 2)
