import dataclasses

import numpy as np
import pytest

import limbs
from lodpipe import kernel
from lodpipe.core.mesh import Mesh
from lodpipe.geometry.camera import views
from lodpipe.geometry.carve import Goal, carved, polished
from lodpipe.geometry.topology import topology_defects
from lodpipe.kernel.surfaces import Silhouettes


@pytest.fixture(scope="module")
def star():
    """A star of five arms in a unit ball, its tips, a level of 60 triangles, and what is wanted."""
    mesh = limbs.star(5, radius=0.1)
    points = mesh.positions / np.linalg.norm(mesh.positions, axis=1).max()
    out = limbs_ends(5)
    rows = [int((points @ end).argmax()) for end in out]
    tips, locked = points[rows], np.zeros(len(points), bool)
    locked[rows] = True
    (level,) = kernel.decimate(points, mesh.faces, [60], locked=locked).levels
    directions = views(16)
    right = np.cross(directions, np.eye(3)[np.abs(directions).argmin(axis=1)])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    axes = np.stack([right, np.cross(directions, right)], axis=1) / 1.1
    return level, Goal(Silhouettes(points, mesh.faces, axes, 64), tips, 0.08)


def limbs_ends(arms, turn=0.3):
    i = np.arange(arms) + 0.5
    z = 1 - 2 * i / arms
    angle = np.pi * (1 + 5**0.5) * i + turn
    return np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], axis=1)


def test_branches_survive_down_to_ten_triangles(star):
    level, goal = star
    small, points = carved(level, level.positions, goal, 10, 1.0)
    assert len(small.faces) <= 10
    assert goal.survivors(points) == 5
    defects = topology_defects(Mesh(points, small.faces))
    assert (defects.boundary_edges, defects.nonmanifold_edges, defects.components) == (0, 0, 1)
    assert len(small.face_source) == len(small.faces)
    assert len(small.wedges) == len(small.faces)
    assert small.wedges.max() < len(small.values)


def test_polishing_only_makes_it_better(star):
    level, goal = star
    small, points = carved(level, level.positions, goal, 16, 1.0)
    better = polished(points, small.faces, goal, 1.0)
    assert goal.score(better, small.faces, 1.0) > goal.score(points, small.faces, 1.0) + 0.01
    assert goal.survivors(better) == goal.survivors(points)


def test_wedges_stay_with_their_vertex(star):
    """Values that say where their vertex is: after collapses each corner's still belong to the corner's vertex."""
    level, goal = star
    marked = dataclasses.replace(
        level, wedges=level.faces, values=level.positions.astype(np.float32), wedge_source=level.vertex_source
    )
    small, points = carved(marked, level.positions, goal, 20, 0.01)
    assert small.values[small.wedges] == pytest.approx(points[small.faces], abs=1e-6)
