import numpy as np
import pytest

import meshes
from lodpipe.core.errors import InvalidMesh
from lodpipe.kernel.surfaces import Silhouettes

AXES = np.linalg.qr(np.random.default_rng(5).normal(size=(4, 3, 3)))[0][:, :2]


def drawn(points, faces, size):
    """(N, size, size) bool: pixels whose centre lies in a triangle's shadow, by signed areas."""
    at = (np.arange(size) + 0.5) / size * 2 - 1
    x, y = np.meshgrid(at, at)
    pictures = np.zeros((len(AXES), size, size), bool)
    for view, axes in enumerate(AXES):
        for a, b, c in (points @ axes.T)[faces]:
            sides = [(q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) for p, q in ((a, b), (b, c), (c, a))]
            pictures[view] |= np.all([s >= 0 for s in sides], axis=0) | np.all([s <= 0 for s in sides], axis=0)
    return pictures


def overlap(a, b):
    return ((a & b).sum(axis=(1, 2)) / np.maximum((a | b).sum(axis=(1, 2)), 1)).mean()


def ball():
    points, faces = meshes.sphere()
    return points * 0.7, faces.astype(np.int32)


@pytest.mark.parametrize("size", [20, 64, 100])
def test_bits_are_those_of_the_reference(size):
    points, faces = ball()
    found = Silhouettes(points, faces, AXES, size)
    bits = np.unpackbits(found.bits.reshape(len(AXES), size, -1).view(np.uint8), axis=2, bitorder="little")
    assert np.array_equal(bits[:, :, :size].astype(bool), drawn(points, faces, size))


def test_overlaps_of_moved_vertices_are_those_of_the_moved_meshes():
    points, faces = ball()
    found = Silhouettes(points, faces, AXES, 64)
    assert found.overlap(points, faces) == 1
    rng = np.random.default_rng(0)
    vertex = rng.integers(len(points), size=20).astype(np.int32)
    places = rng.uniform(-1.2, 1.2, size=(20, 3))  # some beside the picture
    expected = []
    for v, place in zip(vertex, places, strict=True):
        moved = points.copy()
        moved[v] = place
        expected.append(overlap(drawn(moved, faces, 64), drawn(points, faces, 64)))
    assert found.overlaps_moved(points, faces, vertex, places) == pytest.approx(expected)
    one = Silhouettes(points, faces, AXES, 64, threads=1)
    assert np.array_equal(
        found.overlaps_moved(points, faces, vertex, places), one.overlaps_moved(points, faces, vertex, places)
    )


def test_what_does_not_fit_is_told():
    points, faces = ball()
    found = Silhouettes(points, faces, AXES, 8)
    with pytest.raises(InvalidMesh, match="vertices to move"):
        found.overlaps_moved(points, faces, np.array([len(points)], np.int32), np.zeros((1, 3)))
    with pytest.raises(InvalidMesh, match="not finite"):
        found.overlap(np.full_like(points, np.nan), faces)
    nothing = Silhouettes(points[:0], faces[:0], AXES, 8)
    assert nothing.overlap(points[:0], faces[:0]) == 1
