"""Plans and layouts of repairs: what has to move, where to, and whether anything is worse for it."""

from __future__ import annotations

import dataclasses

import numpy as np

from lodpipe.core.asset import Asset, Lod
from lodpipe.core.material import Image, Material
from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.geometry.bake import groups_of
from lodpipe.geometry.repair import RepairOptions, new_layout, plan, with_worst_anew, worsened
from lodpipe.geometry.uv_defects import stretch_of, uv_defects
from lodpipe.kernel.layout import uv_overlaps
from meshes import grid

SIDE = 256
STRICT = RepairOptions(one_to_one=True)


def sheets(*boxes, materials=None) -> Asset:
    """Square sheets apart in space, each with its (low, high) box of UVs and its material."""
    positions, faces = grid(4)
    count, flat = len(positions), positions[:, :2]
    uv = np.concatenate([np.array(low) + flat * (np.array(high) - low) for low, high in boxes])
    points = np.concatenate([positions + np.array([1.5 * i, 0, 0.1 * i]) for i in range(len(boxes))])
    rows = np.concatenate([faces + count * i for i in range(len(boxes))])
    materials = materials or [0] * len(boxes)
    owner = np.repeat(materials, len(faces)).astype(np.int32)
    primitives = tuple(Primitive(i, ("TEXCOORD_0",)) for i in range(max(materials) + 1))
    mesh = Mesh(points, rows, None, {"TEXCOORD_0": uv.astype(np.float32)}, owner, primitives, name="sheets")
    paints = tuple(
        Material({"name": f"m{i}", "pbrMetallicRoughness": {"baseColorTexture": {"index": i}}})
        for i in range(max(materials) + 1)
    )
    images = tuple(Image(b"x", width=SIDE >> i, height=SIDE >> i) for i in range(len(paints)))
    document = {"textures": [{"source": i} for i in range(len(paints))], "samplers": []}
    return Asset("sheets", (mesh,), paints, images, document, lods=(Lod((mesh,)),))


def planned(asset: Asset, options=STRICT, merge=False):
    return plan(asset, groups_of(asset, asset.meshes, merge), options)


A, B = ((0.0625, 0.0625), (0.4375, 0.9375)), ((0.5625, 0.0625), (0.9375, 0.9375))


def test_reasons():
    assert planned(sheets(A, B))[0].reasons == ()
    assert planned(sheets(A, A))[0].reasons == ("overlaps", "charts 0 texels apart")
    assert planned(sheets(A, A), RepairOptions())[0].reasons == ()
    outside = sheets(((0.0, 0.0), (2.0, 3.0)))
    assert planned(outside)[0].reasons == ("UVs outside the texture",)
    near = sheets(A, ((0.4385, 0.0625), (0.9375, 0.9375)))
    assert planned(near)[0].reasons == ("charts 0.26 texels apart",)


def test_charts_move_by_blocks_of_texels_and_keep_their_distance():
    asset = sheets(A, A, A)
    (only,) = planned(asset)
    uv, side, scale, problem = new_layout(asset, only, STRICT)
    assert (scale, problem) == (1.0, "")
    assert uv.min() >= 2 and uv.max() <= side - 2
    (_, rows), (own,) = only.group.parts[0], only.charts
    old, new = own.uv * SIDE, uv[np.searchsorted(rows, own.rows)]
    for face in np.unique(own.label, return_index=True)[1]:
        edges = [corners[face, 1:] - corners[face, :1] for corners in (old, new)]
        turn = np.linalg.solve(*edges)  # a quarter turn, or none
        assert np.allclose(np.abs(turn), np.abs(np.rint(turn)), atol=1e-3)
        shift = (new[face, 0] - old[face, 0] @ np.rint(turn)) / 8
        assert np.allclose(shift, np.rint(shift), atol=1e-3)
    assert not len(uv_overlaps(uv, own.label, np.zeros(len(uv), np.int32)).charts)


def test_mirrored_halves_that_hang_together_are_cut_apart_and_copied():
    """A sheet folded over in the middle of its texture: nothing is unfolded anew."""
    asset = sheets(A)
    (mesh,) = asset.meshes
    uv = mesh.attributes["TEXCOORD_0"] - np.float32([0.25, 0.5])
    folded = np.abs(uv) * [1, 0] + uv * [0, 1] + np.array([0.25, 0.5])
    mesh = dataclasses.replace(mesh, attributes={"TEXCOORD_0": folded.astype(np.float32)})
    (only,) = planned(dataclasses.replace(asset, meshes=(mesh,), lods=(Lod((mesh,)),)))
    assert "overlaps" in only.reasons
    assert not only.anew[0].any()
    assert only.charts[0].count == 2


def test_materials_of_two_sizes_in_one_atlas_keep_their_texels():
    asset = sheets(A, A, materials=[0, 1])
    (both,) = planned(asset, merge=True)
    assert both.group.materials == [0, 1]
    uv, _, scale, _ = new_layout(asset, both, STRICT)
    area = np.abs(np.linalg.det(uv[:, 1:] - uv[:, :1])) / 2
    expected = np.prod(np.diff(A, axis=0)) * np.array([SIDE**2, (SIDE / 2) ** 2])
    assert scale == 1.0
    assert np.allclose([area[: len(area) // 2].sum(), area[len(area) // 2 :].sum()], expected, rtol=1e-3)


def test_stretch_is_that_of_the_figures():
    asset = sheets(A, ((0.5, 0.1), (0.9, 0.2)))
    (mesh,) = asset.meshes
    uv = mesh.attributes["TEXCOORD_0"][mesh.wedges].astype(np.float64)
    parts = stretch_of(mesh.positions[mesh.faces], uv * SIDE)
    figures = uv_defects(mesh, {0: (SIDE, SIDE)})[0]
    assert np.isclose(np.sqrt(np.square(parts).sum()), figures.stretch_l2, rtol=1e-6)


def test_faces_that_a_layout_stretches_more_are_unfolded_anew():
    asset = sheets(A, A)
    (only,) = planned(asset)
    uv, *_ = new_layout(asset, only, STRICT)
    assert with_worst_anew(asset, only, uv) is None
    squeezed = uv.copy()
    squeezed[:3, :, 0] = squeezed[:3, :1, 0] + (squeezed[:3, :, 0] - squeezed[:3, :1, 0]) * 0.01
    again = with_worst_anew(asset, only, squeezed)
    assert again is not None
    assert {0, 1, 2} <= set(np.flatnonzero(again.anew[0]))
    assert again.anew[0].sum() <= 6


def test_every_figure_of_the_table_is_held():
    (before,) = uv_defects(sheets(A, B).meshes[0], {0: (SIDE, SIDE)})
    assert worsened(before, before, 4) == []
    changes = {
        "overlap_percent": 1.0,
        "out_of_range_percent": 1.0,
        "zero_area_faces": 1,
        "missing_faces": 1,
        "stretch_l2": before.stretch_l2 * 1.1,
        "density_cv": before.density_cv + 0.1,
        "min_gutter_texels": 1.0,
    }
    for name, value in changes.items():
        told = worsened(before, dataclasses.replace(before, **{name: value}), 4)
        assert len(told) == 1 and told[0].startswith(name)
    assert worsened(before, dataclasses.replace(before, min_gutter_texels=5.0), 4) == []
    missing = dataclasses.replace(before, missing_faces=3)
    assert worsened(missing, dataclasses.replace(before, density_cv=9.0), 4) == []
