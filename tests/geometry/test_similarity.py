"""What assets look like to the similarity decimator, and whole assets through it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lodpipe.core.asset import Asset, Target
from lodpipe.core.errors import Cancelled, InvalidMesh
from lodpipe.core.material import Material
from lodpipe.core.mesh import Mesh
from lodpipe.geometry.decimate import decimate_asset
from lodpipe.geometry.similarity import luminance_image
from lodpipe.kernel.similarity import SimilarityOptions
from meshes import Textured, bumpy, cubes, grid, islands, uv_sphere

METHODS = {
    "ray": SimilarityOptions(views=4),
    "uv": SimilarityOptions(views=4, correspondence="uv"),
    "local": SimilarityOptions(views=4, reference="previous"),
    "full": SimilarityOptions(views=4, collapse="full"),
    "deviation": SimilarityOptions(metric="texture_deviation"),
    "image": SimilarityOptions(metric="image", image_size=32),
}
DOCUMENT = {"textures": [{"source": 0}], "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}], "scene": 0}


def painted(mesh: Mesh, document=DOCUMENT, **material) -> Asset:
    """The mesh with a base colour texture for its first material, plain for the others."""
    texture = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, **material}
    others = [Material({})] * (len(mesh.primitives) - 1)
    return Asset("painted", (mesh,), (Material(texture), *others), document=document)


def stripes(across: int = 2, size: int = 64):
    """(size, size, 3): dark and light bands along u."""
    band = np.where(np.arange(size) * across // size % 2, 230, 25)
    return np.broadcast_to(band[None, :, None], (size, size, 3)).astype(np.uint8)


def levels(asset, options, *counts, pixels=None, **more):
    return decimate_asset(asset, [Target(triangles=n) for n in counts], options, pixels=pixels or {}, **more)[1:]


@pytest.mark.parametrize("method", METHODS)
def test_levels_of_a_textured_mesh_with_seams_and_two_materials(method):
    asset = painted(uv_sphere(12, 16, materials=2).mesh())
    found = levels(asset, METHODS[method], 200, 60, pixels={0: stripes()})
    assert [level.triangles for level in found] == [200, 60]
    for level in found:
        mesh = level.meshes[0]
        assert set(mesh.attributes) == set(asset.meshes[0].attributes)
        assert np.isfinite(mesh.attributes["TEXCOORD_0"]).all()
        assert level.stop_reason == "target"


@pytest.mark.parametrize("method", METHODS)
def test_threads_do_not_matter(method):
    asset = painted(uv_sphere(12, 16).mesh())
    prints = [
        [
            level.meshes[0].fingerprint()
            for level in levels(asset, METHODS[method], 150, 40, pixels={0: stripes()}, threads=t)
        ]
        for t in (1, 2, 3)
    ]
    assert prints[0] == prints[1] == prints[2]


def sheet() -> Mesh:
    """A nearly flat square; lines of equal u are waves along y, so that a texture's edge needs vertices."""
    positions, faces = grid(24)
    positions = positions + 0.0005 * np.random.default_rng(0).normal(size=positions.shape)
    uv = positions[:, :2].astype(np.float32)
    uv[:, 0] += np.float32(0.06) * np.sin(4 * np.pi * uv[:, 1])
    return Textured(positions, faces, faces, {"TEXCOORD_0": uv}, np.zeros(len(faces), np.int32)).mesh()


def share_near(level, at):
    """The share of a level's inner vertices that lie near x = `at`."""
    x = level.meshes[0].positions[:, 0]
    inner = x[(x > 0.05) & (x < 0.95)]
    return (np.abs(inner - at) < 0.1).mean()


def test_triangles_go_where_the_texture_changes():
    """A flat sheet, plain but for an edge between dark and light: its vertices stay along that edge."""
    textured, plain = (levels(painted(sheet()), SimilarityOptions(), 160, pixels=p)[0] for p in ({0: stripes()}, {}))
    assert share_near(textured, 0.5) > 1.2 * share_near(plain, 0.5)


def test_a_transform_of_the_texture_moves_its_edge():
    moved = {"index": 0, "extensions": {"KHR_texture_transform": {"offset": [0.25, 0.0]}}}
    asset = painted(sheet(), pbrMetallicRoughness={"baseColorTexture": moved})
    level = levels(asset, SimilarityOptions(), 160, pixels={0: stripes()})[0]
    assert share_near(level, 0.25) > share_near(level, 0.5)


def test_every_face_an_island_of_its_own_reaches_its_target():
    asset = painted(islands(*bumpy(3)).mesh())
    for options in (METHODS["ray"], METHODS["full"]):
        assert levels(asset, options, 50, pixels={0: stripes()})[0].triangles == 50


def test_parts_vanish_as_a_whole_and_the_last_stays():
    found = levels(Asset("cubes", (Mesh(*cubes(3)),)), METHODS["ray"], 60, 1)
    assert found[0].triangles <= 60
    assert 1 <= found[1].triangles <= 4


