"""Stage `bake`: files that others can read, figures, and what is told."""

from __future__ import annotations

import dataclasses
import shutil
from io import BytesIO

import numpy as np
import PIL.Image
import pytest
from pydantic import ValidationError

from lodpipe import io
from lodpipe.core.asset import Asset, Lod
from lodpipe.core.material import Image, Material
from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.geometry.uv_defects import uv_defects
from lodpipe.io.encode import KTX_TOOLS
from lodpipe.io.images import encode_png
from lodpipe.stage import Context
from lodpipe.stages.bake import BakeParams, bake
from lodpipe.stages.export import ExportParams, export
from meshes import sphere


def board() -> np.ndarray:
    at = np.arange(64)
    return np.stack([at[None] * 4 + at[:, None] * 0, at[:, None] * 4 + at[None] * 0, np.full((64, 64), 90)], 2).astype(
        np.uint8
    )


def ball(divisions: int, material: int = 0, reason: str = "") -> Mesh:
    """A sphere whose UVs are its x and y, one half on the other."""
    positions, faces = sphere(divisions)
    uv = (positions[:, :2] * 0.5 + 0.5).astype(np.float32)
    primitive = Primitive(material, ("TEXCOORD_0", "NORMAL"))
    attributes = {"TEXCOORD_0": uv, "NORMAL": positions.astype(np.float32)}
    return Mesh(positions, faces, attributes=attributes, primitives=(primitive,), name="ball", keep_reason=reason)


def two_levels(data: bytes | None = None, reason: str = "") -> Asset:
    image = Image(encode_png(board()) if data is None else data, "image/png", "board", "board.png", 64, 64)
    paint = Material({"name": "paint", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}})
    fine, coarse = ball(4, reason=reason), ball(1, reason=reason)
    document = {"textures": [{"source": 0, "sampler": 0}], "samplers": [{"wrapS": 33071}]}
    levels = (Lod((fine,)), Lod((coarse,), estimate=1.0))
    return Asset("ball", (fine,), (paint,), (image,), document, lods=levels)


def run(asset: Asset, **params):
    context = Context(threads=1)
    return bake(asset, BakeParams(**params), context), context


@pytest.mark.parametrize("merge", [False, True])
def test_a_level_with_textures_of_its_own_goes_through_files(tmp_path, merge):
    baked, context = run(two_levels(), size=128, merge_materials=merge)
    output = Context(output=tmp_path)
    export(baked, ExportParams(combined=True), output)
    level = io.load(tmp_path / "LOD1" / "ball_LOD1.glb")
    assert level.warnings == ()
    assert {(image.width, image.height) for image in level.images} == {(128, 128)}
    (mesh,) = level.meshes
    assert set(mesh.attributes) == {"TEXCOORD_0", "NORMAL", "TANGENT"}
    (figures,) = uv_defects(mesh)
    assert (figures.overlap_percent, figures.out_of_range_percent, figures.missing_faces) == (0, 0, 0)
    assert figures.flipped_percent == 0
    (material,) = level.materials
    assert material.name == "paint"
    assert material.normal_texture is not None
    recorded = {m.name: m.value for m in context.measurements}
    assert recorded["lod1.size"] == 128
    assert recorded["lod1.missed"] < 1
    source = io.load(tmp_path / "LOD0" / "ball_LOD0.glb")
    assert source.images[0].data == two_levels().images[0].data
    assert len(io.load(tmp_path / "ball.glb").images) == 3


def test_the_baked_colours_are_the_source_s():
    baked, _ = run(two_levels(), size=128, maps=("base_color",))
    level = baked.at(baked.lods[1])
    pixels = io.decode_image(level.images[0])
    mesh = level.meshes[0]
    rng = np.random.default_rng(0)
    faces, weights = rng.integers(0, len(mesh.faces), 500), rng.dirichlet((1, 1, 1), 500)
    uv = np.einsum("nkd,nk->nd", mesh.attributes["TEXCOORD_0"][mesh.wedges[faces]], weights)
    points = np.einsum("nkd,nk->nd", mesh.positions[mesh.faces[faces]], weights)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    seen = pixels[(uv[:, 1] * 128).astype(int), (uv[:, 0] * 128).astype(int)].astype(float)
    wanted = (points[:, :2] * 0.5 + 0.5) * 256
    # a ray along the smooth normal does not end right below the middle of a flat face
    assert np.abs(seen[:, :2] - wanted).mean() < 6
    assert np.abs(seen[:, 2] - 90).max() <= 1


