"""Defects counted on meshes small enough to count by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from chains import triangle_soup
from lodpipe.core.mesh import Mesh
from lodpipe.geometry.topology import TopologyDefects, components, topology_defects
from meshes import box, grid, sphere

NONE = TopologyDefects(1, 0, 0, 0, 0, 0, 0)


@pytest.mark.parametrize("scale", [1.0, 1e-19, 1e31])
def test_a_closed_surface_has_no_defects(scale):
    for positions, faces in (box(), sphere(2)):
        assert topology_defects(Mesh(positions * scale, faces)) == NONE


def test_a_border_is_counted():
    assert topology_defects(Mesh(*grid(3))) == dataclasses.replace(NONE, boundary_edges=12)


def test_parts_are_counted():
    assert topology_defects(triangle_soup(0, 3, 6)) == dataclasses.replace(NONE, components=3)


def test_a_fin_is_nonmanifold():
    positions, faces = box()
    fin = np.concatenate([positions, [[0, 0, 9]]]), np.concatenate([faces, [[*faces[0, :2], 8]]])
    assert topology_defects(Mesh(*fin)) == dataclasses.replace(NONE, nonmanifold_edges=1, boundary_edges=2)


def test_a_flipped_face_is_inconsistent_along_its_edges():
    positions, faces = box()
    faces[0] = faces[0, ::-1]
    assert topology_defects(Mesh(positions, faces)) == dataclasses.replace(NONE, inconsistent_winding=3)


def test_doubles_and_slivers_and_strays():
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [5, 5, 5]], float)
    faces = np.array([[0, 1, 2], [2, 1, 0], [1, 2, 0], [0, 1, 3], [1, 1, 2]])
    got = topology_defects(Mesh(positions, faces))
    assert (got.duplicate_faces, got.degenerate_faces, got.unused_positions, got.components) == (2, 2, 1, 1)


def test_an_empty_mesh_has_nothing():
    assert topology_defects(Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))) == dataclasses.replace(NONE, components=0)


@given(st.lists(st.tuples(*[st.integers(0, 19)] * 3), max_size=30))
def test_components_are_those_of_a_graph_search(triangles):
    faces = np.array(triangles, np.int32).reshape(-1, 3)
    groups = [{i} for i in range(20)]
    for triangle in triangles:
        joined = set().union(*(g for g in groups if g & set(triangle)))
        groups = [g for g in groups if not g & joined] + [joined]
    expected = {i: min(group) for group in groups for i in group}
    assert components(faces, 20).tolist() == [expected[i] for i in range(20)]


def test_a_long_chain_is_one_part():
    chain = np.stack([np.arange(5000), np.arange(5000) + 1, np.arange(5000) + 2], axis=1)
    shuffled = np.random.default_rng(0).permutation(5002)[chain].astype(np.int32)
    assert not components(shuffled, 5002).any()
