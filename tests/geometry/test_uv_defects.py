"""Figures of UV layouts, on meshes whose answers are known."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from lodpipe import io
from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.geometry.uv_defects import UvFigures, bleeding_mip, texture_sizes, uv_defects
from meshes import box, grid

ASSETS = Path(__file__).parents[3] / "shared" / "assets" / "dev"


def squares(*places, size=1.0, flip=()):
    """Unit squares far apart in space; their UVs are squares of `size` at `places`, mirrored where `flip` says so."""
    positions, faces = grid(1)
    uv = positions[:, :2] * [1, -1] + [0, 1]  # v points down: not mirrored
    points = [positions + np.array([3 * i, 0, 0]) for i in range(len(places))]
    sides = [np.where(i in flip, uv * [-1, 1] + [1, 0], uv) * size + place for i, place in enumerate(places)]
    rows = np.concatenate([faces + 4 * i for i in range(len(places))]).astype(np.int32)
    return Mesh(np.concatenate(points), rows, attributes={"TEXCOORD_0": np.concatenate(sides).astype(np.float32)})


def figures(mesh: Mesh, **sizes) -> UvFigures:
    (found,) = uv_defects(mesh, **sizes)
    return found


def test_a_clean_layout():
    found = figures(squares((0, 0), (0.5, 0.5), size=0.25))
    assert dataclasses.asdict(found) == {
        "set": "TEXCOORD_0",
        "charts": 2,
        "overlap_percent": 0.0,
        "overlap_kind": "none",
        "flipped_percent": 0.0,
        "mixed_charts": 0,
        "out_of_range_percent": 0.0,
        "tiles": 1,
        "zero_area_faces": 0,
        "missing_faces": 0,
        "min_gutter_texels": 64.0,
        "bleeding_mip": 5,
        "sliver_charts": 0,
        "stretch_l2": pytest.approx(1.0),
        "stretch_max": pytest.approx(1.0),
        "density_cv": pytest.approx(0.0, abs=1e-9),
        "density_p5_p95": pytest.approx(1.0),
        "seam_length": 0.0,
    }


@pytest.mark.parametrize(
    ("mesh", "percent", "kind"),
    [
        (squares((0, 0), (0.5, 0), size=0.5), 0.0, "none"),
        (squares((0, 0), (0, 0)), 100.0, "stack"),
        (squares((0, 0), (0, 0), flip=[1]), 100.0, "mirror"),
        (squares((0, 0), (0.25, 0), size=0.5), 100 / 3, "accident"),
        (squares((0, 0), (0.125, 0), (0.25, 0), size=0.25), 50.0, "accident"),
    ],
)
def test_overlaps(mesh, percent, kind):
    found = figures(mesh)
    assert found.overlap_percent == pytest.approx(percent, abs=1e-6)
    assert found.overlap_kind == kind


def test_a_chart_that_folds_over_itself():
    mesh = squares((0, 0))
    uv = np.array([[0, 0], [0, 1], [0.2, 0.8], [1, 1]])  # one corner pulled over the diagonal
    folded = Mesh(mesh.positions, mesh.faces, attributes={"TEXCOORD_0": uv})
    assert figures(folded).overlap_kind == "fold"
    assert figures(folded).mixed_charts == 1


def test_an_overlap_too_small_for_scan_lines_is_not_lost():
    found = figures(squares((0, 0), (1 - 1e-5, 0)))
    assert found.overlap_kind == "accident"
    assert found.overlap_percent == pytest.approx(1e-3 / 2, rel=0.02)


def test_what_lies_in_different_textures_does_not_overlap():
    mesh = squares((0, 0), (0, 0))
    primitives = tuple(Primitive(i, ("TEXCOORD_0",)) for i in range(2))
    both = Mesh(mesh.positions, mesh.faces, None, mesh.attributes, [0, 0, 1, 1], primitives)
    assert figures(both).overlap_percent == 0
    assert figures(both).min_gutter_texels == 64


def test_mirrored_faces():
    assert figures(squares((0, 0), (2, 0), (4, 0), (6, 0), flip=[2])).flipped_percent == pytest.approx(25)


def test_outside_and_tiles():
    found = figures(squares((0, 0), (1, 0), (2, 3), (-0.5, 0)))
    assert found.out_of_range_percent == 75
    assert found.tiles == 4  # 0,0; 1,0; 2,3; −1,0
    assert figures(squares((0.25, 0.25), size=3)).tiles == 16
    assert figures(squares((0, 0), (1e9, 1e9))).tiles > 1e9  # whatever it is, in no time


def test_gutters_are_measured_in_texels_of_the_texture():
    mesh = squares((0, 0), (0.26, 0), size=0.25)
    assert figures(mesh).min_gutter_texels == pytest.approx(0.01 * 1024, rel=1e-3)
    found = figures(mesh, sizes={-1: (300, 4000)})
    assert (found.min_gutter_texels, found.bleeding_mip) == (pytest.approx(3.0, rel=1e-3), 1)


@pytest.mark.parametrize(("gutter", "level"), [(0, 0), (2.9, 0), (3, 1), (5.9, 1), (6, 2), (12, 3), (64, 5)])
def test_the_mip_at_which_charts_bleed(gutter, level):
    assert bleeding_mip(gutter) == level


def test_faces_without_area_and_without_uvs():
    mesh = squares((0, 0), (0.5, 0.5), size=0.4)
    uv = mesh.attributes["TEXCOORD_0"].copy()
    uv[4:] = uv[4]
    primitives = (Primitive(None, ("TEXCOORD_0",)), Primitive(None, ()))
    wedges = np.array([[0, 1, 2], [8, 9, 10], [4, 5, 6], [4, 6, 7]])
    wedges[:, :] = np.where(wedges > 7, wedges, mesh.faces)
    uv = np.concatenate([uv, np.zeros((3, 2), np.float32)])
    found = figures(Mesh(mesh.positions, mesh.faces, wedges, {"TEXCOORD_0": uv}, [0, 1, 0, 0], primitives))
    assert (found.zero_area_faces, found.missing_faces) == (2, 1)
    assert figures(Mesh(*box())).missing_faces == 12
    point = Mesh(np.zeros((3, 3)), [[0, 1, 2]], attributes={"TEXCOORD_0": np.zeros((3, 2), np.float32)})
    assert figures(point).zero_area_faces == 0  # it has no area in space either


def test_stretch_and_density():
    mesh = squares((0, 0))
    wide = Mesh(mesh.positions * [4, 1, 1], mesh.faces, attributes=mesh.attributes)
    # singular values 2 and ½ of an affine map of area 1: √((4 + ¼) / 2)
    assert figures(wide).stretch_l2 == pytest.approx(np.sqrt(2.125))
    assert figures(wide).stretch_max == pytest.approx(2)
    assert figures(wide, sizes={-1: (4096, 1024)}).stretch_l2 == pytest.approx(1)
    two = squares((0, 0), (2, 2))
    positions = two.positions.copy()
    positions[4:] *= 2  # four times the area for the same texels
    found = figures(Mesh(positions, two.faces, attributes=two.attributes))
    mean = (1 * 1 + 0.5 * 4) / 5
    assert found.density_cv == pytest.approx(np.sqrt(((1 - mean) ** 2 + 4 * (0.5 - mean) ** 2) / 5) / mean)
    assert found.density_p5_p95 == pytest.approx(2)


def test_seams():
    positions, faces = grid(2)
    uv = positions[faces.ravel(), :2].astype(np.float32)
    uv[np.repeat(positions[faces, 0].mean(axis=1) > 0.5, 3)] += np.float32(2)
    wedges = np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3)
    assert figures(Mesh(positions, faces, wedges, {"TEXCOORD_0": uv})).seam_length == pytest.approx(1 / np.sqrt(2))


def test_figures_do_not_depend_on_place_or_scale():
    mesh = squares((0, 0), (0.5, 0.1), size=0.3, flip=[1])
    far = Mesh(mesh.positions * 1e-6 + 1e3, mesh.faces, attributes=mesh.attributes)
    for a, b in zip(dataclasses.astuple(figures(mesh)), dataclasses.astuple(figures(far)), strict=True):
        assert a == (b if isinstance(b, str) else pytest.approx(b, rel=1e-5, abs=1e-5))


def test_the_texture_of_a_material_counts_with_its_transform():
    from lodpipe.core.asset import Asset
    from lodpipe.core.material import Image, Material

    info = {"index": 0, "extensions": {"KHR_texture_transform": {"scale": [2, -0.5]}}}
    materials = (Material({"emissiveTexture": {"index": 0}}), Material({"normalTexture": info}), Material({}))
    asset = Asset("a", (), materials, (Image(b"x", width=64, height=32),), {"textures": [{"source": 0}]})
    assert texture_sizes(asset) == {0: (64, 32), 1: (128, 16)}


@pytest.mark.skipif(not ASSETS.is_dir(), reason="needs the shared assets")
@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("duck.glb", {"overlap_kind": "mirror", "flipped_percent": 50.1}),
        ("textured_dragon/dragon.obj", {"flipped_percent": 100, "missing_faces": 0}),
        ("spot_cow/cow.obj", {"out_of_range_percent": 0.171, "tiles": 3}),
        ("spider_backslash/spider.obj", {"flipped_percent": 46.0}),
        ("barrel.glb", {"overlap_percent": 0, "zero_area_faces": 0}),
        ("pig.off", {"missing_faces": 39930, "charts": 0}),
    ],
)
def test_real_models_are_as_their_notes_say(path, expected):
    asset = io.load(ASSETS / path)
    found = dataclasses.asdict(uv_defects(asset.meshes[0], texture_sizes(asset))[0])
    assert {name: found[name] for name in expected} == {
        name: value if isinstance(value, str) else pytest.approx(value, rel=2e-3) for name, value in expected.items()
    }
