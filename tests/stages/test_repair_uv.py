"""Stage `repair_uv`: what is broken gets a place of its own, what is good stays, and it looks the same."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lodpipe import io
from lodpipe.core.asset import Asset, Lod
from lodpipe.core.material import Image, Material
from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.geometry.texture import Texture
from lodpipe.geometry.uv_defects import texture_sizes, uv_defects
from lodpipe.io.images import encode_png
from lodpipe.stage import Context
from lodpipe.stages.export import ExportParams, export
from lodpipe.stages.repair_uv import RepairUvParams, repair_uv
from meshes import grid

SIZE = 64


def noise(seed: int = 0) -> np.ndarray:
    """Texels without any likeness between neighbours: any blur or shift shows."""
    return np.random.default_rng(seed).integers(0, 256, (SIZE, SIZE, 3)).astype(np.uint8)


def sheets(*boxes, flip=(), missing=()) -> Mesh:
    """Square sheets apart in space, each with its (low, high) box of UVs; mirrored where `flip` says so."""
    positions, faces = grid(2)
    uv = positions[:, :2] * [1, -1] + [0, 1]
    points, rows, values = [], [], []
    for i, (low, high) in enumerate(boxes):
        own = uv * [-1, 1] + [1, 0] if i in flip else uv
        points.append(positions + np.array([1.5 * i, 0, 0.2 * i]))
        rows.append(faces + len(positions) * i)
        values.append(np.array(low) + own * (np.array(high) - low))
    owner = np.repeat([int(i in missing) for i in range(len(boxes))], len(faces)).astype(np.int32)
    primitives = (Primitive(0, ("TEXCOORD_0",)), Primitive(0, ()))
    attributes = {"TEXCOORD_0": np.concatenate(values).astype(np.float32)}
    return Mesh(np.concatenate(points), np.concatenate(rows), None, attributes, owner, primitives, name="sheets")


def asset_of(mesh: Mesh, pixels=None, wrap: int = 10497) -> Asset:
    pixels = noise() if pixels is None else pixels
    image = Image(encode_png(pixels), "image/png", "paint", "paint.png", *pixels.shape[1::-1])
    material = Material({"name": "paint", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}})
    document = {"textures": [{"source": 0, "sampler": 0}], "samplers": [{"wrapS": wrap, "wrapT": wrap}]}
    return Asset("sheets", (mesh,), (material,), (image,), document, lods=(Lod((mesh,)),))


def run(asset: Asset, **params):
    context = Context(threads=1)
    return repair_uv(asset, RepairUvParams(**params), context), context


def seen(asset: Asset, faces, weights):
    """Linear base colours at places of the only mesh."""
    (mesh,) = asset.meshes
    (image,) = asset.images
    uv = np.einsum("nkd,nk->nd", mesh.attributes["TEXCOORD_0"][mesh.wedges[faces]], weights)
    return Texture(io.decode_image(image)).sample(uv.astype(np.float32))


def places(mesh: Mesh, count: int = 800):
    rng = np.random.default_rng(5)
    return rng.integers(0, len(mesh.faces), count), rng.dirichlet((1.0, 1.0, 1.0), count)


LEFT, RIGHT = ((0.03125, 0.03125), (0.46875, 0.96875)), ((0.53125, 0.03125), (0.96875, 0.96875))


def test_a_good_layout_stays_as_it_is_to_the_byte():
    asset = asset_of(sheets(LEFT, RIGHT))
    for one_to_one in (False, True):
        result, context = run(asset, one_to_one=one_to_one)
        assert result is asset
        assert [(m.name, m.value) for m in context.measurements] == [("repaired_materials", 0)]


def test_overlaps_and_tiling_are_legal_unless_every_face_needs_its_own_texels():
    asset = asset_of(sheets(LEFT, LEFT, ((0, 0), (3, 3))))
    assert run(asset)[0] is asset
    assert run(asset, one_to_one=True, when="never")[0] is asset


@pytest.mark.parametrize(
    "mesh",
    [
        sheets(LEFT, LEFT),
        sheets(LEFT, LEFT, flip=[1]),
        sheets(LEFT, ((0.25, 0.25), (0.75, 0.75))),
        sheets(((0, 0), (2, 2))),
        sheets(((-0.5, 0.25), (0.5, 0.75)), RIGHT),
        sheets(((3, 2), (4, 3))),
    ],
    ids=["stack", "mirror", "accident", "tiling", "outside", "another tile"],
)
def test_texels_are_copied_and_no_two_faces_share_one(mesh):
    asset = asset_of(mesh)
    result, context = run(asset, one_to_one=True)
    (figures,) = uv_defects(result.meshes[0], texture_sizes(result))
    assert (figures.overlap_percent, figures.out_of_range_percent, figures.missing_faces) == (0, 0, 0)
    assert figures.min_gutter_texels >= 4
    at = places(mesh)
    assert np.abs(seen(result, *at) - seen(asset, *at)).max() < 0.004
    assert {m.name: m.value for m in context.measurements}["psnr"] > 50
    assert context.warnings == []
    assert np.array_equal(result.meshes[0].positions, mesh.positions)
    assert np.array_equal(result.meshes[0].faces, mesh.faces)
    assert result.lods[0].meshes is result.meshes


def test_the_sampler_s_wrap_mode_counts():
    """Beyond the edge of a clamped texture there is its edge."""
    asset = asset_of(sheets(((-0.5, -0.5), (1.5, 1.5))), wrap=33071)
    result, _ = run(asset, one_to_one=True)
    at = places(asset.meshes[0])
    uv = np.einsum("nkd,nk->nd", asset.meshes[0].attributes["TEXCOORD_0"][asset.meshes[0].wedges[at[0]]], at[1])
    wanted = Texture(noise()).sample(uv.astype(np.float32), None, (33071, 33071))
    assert np.abs(seen(result, *at) - wanted).max() < 0.004


def test_faces_without_uvs_get_some():
    asset = asset_of(sheets(LEFT, RIGHT, missing=[1]), pixels=np.full((SIZE, SIZE, 3), 255, np.uint8))
    result, _ = run(asset)
    (figures,) = uv_defects(result.meshes[0])
    assert (figures.missing_faces, figures.zero_area_faces, figures.overlap_percent) == (0, 0, 0)


def test_faces_in_a_point_of_the_texture_keep_its_colour():
    asset = asset_of(sheets(LEFT, ((0.7, 0.7), (0.7, 0.7))))
    result, _ = run(asset, one_to_one=True)
    (figures,) = uv_defects(result.meshes[0])
    assert (figures.zero_area_faces, figures.overlap_percent) == (0, 0)
    faces, weights = places(asset.meshes[0])
    assert np.abs(seen(result, faces, weights) - seen(asset, faces, weights)).max() < 0.01


def test_other_materials_stay_as_they_are(tmp_path):
    mesh = sheets(LEFT, LEFT, RIGHT)
    primitives = (Primitive(0, ("TEXCOORD_0",)), Primitive(1, ("TEXCOORD_0",)))
    mesh = dataclasses.replace(mesh, face_primitive=np.repeat([0, 0, 1], 8).astype(np.int32), primitives=primitives)
    asset = asset_of(mesh)
    other = Image(encode_png(noise(1)), "image/png", "other", "other.png", SIZE, SIZE)
    textures = [*asset.document["textures"], {"source": 1}]
    asset = dataclasses.replace(
        asset,
        materials=(*asset.materials, Material({"name": "other", "emissiveTexture": {"index": 1}})),
        images=(*asset.images, other),
        document={**asset.document, "textures": textures},
    )
    result, _ = run(asset, one_to_one=True)
    assert [material.name for material in result.materials] == ["paint", "other"]
    assert result.images[1].data == other.data
    kept = result.meshes[0].face_primitive == [p.material for p in result.meshes[0].primitives].index(1)
    assert np.array_equal(np.flatnonzero(kept), np.arange(16, 24))
    uv = [m.attributes["TEXCOORD_0"][m.wedges[16:]] for m in (asset.meshes[0], result.meshes[0])]
    assert np.array_equal(*uv)
    export(result, ExportParams(), Context(output=tmp_path))
    assert io.load(tmp_path / "LOD0" / "sheets_LOD0.glb").warnings == ()


def test_a_repair_that_looks_different_is_not_taken():
    asset = asset_of(sheets(LEFT, LEFT))
    result, context = run(asset, one_to_one=True, size=16)  # no room for its texels
    assert result is asset
    assert "the repair was not taken: it looks too different" in context.warnings[-1]


def test_always_packs_anew():
    asset = asset_of(sheets(LEFT, RIGHT))
    result, _ = run(asset, when="always")
    at = places(asset.meshes[0])
    assert result is not asset
    assert np.abs(seen(result, *at) - seen(asset, *at)).max() < 0.004


def test_after_levels_it_does_nothing_and_says_so():
    asset = asset_of(sheets(LEFT, LEFT))
    asset = dataclasses.replace(asset, lods=(*asset.lods, Lod(asset.meshes)))
    result, context = run(asset, one_to_one=True)
    assert result is asset
    assert "belongs before the stage that makes levels" in context.warnings[0]


def test_the_same_bytes_twice_and_the_input_unchanged():
    asset = asset_of(sheets(LEFT, LEFT))
    before = asset.fingerprint()
    first, second = (run(asset, one_to_one=True)[0].fingerprint() for _ in range(2))
    assert first == second
    assert asset.fingerprint() == before


def test_materials_go_into_one_atlas_where_that_is_asked_for(tmp_path):
    """Two sheets of two colours and images of two sizes, on the same UVs: one material, one image, the same look."""
    first = asset_of(sheets(LEFT, LEFT, missing=()))
    (mesh,) = first.meshes
    half = len(mesh.faces) // 2
    primitives = (Primitive(0, ("TEXCOORD_0",)), Primitive(1, ("TEXCOORD_0",)))
    owner = np.repeat([0, 1], half).astype(np.int32)
    mesh = dataclasses.replace(mesh, face_primitive=owner, primitives=primitives)
    second = noise(1)[::2, ::2]
    image = Image(encode_png(second), "image/png", "other", "other.png", SIZE // 2, SIZE // 2)
    factor = {"baseColorTexture": {"index": 1}, "baseColorFactor": [1.0, 0.5, 0.25, 1.0]}
    asset = dataclasses.replace(
        first,
        meshes=(mesh,),
        lods=(Lod((mesh,)),),
        materials=(*first.materials, Material({"name": "other", "pbrMetallicRoughness": factor})),
        images=(*first.images, image),
        document={"textures": [{"source": 0, "sampler": 0}, {"source": 1, "sampler": 0}], "samplers": [{}]},
    )
    result, context = run(asset, one_to_one=True, merge_materials=True)
    assert context.warnings == []
    assert len(result.materials) == len(result.images) == 1
    assert uv_defects(result.meshes[0], texture_sizes(result))[0].overlap_percent == 0
    assert next(m.value for m in context.measurements if m.name == "psnr") > 40
    export(result, ExportParams(), Context(output=tmp_path))
    assert len(io.load(tmp_path / "LOD0" / "sheets_LOD0.glb").materials) == 1
