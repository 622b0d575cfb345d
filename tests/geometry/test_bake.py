"""Baking: known texels, normals in turned charts, merged materials, gutters."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lodpipe.core.asset import Asset, Lod
from lodpipe.core.errors import Cancelled
from lodpipe.core.material import Image, Material
from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.geometry.bake import BakeOptions, bake_level, groups_of
from lodpipe.geometry.bake_mesh import Corners
from lodpipe.geometry.bake_source import SourceMesh
from lodpipe.geometry.normals import unit
from lodpipe.geometry.occlusion import Occlusion
from lodpipe.geometry.slots import BASE_COLOR, EMISSIVE, METALLIC_ROUGHNESS, NORMAL, OCCLUSION, SlotTextures
from lodpipe.geometry.texture import Texture
from lodpipe.kernel.layout import uv_overlaps
from meshes import box, grid

SIDE = 256
NEAR = {"magFilter": 9728}


def checker(cells: int = 8, size: int = 128) -> np.ndarray:
    """A board of squares, each with a grey of its own; red tells the column, green the row."""
    at = np.arange(size) * cells // size
    board = np.zeros((size, size, 3), np.uint8)
    board[..., 0] = 20 + 25 * at[None, :]
    board[..., 1] = 20 + 25 * at[:, None]
    board[..., 2] = np.where((at[:, None] + at) % 2, 230, 30)
    return board


def textured_cube() -> Mesh:
    """A cube whose six faces each show the whole board."""
    positions, faces = box()
    corners = positions[faces]
    axis = np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])).argmax(axis=1)
    uv = np.stack([corners[np.arange(12), :, (axis + k) % 3] for k in (1, 2)], axis=2) + 0.5
    wedges = np.arange(36, dtype=np.int32).reshape(12, 3)
    return Mesh(positions, faces, wedges, {"TEXCOORD_0": uv.reshape(-1, 2).astype(np.float32)}, name="cube")


def asset_of(mesh: Mesh, *materials: dict, images=()) -> Asset:
    textures = [{"source": i} for i in range(len(images))]
    return Asset(
        "thing",
        (mesh,),
        tuple(map(Material, materials)),
        tuple(Image(b"x", width=i.shape[1], height=i.shape[0]) for i in images),
        {"textures": textures, "samplers": []},
        lods=(Lod((mesh,)),),
    )


def with_material(mesh: Mesh, material: int = 0) -> Mesh:
    return dataclasses.replace(mesh, primitives=(Primitive(material, tuple(mesh.attributes)),))


def bake(asset: Asset, level: Mesh, images=(), side: int = SIDE, reach: float = 0.3, sky=None, **options):
    options = BakeOptions(**{"samples": 1, **options})
    groups = groups_of(asset, (level,), options.merge)
    for group in groups:
        group.side = side
    textures = SlotTextures(asset, dict(enumerate(images)))
    sources = {0: SourceMesh(asset.meshes[0], 1)}
    return bake_level(asset, Lod((level,)), groups, sources, textures, reach, options, sky=sky)


def looked_up(mesh: Mesh, pixels: np.ndarray, faces, weights, srgb: bool = True) -> np.ndarray:
    """Linear values of a baked map at places of the baked mesh."""
    uv = np.einsum("nkd,nk->nd", mesh.attributes["TEXCOORD_0"][mesh.wedges[faces]], weights)
    return Texture(pixels, srgb).sample(uv.astype(np.float32))


def places(count: int, seed: int = 0, faces: int = 12):
    rng = np.random.default_rng(seed)
    return rng.integers(0, faces, count), rng.dirichlet((1.0, 1.0, 1.0), count)


def test_every_square_of_a_checkered_cube_is_where_it_was():
    board = checker()
    cube = with_material(textured_cube())
    asset = asset_of(cube, {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}, images=[board])
    baked = bake(asset, cube, [board], maps=("base_color",))
    (mesh,), (material,) = baked.meshes, baked.materials
    assert baked.missed == 0
    # the middles of the 64 squares of each side, on whichever of its two triangles
    old = cube.attributes["TEXCOORD_0"][cube.wedges]
    for face in range(12):
        a, b, c = old[face].astype(float)
        to_weights = np.linalg.inv(np.stack([b - a, c - a], axis=1))
        middles = (np.stack(np.meshgrid(np.arange(8), np.arange(8)), axis=2).reshape(-1, 2) + 0.5) / 8
        v, w = (to_weights @ (middles - a).T).clip(0, 1)
        inside = v + w <= 1
        weights = np.stack([1 - v - w, v, w], axis=1)[inside]
        exact = weights @ old[face]
        seen = looked_up(mesh, material.maps[BASE_COLOR], np.full(len(weights), face), weights)
        middle = np.abs(exact * 8 % 1 - 0.5).max(axis=1) < 0.2  # not at the edge of a square
        wanted = Texture(board).sample(exact.astype(np.float32))
        assert middle.sum() >= 20
        assert np.abs(seen - wanted)[middle, :3].max() < 0.01
    label = np.zeros(12, np.int32)
    assert not uv_overlaps(
        mesh.attributes["TEXCOORD_0"][mesh.wedges].astype(float), np.arange(12, dtype=np.int32), label
    ).faces.any()


def tilted(pixels_normal, size=32):
    """A normal map that leans the same way everywhere."""
    encoded = np.rint((unit(np.array(pixels_normal, float)) * 0.5 + 0.5) * 255).astype(np.uint8)
    return np.broadcast_to(encoded, (size, size, 3)).copy()


def decoded(mesh: Mesh, pixels, faces, weights) -> np.ndarray:
    """Object-space normals that a renderer makes of a baked mesh and its normal map."""
    bent = looked_up(mesh, pixels, faces, weights, srgb=False)[:, :3] * 2.0 - 1
    up = unit(np.einsum("nkd,nk->nd", mesh.attributes["NORMAL"][mesh.wedges[faces]], weights).astype(float))
    frame = np.einsum("nkd,nk->nd", mesh.attributes["TANGENT"][mesh.wedges[faces]], weights)
    along = unit(frame[:, :3].astype(float))
    across = np.cross(up, along) * np.sign(frame[:, 3:])
    return unit(along * bent[:, :1] + across * bent[:, 1:2] + up * bent[:, 2:])


@pytest.mark.parametrize("turn", [0.0, 0.7, np.pi / 2, 2.5])
@pytest.mark.parametrize("mirrored", [False, True])
def test_normals_are_encoded_anew_for_a_turned_chart(turn, mirrored):
    """The old UVs are turned (and mirrored) against the sheet; the new ones are not: copied colours would be wrong."""
    positions, faces = grid(2)
    c, s = np.cos(turn), np.sin(turn)
    uv = (positions[:, :2] * [1, -1] * ([-1, 1] if mirrored else [1, 1])) @ np.array([[c, s], [-s, c]]) * 0.5
    normals = np.broadcast_to(np.float32([0, 0, 1]), (9, 3))
    sheet = with_material(Mesh(positions, faces, attributes={"TEXCOORD_0": uv.astype(np.float32), "NORMAL": normals}))
    bump = tilted([0.5, 0.2, 1.0])
    asset = asset_of(sheet, {"normalTexture": {"index": 0}}, images=[bump])
    baked = bake(asset, sheet, [bump], side=64)
    at = places(200, faces=8)
    seen = decoded(baked.meshes[0], baked.materials[0].maps[NORMAL], *at)
    # by hand: u runs along `along` in space, green points to where v falls
    along = np.array([c, s, 0.0]) * [-1, -1 if not mirrored else 1, 1]
    grow = np.linalg.lstsq(np.c_[positions[:, :2], np.ones(9)], uv, rcond=None)[0][:2]  # d(u, v) / d(x, y)
    back = np.linalg.inv(grow.T)  # columns: where u and v grow in the plane
    along, up = unit(np.append(back[:, 0], 0.0)), unit(np.append(-back[:, 1], 0.0))
    wanted = unit(0.5 * along + 0.2 * up + np.array([0, 0, 1.0]))
    assert np.degrees(np.arccos(np.clip(seen @ wanted, -1, 1))).max() < 1.0


def test_detail_of_the_geometry_becomes_normals():
    positions, faces = grid(64)
    positions[:, 2] = 0.02 * np.sin(12 * positions[:, 0]) * np.cos(9 * positions[:, 1])
    source = with_material(Mesh(positions, faces))
    flat = with_material(Mesh(*grid(1)))
    baked = bake(asset_of(source, {}), flat, side=128)
    assert baked.missed / baked.texels < 0.01
    faces_at, weights = places(500, faces=2)
    points = np.einsum("nkd,nk->nd", flat.positions[flat.faces[faces_at]], weights)
    x, y = points[:, :2].T
    slope = np.stack([-0.24 * np.cos(12 * x) * np.cos(9 * y), 0.18 * np.sin(12 * x) * np.sin(9 * y), x * 0 + 1], axis=1)
    seen = decoded(baked.meshes[0], baked.materials[0].maps[NORMAL], faces_at, weights)
    angle = np.degrees(np.arccos(np.clip(np.einsum("nd,nd->n", seen, unit(slope)), -1, 1)))
    assert angle.mean() < 1.0
    plain = np.degrees(np.arccos(unit(slope)[:, 2])).mean()
    assert angle.mean() < plain / 5


def test_metal_roughness_occlusion_and_emission_keep_their_places():
    orm = np.broadcast_to(np.uint8([40, 120, 200]), (8, 8, 3)).copy()
    glow = np.broadcast_to(np.uint8([188, 0, 90]), (8, 8, 3)).copy()
    said = {
        "pbrMetallicRoughness": {"metallicRoughnessTexture": {"index": 0}, "roughnessFactor": 0.5},
        "occlusionTexture": {"index": 0, "strength": 0.7},
        "emissiveTexture": {"index": 1},
        "emissiveFactor": [1, 1, 1],
    }
    cube = with_material(textured_cube())
    baked = bake(asset_of(cube, said, images=[orm, glow]), cube, [orm, glow], side=64)
    (material,) = baked.materials
    assert set(material.maps) == {METALLIC_ROUGHNESS, EMISSIVE, NORMAL}
    assert material.shared == {OCCLUSION: METALLIC_ROUGHNESS}
    assert np.abs(material.maps[METALLIC_ROUGHNESS].astype(int) - [40, 120, 200]).max() <= 1
    assert np.abs(material.maps[EMISSIVE].astype(int) - [188, 0, 90]).max() <= 1
    assert material.gltf["occlusionTexture"] == {"strength": 0.7}
    assert material.gltf["pbrMetallicRoughness"] == {"roughnessFactor": 0.5}


def two_materials() -> Mesh:
    cube = textured_cube()
    primitives = (Primitive(0, ("TEXCOORD_0",)), Primitive(1, ("TEXCOORD_0",)))
    return dataclasses.replace(cube, face_primitive=np.repeat([0, 1], 6).astype(np.int32), primitives=primitives)


def test_merged_materials_hold_their_factors_in_one_texture():
    cube = two_materials()
    red = {"name": "red", "pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1], "roughnessFactor": 0.2}}
    blue = {"name": "blue", "pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0.5, 1], "metallicFactor": 0}}
    baked = bake(asset_of(cube, red, blue), cube, side=64, merge=True)
    (material,), (mesh,) = baked.materials, baked.meshes
    assert len(mesh.primitives) == 1
    assert material.gltf["name"] == "red+blue"
    faces, weights = places(200)
    colour = looked_up(mesh, material.maps[BASE_COLOR], faces, weights)[:, :3]
    first = cube.face_primitive[faces] == 0
    assert np.abs(colour[first] - [1, 0, 0]).max() < 0.01
    assert np.abs(colour[~first] - [0, 0, 0.5]).max() < 0.01
    numbers = looked_up(mesh, material.maps[METALLIC_ROUGHNESS], faces, weights, srgb=False)
    assert np.abs(numbers[first][:, 1:3] - [0.2, 1.0]).max() < 0.01
    assert np.abs(numbers[~first][:, 1:3] - [1.0, 0.0]).max() < 0.01


def test_materials_that_a_texture_cannot_tell_apart_stay_apart():
    cube = two_materials()
    glass = {"alphaMode": "BLEND"}
    assert len(bake(asset_of(cube, {}, glass), cube, side=64, merge=True).materials) == 2
    assert len(bake(asset_of(cube, {}, {}), cube, side=64).materials) == 2


def test_vertex_colours_go_into_the_texture():
    cube = textured_cube()
    colours = np.repeat(np.float32([[1, 0.5, 0.25, 1]]), 36, axis=0)
    mesh = with_material(dataclasses.replace(cube, attributes={**cube.attributes, "COLOR_0": colours}))
    baked = bake(asset_of(mesh, {}), mesh, side=64)
    assert "COLOR_0" not in baked.meshes[0].attributes
    colour = looked_up(baked.meshes[0], baked.materials[0].maps[BASE_COLOR], *places(50))
    assert np.abs(colour[:, :3] - [1, 0.5, 0.25]).max() < 0.01


def test_vertex_colours_of_the_source_go_to_levels_that_have_none():
    cube = textured_cube()
    colours = np.repeat(np.float32([[1, 0.5, 0.25, 1]]), 36, axis=0)
    mesh = with_material(dataclasses.replace(cube, attributes={"COLOR_0": colours}))
    level = with_material(Mesh(cube.positions, cube.faces))
    baked = bake(asset_of(mesh, {}), level, side=64)
    colour = looked_up(baked.meshes[0], baked.materials[0].maps[BASE_COLOR], *places(50))
    assert np.abs(colour[:, :3] - [1, 0.5, 0.25]).max() < 0.01


def test_what_is_transparent_does_not_tint_what_is_not():
    """Leaves of green on black that cannot be seen: neither an average of texels nor a mip level shows the black."""
    cube = with_material(textured_cube())
    leaves = np.zeros((128, 128, 4), np.uint8)
    leaves[::2, ::2] = 0, 255, 0, 255
    pbr = {"baseColorTexture": {"index": 0}}
    asset = asset_of(cube, {"pbrMetallicRoughness": pbr, "alphaMode": "BLEND"}, images=(leaves,))
    asset = dataclasses.replace(asset, document={"textures": [{"source": 0, "sampler": 0}], "samplers": [NEAR]})
    baked = bake(asset, cube, images=(leaves,), side=64, samples=2)
    image = baked.materials[0].maps[BASE_COLOR]
    assert (image[..., 1] == 255).all() and 0 < image[..., 3].mean() < 128


def test_an_occlusion_map_from_the_shape_alone():
    cube = with_material(textured_cube())
    asset = asset_of(cube, {})
    dark = Mesh(cube.positions * 1.05, cube.faces)
    sky = Occlusion(dataclasses.replace(asset, meshes=(cube, dark)), threads=1)
    for scene, level in ((Occlusion(asset, threads=1), 255), (sky, 0)):
        baked = bake(asset, cube, side=64, sky=scene)
        (made,) = baked.materials
        assert (made.maps[OCCLUSION] == level).mean() > 0.95
    assert NORMAL in made.maps and "occlusionTexture" not in made.gltf


def test_edges_are_hard_where_the_texture_is_cut():
    """A cube without normals whose faces are charts of their own: flat shading; in one piece, it is smooth."""
    cube = with_material(textured_cube())
    flat = np.cross(*(np.diff(cube.positions[cube.faces], axis=1).transpose(1, 0, 2)))
    cut = Corners(cube)
    cut.put_uv(np.arange(12), np.arange(72).reshape(12, 3, 2) / 72.0)
    cut.finish(True)
    assert np.allclose(np.einsum("fkd,fd->fk", cut.normals, unit(flat)), 1, atol=1e-5)
    whole = Corners(cube)
    whole.put_uv(np.arange(12), np.arange(16).reshape(8, 2)[cube.faces] / 16.0)
    whole.finish(True)
    assert np.allclose(whole.normals, whole.smooth, atol=1e-5)


def test_gutters_hold_the_colour_of_their_chart():
    """A red and a blue half: at mip 3 no purple comes in from the other half's charts."""
    cube = two_materials()
    red, blue = ({"pbrMetallicRoughness": {"baseColorFactor": f}} for f in ([1, 0, 0, 1], [0, 0, 1, 1]))
    baked = bake(asset_of(cube, red, blue), cube, side=256, merge=True, padding=24)
    texture = Texture(baked.materials[0].maps[BASE_COLOR])
    mesh = baked.meshes[0]
    faces, weights = places(2000)
    uv = np.einsum("nkd,nk->nd", mesh.attributes["TEXCOORD_0"][mesh.wedges[faces]], weights).astype(np.float32)
    for mip in (0, 1, 2, 3):
        seen = texture.sample(uv, np.full(len(uv), 2.0**mip, np.float32))
        first = cube.face_primitive[faces] == 0
        assert seen[first, 2].max() < 0.02, mip
        assert seen[~first, 0].max() < 0.02, mip


