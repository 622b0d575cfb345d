"""The `drop_small_parts` plug-in, loaded as it lies in `plugins/`: what is dropped from which level, and what never."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from lodpipe.core.asset import Asset, ErrorFigures, Lod, Switch
from lodpipe.core.mesh import Mesh
from lodpipe.plugins import find_stages
from lodpipe.stage import Context
from meshes import box

DROP = find_stages([Path(__file__).parents[2] / "plugins"], installed=False)["drop_small_parts"]
SIZES = (1.0, 0.1, 0.01)


def parts(**fields) -> Mesh:
    """Three unconnected cubes of SIZES, some way apart."""
    positions, faces = box()
    return Mesh(
        np.concatenate([positions * size + [3.0 * i, 0, 0] for i, size in enumerate(SIZES)]),
        np.concatenate([faces + 8 * i for i in range(len(SIZES))]),
        **fields,
    )


def model(*screens: float, mesh: Mesh | None = None, **fields) -> Asset:
    mesh = mesh or parts()
    levels = [Lod((mesh,), switch=Switch(1.0, 0.0))]
    levels += [Lod((mesh,), switch=Switch(share, 1.0), error=ErrorFigures(0.1, 0.1, 0.1)) for share in screens]
    return Asset("parts", (mesh,), lods=tuple(levels), **fields)


def run(source: Asset, **params) -> tuple[Asset, Context]:
    context = Context()
    return DROP(source, DROP.params(**params), context), context


def cubes(result: Asset) -> list[int]:
    return [level.triangles // 12 for level in result.lods]


def screen_that_shows(size: float, pixels: float = 1.0, height: int = 1080) -> float:
    """The share of the screen's height at which a cube of `size` is just so many pixels large."""
    low, high = parts().positions.min(axis=0), parts().positions.max(axis=0)
    return pixels * float(np.linalg.norm(high - low)) / (size * math.sqrt(3) * height)


def test_a_part_goes_when_it_is_smaller_than_a_pixel():
    for size, left in ((0.01, 2), (0.1, 1)):
        just = screen_that_shows(size)
        assert cubes(run(model(just * 1.001))[0]) == [3, left + 1]
        assert cubes(run(model(just * 0.999))[0]) == [3, left]


def test_pixels_and_height_scale_the_bound():
    just = screen_that_shows(0.1, pixels=4.0, height=500)
    assert cubes(run(model(just * 1.001), pixels=4.0, height=500)[0]) == [3, 2]
    assert cubes(run(model(just * 0.999), pixels=4.0, height=500)[0]) == [3, 1]


def test_level_0_and_the_largest_part_stay():
    result, context = run(model(1e-6))
    assert cubes(result) == [3, 1]
    assert np.ptp(result.lods[1].meshes[0].positions[result.lods[1].meshes[0].faces][..., 0]) == pytest.approx(1.0)
    assert [(m.name, m.value) for m in context.measurements] == [("triangles dropped from level 1", 24)]


def test_a_measured_error_is_forgotten_where_something_went():
    result, _ = run(model(1.0, 1e-6))
    assert result.lods[1].error == ErrorFigures(0.1, 0.1, 0.1)
    assert result.lods[2].error is None


def test_the_largest_placement_of_a_mesh_decides():
    """A mesh of three cubes beside one that is 200 times as large: alone it loses two of them, placed large none."""
    large = Mesh(box()[0] * 200, box()[1])

    def left(scale: float) -> int:
        nodes = [{"mesh": 0}, {"mesh": 1}, {"mesh": 0, "scale": [scale] * 3}]
        meshes = (parts(), large)
        lods = (Lod(meshes), Lod(meshes, switch=Switch(0.5, 1.0)))
        source = Asset("two", meshes, lods=lods, document={"nodes": nodes, "scenes": [{"nodes": [0, 1, 2]}]})
        return len(run(source)[0].lods[1].meshes[0].faces) // 12

    assert left(1.0) == 1
    assert left(30.0) == 2


def test_meshes_that_may_not_be_changed_stay():
    assert cubes(run(model(1e-6, mesh=parts(keep_reason="skinned")))[0]) == [3, 3]


def test_attributes_stay_with_their_faces():
    mesh = parts()
    uv = np.random.default_rng(0).random((24, 2)).astype(np.float32)
    textured = Mesh(mesh.positions, mesh.faces, attributes={"TEXCOORD_0": uv})
    kept = run(model(1e-6, mesh=textured))[0].lods[1].meshes[0]
    assert np.array_equal(kept.positions[kept.faces], mesh.positions[mesh.faces[:12]])
    assert np.array_equal(kept.attributes["TEXCOORD_0"][kept.wedges], uv[mesh.faces[:12]])


def test_without_levels_nothing_happens():
    source = Asset("parts", (parts(),))
    assert run(source)[0].lods == ()