def test_sizes_by_level_and_by_screen():
    asset = two_levels()
    three = dataclasses.replace(asset, lods=(*asset.lods, Lod((ball(1),), estimate=8.0)))
    listed, _ = run(three, size=(64, 32), maps=("base_color",))
    assert [level.own.images[0].width for level in listed.lods[1:]] == [64, 32]
    big = dataclasses.replace(asset.images[0], width=4096, height=4096)
    automatic, _ = run(dataclasses.replace(three, images=(big,)), maps=("base_color",))
    first, second = (level.own.images[0].width for level in automatic.lods[1:])
    assert first > second >= 64


@pytest.mark.parametrize(("kind", "mime"), [("jpeg", "image/jpeg"), ("webp", "image/webp"), ("png", "image/png")])
def test_formats(kind, mime, tmp_path):
    baked, _ = run(two_levels(), size=64, format=kind)
    colour, normal = baked.lods[1].own.images
    assert colour.mime_type == mime
    assert normal.mime_type == ("image/png" if kind == "jpeg" else mime)
    export(baked, ExportParams(formats=("gltf",)), Context(output=tmp_path))
    assert io.load(tmp_path / "LOD1" / "ball_LOD1.gltf").warnings == ()


def test_ktx2_without_a_tool_is_told(monkeypatch):
    monkeypatch.setattr("shutil.which", lambda name: None)
    baked, context = run(two_levels(), size=64, format="ktx2", maps=("base_color",))
    assert baked.lods[1].own.images[0].mime_type == "image/png"
    assert "PNG is written" in " ".join(context.warnings)


def test_it_tells_what_the_bake_is_worth():
    _, context = run(two_levels(), size=128, compare=True)
    recorded = {m.name: m.value for m in context.measurements}
    assert 10 < recorded["lod1.psnr_shared"] < 60
    assert 10 < recorded["lod1.psnr_baked"] < 60


def test_meshes_that_are_kept_keep_their_textures(tmp_path):
    baked, context = run(two_levels(reason="morph targets"), size=64)
    assert "keeps its textures: morph targets" in " ".join(context.warnings)
    level = baked.at(baked.lods[1])
    assert [material.name for material in level.materials] == ["paint"]
    assert level.images[0].data == two_levels().images[0].data
    assert level.document["textures"][0]["source"] == 0


def encoded(mode: str, kind: str) -> bytes:
    """A plain colour (200, 100, 50) as `mode` holds it, as a file."""
    picture = PIL.Image.new("RGB", (64, 64), (200, 100, 50))
    if mode == "I;16":
        picture = PIL.Image.fromarray(np.full((64, 64), 200 * 257, np.uint16))
    elif mode == "P":
        picture = picture.quantize()
    elif mode != "RGB":
        picture = picture.convert(mode)
    out = BytesIO()
    picture.save(out, kind)
    return out.getvalue()


@pytest.mark.parametrize(
    ("mode", "kind", "colour"),
    [
        ("P", "PNG", (200, 100, 50)),
        ("I;16", "PNG", (200, 200, 200)),
        ("1", "PNG", None),
        ("LA", "PNG", (124, 124, 124)),
        ("CMYK", "JPEG", (200, 100, 50)),
        ("L", "JPEG", (124, 124, 124)),
    ],
)
def test_images_of_every_kind(mode, kind, colour):
    baked, context = run(two_levels(data=encoded(mode, kind)), size=64, maps=("base_color",))
    assert context.warnings == []
    pixels = io.decode_image(baked.lods[1].own.images[0])
    if colour is not None:
        assert np.abs(pixels.astype(int) - colour).max() <= 4


def test_a_huge_image_is_told_and_its_factor_baked():
    data = bytearray(encode_png(board()))
    data[16:24] = (100_000).to_bytes(4, "big") * 2
    baked, context = run(two_levels(data=bytes(data)), size=64, maps=("base_color",))
    assert "its place in baked textures holds the factors alone" in " ".join(context.warnings)
    assert not baked.lods[1].own.images


