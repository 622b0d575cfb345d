"""A prefix of the record, applied to the source, is the level that the kernel emitted."""

from __future__ import annotations

import numpy as np
import pytest

from lodpipe.geometry.progressive import rebuild
from lodpipe.kernel import PLACEMENTS, decimate
from measures import components
from meshes import bumpy, grid, messy, moebius, terrain, torus, uv_sphere
from options import options

WEIGHTS = [0.1] * 2 + [0.05] * 3 + [0.05] * 4


def source(textured):
    return textured.positions, textured.faces, textured.wedges, textured.values


def bare(positions, faces):
    return positions, faces, faces, np.empty((len(positions), 0), np.float32)


def assert_same(level, built):
    """Equal but for the order of rows: face by face, corner by corner, the same places and values."""
    assert np.array_equal(built.face_source, np.sort(level.face_source))
    rows = np.argsort(level.face_source)
    assert np.array_equal(built.positions[built.faces], level.positions[level.faces[rows]])
    assert built.positions.shape == level.positions.shape
    assert np.array_equal(built.vertex_source[built.faces], level.vertex_source[level.faces[rows]])
    if level.values.shape[1]:
        # 32-bit values are scaled inside and back: the last bit may differ
        assert np.allclose(built.values[built.wedges], level.values[level.wedges[rows]], rtol=1e-6, atol=1e-7)
        assert built.values.shape == level.values.shape


def check(arrays, targets, setting, threads=1, **more):
    positions, faces, wedges, values = arrays
    weights = WEIGHTS[: values.shape[1]]
    result = decimate(
        positions,
        faces,
        targets,
        setting,
        wedges=wedges,
        values=values,
        column_weights=weights,
        threads=threads,
        **more,
    )
    for target, level in zip(targets, result.levels, strict=True):
        built = rebuild(*arrays, result.record, target)
        assert (built.stop == "triangles") == (level.stop == "triangles")
        assert_same(level, built)
    return result


@pytest.mark.parametrize("placement", PLACEMENTS)
@pytest.mark.parametrize("mesh", [bumpy, terrain, torus, moebius, messy, lambda: grid(12)])
def test_each_level_is_rebuilt(mesh, placement):
    arrays = bare(*mesh())
    count = len(arrays[1])
    check(arrays, [count, count // 2, count // 5, 20], options(placement=placement, record=True))


@pytest.mark.parametrize("placement", PLACEMENTS)
@pytest.mark.parametrize("steering", [True, False])
def test_with_wedges(placement, steering):
    setting = options(placement=placement, attribute_cost=steering, record=True)
    check(source(uv_sphere(24, 32, materials=2)), [1000, 500, 200, 60], setting)


@pytest.mark.parametrize("keep_topology", [True, False])
def test_from_many_threads(keep_topology):
    ball = uv_sphere(128, 256)
    rough = ball.positions * (1 + 0.01 * np.random.default_rng(0).random((len(ball.positions), 1)))
    arrays = (rough, ball.faces, ball.wedges, ball.values)
    check(arrays, [50_000, 30_000], options(record=True, keep_topology=keep_topology), threads=3)


def test_locks_and_errors_that_stop_a_level():
    positions, faces = bumpy()
    setting = options(record=True, may_relax=False)
    stopped = check(bare(positions, faces), [100, 10], setting, locked=positions[:, 2] > 0)
    assert stopped.levels[1].stop != "triangles"
    stopped = check(bare(positions, faces), [100, 10], options(record=True, max_error=0.02))
    assert stopped.levels[1].stop == "error"


def test_any_level_between():
    arrays = bare(*bumpy())
    result = check(arrays, [60], options(record=True))
    sizes = [len(rebuild(*arrays, result.record, target).faces) for target in range(512, 58, -1)]
    assert all(target - 1 <= size <= target for target, size in zip(range(512, 59, -1), sizes, strict=False))
    alone = decimate(*arrays[:2], [200], options()).levels[0]
    between = rebuild(*arrays, result.record, 200)
    assert len(between.faces) == 200 and components(between.faces) == 1
    assert between.error == pytest.approx(alone.error, rel=0.5)


def test_nothing_and_everything():
    arrays = bare(*bumpy())
    result = check(arrays, [60], options(record=True))
    whole = rebuild(*arrays, result.record, 10_000)
    assert np.array_equal(whole.positions[whole.faces], arrays[0][arrays[1]]) and whole.error == 0
    assert (whole.vertex_source >= 0).all() and whole.stop == "triangles"
    last = rebuild(*arrays, result.record, 3)  # the record ends before
    assert len(last.faces) == 60 and last.stop != "triangles"


def test_the_source_is_not_changed():
    arrays = source(uv_sphere(12, 16))
    before = [a.copy() for a in arrays]
    record = check(arrays, [100], options(record=True)).record
    rebuild(*arrays, record, 100)
    assert all(np.array_equal(a, b) for a, b in zip(arrays, before, strict=True))