def test_thin_walls_do_not_show_their_other_side():
    """Two sheets back to back, 1 % apart: each takes its own colour, though the other is as near."""
    positions, faces = grid(4)
    both = np.concatenate([positions, positions - np.array([0, 0, 0.01])])
    wall = Mesh(both, np.concatenate([faces, faces[:, ::-1] + len(positions)]))
    front = np.repeat([True, False], len(faces))
    wedges = np.arange(wall.faces.size, dtype=np.int32).reshape(-1, 3)
    colours = np.where(np.repeat(front, 3)[:, None], np.float32([1, 0, 0]), np.float32([0, 1, 0]))
    source = with_material(Mesh(both, wall.faces, wedges, {"COLOR_0": colours.astype(np.float32)}))
    low, low_faces = grid(1)
    level = Mesh(
        np.concatenate([low - np.array([0, 0, 0.004]), low - np.array([0, 0, 0.006])]),
        np.concatenate([low_faces, low_faces[:, ::-1] + 4]),
    )
    level = with_material(dataclasses.replace(level, attributes={"COLOR_0": np.ones((8, 3), np.float32)}))
    baked = bake(asset_of(source, {}), level, side=64, reach=0.05)
    faces_at, weights = places(100, faces=4)
    seen = looked_up(baked.meshes[0], baked.materials[0].maps[BASE_COLOR], faces_at, weights)
    assert np.abs(seen[faces_at < 2][:, :3] - [1, 0, 0]).max() < 0.01
    assert np.abs(seen[faces_at >= 2][:, :3] - [0, 1, 0]).max() < 0.01