@pytest.mark.skipif(not any(map(shutil.which, KTX_TOOLS)), reason="neither toktx nor basisu is installed")
def test_ktx2_by_the_machine_s_tool(tmp_path):
    baked, context = run(two_levels(), size=64, format="ktx2")
    assert context.warnings == []
    assert all(image.data[:6] == b"\xabKTX 2" for image in baked.lods[1].own.images)
    export(baked, ExportParams(), Context(output=tmp_path))
    assert "KHR_texture_basisu" in (tmp_path / "LOD1" / "ball_LOD1.glb").read_bytes().decode("latin1")


@pytest.mark.parametrize("tool", KTX_TOOLS)
def test_ktx2_by_a_tool_that_is_faked(tool, tmp_path, monkeypatch):
    """What is called, and that its file is taken: the program copies its input's length behind KTX2's first bytes."""
    program = tmp_path / tool
    program.write_text(
        '#!/bin/sh\necho "$@" >> '
        + str(tmp_path / "said")
        + '\nfor word; do case "$word" in *.ktx2) out="$word";; esac; done\n'
        "printf '\\253KTX 20\\273' > \"$out\"\n"
    )
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    baked, context = run(two_levels(), size=64, format="ktx2")
    assert context.warnings == []
    assert all(image.data[:6] == b"\xabKTX 2" for image in baked.lods[1].own.images)
    colour, normal = (tmp_path / "said").read_text().splitlines()
    assert "uastc" in normal and "uastc" not in colour
    assert "linear" in normal and "linear" not in colour


def test_a_broken_image_is_told_and_its_factor_baked():
    _, context = run(two_levels(data=b"\x89PNG\r\n\x1a\nrubbish"), size=64)
    assert "its place in baked textures holds the factors alone" in " ".join(context.warnings)


def test_without_levels_nothing_happens():
    asset = dataclasses.replace(two_levels(), lods=())
    assert run(asset)[0] is asset


def test_the_same_bytes_for_any_number_of_threads():
    first = bake(two_levels(), BakeParams(size=64), Context(threads=1)).fingerprint()
    assert bake(two_levels(), BakeParams(size=64), Context(threads=3)).fingerprint() == first


@pytest.mark.parametrize("params", [{"size": 3}, {"size": "huge"}, {"padding": 0}, {"format": "bmp"}, {"quality": 0}])
def test_other_parameters_are_refused(params):
    with pytest.raises(ValidationError):
        BakeParams(**params)


def test_the_distance_is_that_of_the_scene():
    """A mesh of a hundred units that a node makes small: nothing is missed for being a hundred times as far."""
    asset = two_levels()
    large = [dataclasses.replace(m, positions=m.positions * 100) for m in (asset.meshes[0], asset.lods[1].meshes[0])]
    document = {**asset.document, "nodes": [{"mesh": 0, "scale": [0.01] * 3}], "scenes": [{"nodes": [0]}]}
    levels = (Lod((large[0],)), Lod((large[1],), estimate=4.0))
    scaled = dataclasses.replace(asset, meshes=(large[0],), document=document, lods=levels)
    _, context = run(scaled, size=64)
    assert {m.name: m.value for m in context.measurements}["lod1.missed"] < 1


def test_levels_decimated_without_uvs_get_new_ones(tmp_path):
    from lodpipe.core.asset import Target
    from lodpipe.stages.decimate import DecimateParams, decimate

    asset = dataclasses.replace(two_levels(), lods=())
    free = decimate(asset, DecimateParams(uvs="free"), Context(lods=(Target(ratio=0.1),)))
    assert free.lods[0].meshes is asset.meshes
    assert "TEXCOORD_0" not in free.lods[1].meshes[0].attributes
    context = Context(output=tmp_path)
    export(free, ExportParams(), context)
    assert context.warnings == ["level 1 has no UVs for its textures: `bake` belongs after `decimate: {uvs: free}`"]
    baked, _ = run(free, size=128)
    (figures,) = uv_defects(baked.lods[1].meshes[0])
    assert (figures.missing_faces, figures.overlap_percent) == (0, 0)
    assert set(baked.lods[1].meshes[0].attributes) == {"TEXCOORD_0", "NORMAL", "TANGENT"}
