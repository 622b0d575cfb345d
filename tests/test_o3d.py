"""Questions to Open3D's ray scene."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from lodpipe.o3d import RayScene
from meshes import grid


def scene():
    """Three unit squares at z = 0, 1 and 2."""
    positions = np.concatenate([grid(1, height)[0] for height in (0.0, 1.0, 2.0)]).astype(np.float32)
    faces = np.concatenate([grid(1)[1] + np.int32(4 * k) for k in range(3)])
    positions.flags.writeable = faces.flags.writeable = False
    return RayScene(positions, faces)


DOWN = np.array([[0, 0, -1]], np.float32)
ABOVE = np.array([[0.75, 0.25, 5.0]], np.float32)


def test_the_first_hit():
    hits = scene().cast(np.concatenate([ABOVE, ABOVE + 9]), np.repeat(DOWN, 2, axis=0))
    assert hits.faces.tolist() == [4, -1]
    assert hits.distance.tolist() == pytest.approx([3.0, np.inf])
    assert hits.uv[0].tolist() == pytest.approx([0.5, 0.25])  # corners (0, 0), (1, 0), (1, 1)


def test_all_hits():
    found = scene().crossings(np.concatenate([ABOVE + 9, ABOVE]), np.repeat(DOWN, 2, axis=0))
    assert found.rays.tolist() == [1, 1, 1]
    order = np.argsort(found.distance)
    assert found.distance[order].tolist() == pytest.approx([3, 4, 5])
    assert found.faces[order].tolist() == [4, 2, 0]


def test_closest_points():
    points, faces = scene().closest(np.array([[0.75, 0.25, 1.2], [3, 0.25, 2.1]], np.float32))
    np.testing.assert_allclose(points, [[0.75, 0.25, 1], [1, 0.25, 2]], atol=1e-6)
    assert faces.tolist() == [2, 4]


def test_an_empty_scene():
    empty = RayScene(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))
    hits = empty.cast(ABOVE, DOWN)
    assert (hits.faces.tolist(), hits.distance.tolist(), hits.uv.shape) == ([-1], [np.inf], (1, 2))
    assert len(empty.crossings(ABOVE, DOWN).rays) == 0
    with pytest.raises(ValueError, match="without triangles"):
        empty.closest(ABOVE)


def test_no_questions():
    nothing = np.zeros((0, 3), np.float32)
    assert len(scene().cast(nothing, nothing).faces) == 0
    assert len(scene().crossings(nothing, nothing).faces) == 0
    assert len(scene().closest(nothing)[1]) == 0


def test_a_missing_library_is_said_in_one_line():
    code = (
        "import sys; sys.modules['open3d'] = None\n"
        "from lodpipe.core.errors import LodpipeError\n"
        "try:\n    import lodpipe.o3d\n"
        "except LodpipeError as error:\n    print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("Open3D cannot be loaded")
    assert "libgl1" in done.stdout
    assert len(done.stdout.splitlines()) == 1
