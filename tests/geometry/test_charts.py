"""Charts of UV sets."""

from __future__ import annotations

import numpy as np

from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.geometry.charts import charts_of, seam_edges
from meshes import box, grid


def sheet(n: int = 2) -> Mesh:
    """A square whose UVs are its own coordinates."""
    positions, faces = grid(n)
    return Mesh(positions, faces, attributes={"TEXCOORD_0": positions[:, :2].astype(np.float32)})


def cut_sheet() -> Mesh:
    """The square cut along x = ½: the right half lies elsewhere in the texture, its faces split by normals only."""
    positions, faces = grid(2)
    wedges = np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3)  # no wedge is shared
    uv = positions[faces.ravel(), :2].astype(np.float32)
    right = np.repeat(positions[faces, 0].mean(axis=1) > 0.5, 3)
    uv[right] += np.float32(2)
    return Mesh(positions, faces, wedges, {"TEXCOORD_0": uv})


def test_a_sheet_is_one_chart():
    charts = charts_of(sheet())
    assert charts.count == 1
    assert len(charts.borders) == 8
    assert len(seam_edges(sheet(), charts)) == 0
    assert charts.bounds[0].tolist() == [[0, 0]]
    assert charts.bounds[1].tolist() == [[1, 1]]


def test_equal_uvs_hang_together_whatever_the_wedges():
    mesh = cut_sheet()
    charts = charts_of(mesh)
    assert charts.count == 2
    assert {frozenset(edge) for edge in seam_edges(mesh, charts).tolist()} == {frozenset((3, 4)), frozenset((4, 5))}
    assert len(charts.borders) == 12


def test_zero_and_minus_zero_are_one_place():
    mesh = cut_sheet()
    uv = mesh.attributes["TEXCOORD_0"].copy()
    uv[uv == 0] *= np.where(np.arange((uv == 0).sum()) % 2, 1, -1).astype(np.float32)
    assert charts_of(Mesh(mesh.positions, mesh.faces, mesh.wedges, {"TEXCOORD_0": uv})).count == 2


def test_materials_have_texture_spaces_of_their_own():
    mesh = sheet(1)
    wedges = np.array([[0, 1, 2], [3, 4, 5]], np.int32)
    uv = mesh.attributes["TEXCOORD_0"][mesh.faces.ravel()]
    primitives = (Primitive(4, ("TEXCOORD_0",)), Primitive(2, ("TEXCOORD_0",)))
    charts = charts_of(Mesh(mesh.positions, mesh.faces, wedges, {"TEXCOORD_0": uv}, [0, 1], primitives))
    assert charts.count == 2
    assert charts.group.tolist() == [1, 0]


def test_faces_without_finite_uvs_have_no_chart():
    mesh = sheet(1)
    uv = mesh.attributes["TEXCOORD_0"].copy()
    uv[mesh.faces[1, 2]] = np.nan
    assert charts_of(Mesh(mesh.positions, mesh.faces, attributes={"TEXCOORD_0": uv})).rows.tolist() == [0]
    assert charts_of(Mesh(*box())).count == 0