def test_tiles_and_threads_make_no_difference(monkeypatch):
    board = checker()
    cube = with_material(textured_cube())
    asset = asset_of(cube, {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}, images=[board])
    whole = bake(asset, cube, [board], side=128)
    monkeypatch.setattr("lodpipe.geometry.bake.TILE", 128 * 17)
    tiled = bake(asset, cube, [board], side=128, threads=2)
    for path, pixels in whole.materials[0].maps.items():
        assert np.array_equal(pixels, tiled.materials[0].maps[path])
    assert whole.meshes[0].fingerprint() == tiled.meshes[0].fingerprint()


def test_it_can_be_cancelled():
    cube = with_material(textured_cube())
    asset = asset_of(cube, {})
    groups = groups_of(asset, (cube,), False)
    groups[0].side = 64
    with pytest.raises(Cancelled):
        bake_level(
            asset,
            Lod((cube,)),
            groups,
            {0: SourceMesh(cube)},
            SlotTextures(asset, {}),
            0.1,
            BakeOptions(),
            cancelled=lambda: True,
        )


def test_the_input_is_unchanged():
    board = checker()
    cube = with_material(textured_cube())
    asset = asset_of(cube, {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}, images=[board])
    before = asset.fingerprint()
    bake(asset, cube, [board], side=64)
    assert asset.fingerprint() == before
