"""Pictures of what is seen from outside: equal to the slow form, to itself on any number of threads, and checked."""

from __future__ import annotations

import numpy as np
import pytest

from lodpipe import kernel
from lodpipe.core.errors import InvalidMesh
from lodpipe.geometry.camera import views
from lodpipe.kernel import visibility_reference
from meshes import bumpy, grid, sphere


def nested(outer, inner):
    """Two surfaces as one, within the unit sphere, and the second half of the first one as glass."""
    positions = np.vstack([outer[0], inner[0]]).astype(np.float32)
    positions /= np.linalg.norm(positions, axis=1).max() * 1.01
    hides = np.ones(len(outer[1]) + len(inner[1]), bool)
    hides[len(outer[1]) // 2 : len(outer[1])] = False
    return positions, np.vstack([outer[1], inner[1] + len(outer[0])]).astype(np.int32), hides


@pytest.mark.parametrize("case", [(bumpy(2, 0.1), sphere(2, radius=0.4)), (grid(5), bumpy(1, 0.2))])
def test_equal_to_the_slow_form(case):
    positions, faces, hides = nested(*case)
    fast = kernel.vertex_visibility(positions, faces, hides, views(6)[:3], 37)
    slow = visibility_reference.vertex_visibility(positions, faces, hides, views(6)[:3], 37)
    assert 0.05 < slow.mean() < 0.98  # there was something to hide
    np.testing.assert_allclose(fast, slow, atol=1e-4)


def test_any_number_of_threads_gives_the_same_bytes():
    positions, faces, hides = nested(bumpy(5, 0.1), sphere(4, radius=0.5))
    one, two, three = (
        kernel.vertex_visibility(positions, faces, hides, views(20)[:10], 100, threads) for threads in (1, 2, 3)
    )
    assert one.tobytes() == two.tobytes() == three.tobytes()


def test_degenerate_faces_and_the_sphere_s_rim():
    positions = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, 0], [0, 0, 0]], np.float32)
    faces = np.array([[0, 1, 2], [5, 6, 5], [0, 5, 1], [4, 4, 4]], np.int32)
    cardinal = np.concatenate([np.eye(3), -np.eye(3)])
    seen = kernel.vertex_visibility(positions, faces, np.ones(4, bool), cardinal, 64)
    assert np.isfinite(seen).all() and seen[:3].min() > 0.9 and seen[3] == 0
    assert kernel.vertex_visibility(positions, faces[:0], np.ones(0, bool), cardinal, 8).tolist() == [0] * 7


def test_arrays_that_do_not_fit_are_refused():
    positions, faces = sphere(1)
    good = {"positions": positions.astype(np.float32), "faces": faces, "hides": np.ones(len(faces), bool)}
    good |= {"views": views(4), "side": 9}
    kernel.vertex_visibility(**good)
    for name, bad in (
        ("positions", good["positions"] * 2),
        ("positions", good["positions"] * np.float32(np.nan)),
        ("faces", faces + 1),
        ("hides", good["hides"][1:]),
        ("side", 0),
    ):
        with pytest.raises(InvalidMesh):
            kernel.vertex_visibility(**{**good, name: bad})