@pytest.mark.parametrize("options", [METHODS["uv"], METHODS["deviation"]])
def test_a_mesh_without_uvs_is_refused_where_they_are_needed(options):
    with pytest.raises(InvalidMesh, match=r"needs UVs, and mesh 'ball' has none; repair the UVs"):
        levels(Asset("plain", (Mesh(*bumpy(2), name="ball"),)), options, 20)


def test_an_error_as_the_target():
    asset = painted(uv_sphere(12, 16).mesh())
    level = decimate_asset(asset, [Target(error=2.0)], METHODS["ray"], pixels={0: stripes()})[1]
    assert 10 < level.triangles < 300


def test_a_mirrored_mesh_keeps_its_winding():
    flat = uv_sphere(10, 14).mesh()
    document = {**DOCUMENT, "nodes": [{"mesh": 0, "scale": [-1.0, 1.0, 1.0]}]}
    level = levels(painted(flat, document), METHODS["ray"], 100, pixels={0: stripes()})[0]
    corners = level.meshes[0].positions[level.meshes[0].faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("fk,fk->f", normals, corners.mean(axis=1)) > 0).all()


def test_cancelling():
    calls = []

    def cancelled():
        calls.append(1)
        return len(calls) > 3

    with pytest.raises(Cancelled):
        levels(painted(uv_sphere(40, 60).mesh()), METHODS["ray"], 10, pixels={0: stripes()}, cancelled=cancelled)
    assert len(calls) < 8


def test_the_input_is_not_changed():
    asset = painted(uv_sphere(8, 12).mesh())
    before = asset.fingerprint()
    levels(asset, METHODS["full"], 40, pixels={0: stripes()})
    assert asset.fingerprint() == before


def test_luminance_of_all_kinds_of_images():
    grey, colour = np.full((2, 2, 1), 100, np.uint8), np.full((2, 2, 4), 100, np.uint8)
    assert (luminance_image(grey) == [100, 255]).all()
    assert (luminance_image(colour) == [100, 100]).all()
    assert luminance_image(np.array([[[255, 0, 0]]], np.uint8))[0, 0].tolist() == [76, 255]


def test_a_record_rebuilds_levels():
    """The sequence of collapses, replayed on the source, gives the kernel's level."""
    from dressed import small
    from lodpipe import kernel
    from lodpipe.geometry.progressive import rebuild

    for name in ("two materials", "tube"):
        one = small()[name]
        for collapse in ("half", "full"):
            options = SimilarityOptions(views=3, collapse=collapse, record=True)
            made = kernel.similarity_decimate(one.positions, one.faces, [20], one.appearance, options, **one.arrays)
            level, arrays = made.levels[0], one.arrays
            again = rebuild(one.positions, one.faces, arrays["wedges"], arrays["values"], made.record, 20)
            assert len(again.faces) == len(level.faces)
            order = np.argsort(level.face_source), np.argsort(again.face_source)
            assert np.array_equal(level.positions[level.faces[order[0]]], again.positions[again.faces[order[1]]])
            assert np.allclose(level.values[level.wedges[order[0]]], again.values[again.wedges[order[1]]])


def test_options_out_of_range_are_refused():
    for change in ({"views": 0}, {"spacing": 0.0}, {"image_size": 4}, {"penalty": "none"}):
        with pytest.raises(InvalidMesh):
            levels(painted(uv_sphere(4, 6).mesh()), dataclasses.replace(METHODS["ray"], **change), 10)


@pytest.mark.parametrize("name", ["ball", "sheet"])
def test_the_original_is_met_where_open3d_meets_it(name):
    """Global costs with the native boxes and planes equal those with Open3D's RaycastingScene over the source."""
    from dressed import small
    from lodpipe import kernel
    from lodpipe.kernel.similarity_reference import State
    from lodpipe.o3d import RayScene

    one, options = small()[name], SimilarityOptions(views=3)
    state = State(one.positions, one.faces, one.appearance, options, **one.arrays)
    scene = RayScene(state.p.astype(np.float32), state.faces)

    def hits(origins, directions, low, high):
        start = origins + directions * low[:, None]
        found = scene.cast(start.astype(np.float32), directions.astype(np.float32))
        t = found.distance + low
        weights = np.column_stack([1 - found.uv.sum(axis=1), found.uv]).astype(float)
        return t, np.where(t <= high, found.faces, -1), weights

    state.first_hits = hits
    pairs, cost, _ = kernel.similarity_costs(one.positions, one.faces, one.appearance, options, **one.arrays)
    known = [(found, state.plan(*pair)) for pair, found in zip(pairs.tolist()[::5], cost[::5], strict=True)]
    known = [(found, state.cost(plan)) for found, plan in known if plan is not None]
    assert len(known) > 8
    assert np.allclose(*np.transpose(known), rtol=2e-3)  # Open3D works in single precision throughout
