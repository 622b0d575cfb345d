"""The `recenter` plug-in, loaded as it lies in `plugins/`: where the model stands afterwards."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from chains import asset
from lodpipe.core.asset import Asset, Lod
from lodpipe.core.errors import InvalidMesh
from lodpipe.core.mesh import Mesh
from lodpipe.geometry.flatten import flatten
from lodpipe.plugins import find_stages
from lodpipe.stage import Context
from meshes import box

RECENTER = find_stages([Path(__file__).parents[2] / "plugins"], installed=False)["recenter"]


def run(source: Asset, **params):
    context = Context()
    return RECENTER(source, RECENTER.params(**params), context), context


def block() -> Asset:
    """A box of 1 × 2 × 4 with its lowest corner at (10, 20, 30), with a coarse level."""
    positions, faces = box()
    mesh = Mesh((positions + 0.5) * [1, 2, 4] + [10, 20, 30], faces)
    coarse = dataclasses.replace(mesh, faces=faces[:6], wedges=faces[:6], face_primitive=np.zeros(6, int))
    return Asset("block", (mesh,), lods=(Lod((mesh,)), Lod((coarse,))))


def scene() -> Asset:
    """The same box under a turned and scaled node, and once more elsewhere."""
    nodes = [
        {"name": "arm", "rotation": [0, 0, 0.5**0.5, 0.5**0.5], "scale": [2, 2, 2], "children": [1]},
        {"mesh": 0, "translation": [1, 0, 0]},
        {"mesh": 0},
    ]
    return dataclasses.replace(block(), document={"nodes": nodes, "scenes": [{"nodes": [0, 2]}], "scene": 0})


def bounds(source: Asset, level: int | None = None):
    return flatten(source, None if level is None else source.lods[level].meshes).bounds


@pytest.mark.parametrize("make", [block, scene])
@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_base_stands_on_the_ground_in_the_middle(make, up):
    result, _ = run(make(), pivot="base", up=up)
    low, high = bounds(result)
    axis = "xyz".index(up)
    middle = (low + high) / 2
    middle[axis] = low[axis]
    assert middle == pytest.approx([0, 0, 0], abs=1e-9)
    assert high - low == pytest.approx(np.subtract(*bounds(make())[::-1]))


@pytest.mark.parametrize("make", [block, scene])
def test_centre_and_size(make):
    result, context = run(make(), pivot="centre", size=1.0)
    low, high = bounds(result)
    assert low + high == pytest.approx([0, 0, 0], abs=1e-9)
    assert (high - low).max() == pytest.approx(1.0)
    assert [m.name for m in context.measurements] == ["scale", "moved"]


@pytest.mark.parametrize("make", [block, scene])
def test_origin_scales_about_the_origin(make):
    before, after = bounds(make()), bounds(run(make(), pivot="origin", size=2.0)[0])
    scale = 2.0 / (before[1] - before[0]).max()
    assert np.array(after) == pytest.approx(np.array(before) * scale)


@pytest.mark.parametrize("make", [block, scene])
def test_levels_move_with_the_source(make):
    source = make()
    result, _ = run(source, pivot="base", size=3.0)
    factor = 3.0 / (bounds(source)[1] - bounds(source)[0]).max()
    shift = bounds(result)[0] - bounds(source)[0] * factor
    for level in (0, 1):
        assert np.array(bounds(result, level)) == pytest.approx(np.array(bounds(source, level)) * factor + shift)
    assert result.lods[0].meshes[0] is result.meshes[0]


def test_a_scene_keeps_its_meshes_and_gets_one_root():
    source = scene()
    result, _ = run(source, pivot="centre")
    assert result.meshes[0] is source.meshes[0]
    assert result.document["scenes"][0]["nodes"] == [3]
    assert result.document["nodes"][3]["children"] == [0, 2]
    assert len(source.document["nodes"]) == 3


def test_what_is_in_place_is_left_alone():
    source = asset()
    assert run(source, pivot="centre")[0] is source
    assert run(source, pivot="origin")[0] is source


def test_a_point_cannot_be_scaled():
    point = Asset("point", (Mesh(np.ones((3, 3)), [[0, 1, 2]]),))
    with pytest.raises(InvalidMesh, match="the model has no extent, so it cannot be scaled; leave `size` out"):
        run(point, size=1.0)
