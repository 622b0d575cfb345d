"""Pictures of small scenes whose every pixel is known."""

from __future__ import annotations

import numpy as np
import pytest

from lodpipe.core.asset import Asset
from lodpipe.core.material import Material
from lodpipe.core.mesh import Mesh, Primitive
from lodpipe.geometry.camera import Camera
from lodpipe.geometry.render import (
    DARK,
    LIGHT,
    Style,
    buffers,
    depth_picture,
    normal_picture,
    render,
    silhouette_picture,
)
from lodpipe.geometry.surface import Model, image_index
from lodpipe.geometry.texture import MIRROR, Textures
from meshes import box, grid, sphere

FRONT = Camera(np.array([0.5, 0.5, 3.0]), np.array([0.5, 0.5, 0.0]), fov=None, height=1.0)
"""Sees the unit square exactly."""


def front_pixel(point):
    """Row and column of a point of the unit square in a picture of 16 × 16."""
    return int((1 - point[1]) * 16), int(point[0] * 16)


UNLIT = {"extensions": {"KHR_materials_unlit": {}}}
QUARTERS = np.array([[[250, 0, 0], [0, 250, 0]], [[0, 0, 250], [250, 250, 0]]], np.uint8).repeat(8, 0).repeat(8, 1)
"""Red, green above blue, yellow; 16 × 16."""


def square(height=0.0, uv=None, **attributes):
    """The unit square facing the camera; v = 0 at its upper edge."""
    positions, faces = grid(1, height)
    own = np.stack([positions[:, 0], 1 - positions[:, 1]], axis=1) if uv is None else uv
    return positions, faces, {"TEXCOORD_0": own.astype(np.float32), **attributes}


def scene(*squares, materials, samplers=None):
    """One mesh for each square, with the material of the same number; texture 0 shows image 0."""
    meshes = []
    for number, (positions, faces, attributes) in enumerate(squares):
        primitive = Primitive(material=number, attributes=tuple(attributes))
        meshes.append(Mesh(positions, faces, attributes=attributes, primitives=(primitive,)))
    texture = {"source": 0, **({"sampler": 0} if samplers else {})}
    document = {"textures": [texture], "samplers": samplers or []}
    return Asset("scene", tuple(meshes), tuple(Material({**UNLIT, **m}) for m in materials), document=document)


def flat(*rgba):
    return {"pbrMetallicRoughness": {"baseColorFactor": rgba}}


def textured(**more):
    return {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, **more}}}


def picture(asset, pixels=QUARTERS, camera=FRONT, size=16, **options):
    model = Model(asset, textures=Textures({0: pixels}))
    style = Style(**{name: options.pop(name) for name in ("mode", "cull", "wireframe") if name in options})
    return render(model, camera, size, size, style, **{"supersample": 1, **options})


def corners(image):
    """The colours of the four quarters: upper left, upper right, lower left, lower right."""
    n = len(image)
    return [image[y, x].tolist() for y in (n // 4, 3 * n // 4) for x in (n // 4, 3 * n // 4)]


RED, GREEN, BLUE, YELLOW = [250, 0, 0], [0, 250, 0], [0, 0, 250], [250, 250, 0]


def test_a_texture_stands_upright():
    assert corners(picture(scene(square(), materials=[textured()]))) == [RED, GREEN, BLUE, YELLOW]


def test_the_second_set_of_coordinates():
    turned = np.array([[0, 0], [0, 1], [1, 0], [1, 1]], np.float32)
    asset = scene(square(TEXCOORD_1=turned), materials=[textured(texCoord=1)])
    assert corners(picture(asset)) != [RED, GREEN, BLUE, YELLOW]
    assert corners(picture(asset)) == [BLUE, YELLOW, RED, GREEN]


@pytest.mark.parametrize(
    ("transform", "expected"),
    [
        ({"offset": [0.5, 0]}, [GREEN, RED, YELLOW, BLUE]),
        ({"scale": [1, -1]}, [BLUE, YELLOW, RED, GREEN]),
        ({"rotation": np.pi / 2}, [BLUE, RED, YELLOW, GREEN]),  # the image turns clockwise
        ({"texCoord": 1}, [BLUE, YELLOW, RED, GREEN]),
    ],
)
def test_texture_transforms(transform, expected):
    turned = np.array([[0, 0], [0, 1], [1, 0], [1, 1]], np.float32)
    info = {"extensions": {"KHR_texture_transform": transform}}
    assert corners(picture(scene(square(TEXCOORD_1=turned), materials=[textured(**info)]))) == expected


def test_wrap_modes_come_from_the_sampler():
    positions = grid(1)[0]
    wide = np.stack([positions[:, 0] * 2, 1 - positions[:, 1]], axis=1)
    halves = {}
    for mode in (None, MIRROR):
        samplers = [{"wrapS": mode}] if mode else None
        image = picture(scene(square(uv=wide), materials=[textured()], samplers=samplers), size=32)
        halves[mode] = image[8, [4, 12, 20, 28]].tolist()
    assert halves == {None: [RED, GREEN, RED, GREEN], MIRROR: [RED, GREEN, GREEN, RED]}


def test_a_texture_far_away_is_averaged():
    """A fine chequer under few pixels becomes even grey, not noise."""
    chequer = (np.indices((256, 256)).sum(axis=0) % 2 * 255).astype(np.uint8)[:, :, None]
    image = picture(scene(square(), materials=[textured()]), chequer, size=17)
    assert image.min() > 180  # half the light, as sRGB: 188
    assert image.max() < 195


def test_colours_of_one_s_own_stand_in_for_the_materials():
    """A colour for each face, exact where it lies; one for each vertex, blended between them."""
    asset = scene(square(), materials=[textured()])
    model = Model(asset, textures=Textures({0: QUARTERS}))
    faces = asset.meshes[0].faces
    own = np.array([[1, 0, 0], [0, 0, 1]], np.float32)
    image = render(model, FRONT, 16, 16, Style(face_colours=own, lit=False), supersample=1)
    inside = [front_pixel(asset.meshes[0].positions[face].mean(axis=0)) for face in faces]
    assert [image[at].tolist() for at in inside] == [[255, 0, 0], [0, 0, 255]]
    ends = asset.meshes[0].positions[:, :1].astype(np.float32) * np.ones((1, 3), np.float32)
    image = render(model, FRONT, 16, 16, Style(vertex_colours=ends, lit=False), supersample=1)
    assert (np.diff(image[8, :, 0].astype(int)) > 0).all()
    assert np.abs(image[:, 7:9].astype(int) - 127.5).max() <= 10


def test_factor_and_vertex_colours_multiply():
    colours = np.full((4, 3), 0.5, np.float32)
    asset = scene(square(COLOR_0=colours), materials=[flat(0.5, 1, 0, 1)])
    linear = np.array([0.25, 0.5, 0])
    expected = np.where(linear > 0, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055, 0) * 255
    np.testing.assert_allclose(picture(asset)[8, 8], expected, atol=1)


def test_a_mask_is_looked_through():
    pixels = np.dstack([QUARTERS, np.full((16, 16), 255, np.uint8)])
    pixels[:8, :8, 3] = 100
    masked = {**textured(), "alphaMode": "MASK", "alphaCutoff": 0.5}
    behind, front = square(0.0), square(0.5)
    asset = scene(front, behind, materials=[masked, flat(1, 1, 1, 1)])
    assert corners(picture(asset, pixels)) == [[255, 255, 255], GREEN, BLUE, YELLOW]
    kept = scene(front, behind, materials=[{**masked, "alphaCutoff": 0.3}, flat(1, 1, 1, 1)])
    assert corners(picture(kept, pixels)) == [RED, GREEN, BLUE, YELLOW]
    seen = buffers(Model(asset, textures=Textures({0: pixels})), FRONT, 16, 16)
    assert seen.depth[4, 4] == pytest.approx(3.0, rel=1e-4)
    assert seen.depth[12, 12] == pytest.approx(2.5, rel=1e-4)


def test_glass_lets_colours_through():
    glass = {**flat(1, 0, 0, 0.25), "alphaMode": "BLEND"}
    asset = scene(square(1.0), square(0.5), square(0.0), materials=[glass, glass, flat(0, 0, 1, 1)])
    linear = np.array([0.25 + 0.75 * 0.25, 0, 0.75 * 0.75])
    expected = np.where(linear > 0, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055, 0) * 255
    np.testing.assert_allclose(picture(asset)[8, 8], expected, atol=1)
    assert buffers(Model(asset), FRONT, 4, 4).depth == pytest.approx(2.0, rel=1e-4)  # the first surface


def test_alpha_of_an_opaque_material_means_nothing():
    assert picture(scene(square(), materials=[flat(1, 1, 1, 0)]))[8, 8].tolist() == [255, 255, 255]


@pytest.mark.parametrize("background", [LIGHT, DARK])
def test_the_background(background):
    far = Camera(np.array([0.5, 0.5, 3.0]), np.array([0.5, 0.5, 0.0]), fov=None, height=4.0)
    image = picture(scene(square(), materials=[flat(1, 1, 1, 1)]), camera=far, background=background)
    np.testing.assert_allclose(image[0, 0], np.array(background) * 255, atol=0.6)
    assert image[8, 8].tolist() == [255, 255, 255]


def test_no_background():
    far = Camera(np.array([0.5, 0.5, 3.0]), np.array([0.5, 0.5, 0.0]), fov=None, height=4.0)
    glass = {**flat(1, 0, 0, 0.5), "alphaMode": "BLEND"}
    image = picture(scene(square(), materials=[glass]), camera=far, background=None)
    assert image[0, 0].tolist() == [0, 0, 0, 0]
    assert image[8, 8].tolist() == [255, 0, 0, 128]


def test_culling_hides_backs_of_single_sided_faces():
    back = Camera(np.array([0.5, 0.5, -3.0]), np.array([0.5, 0.5, 0.0]), fov=None, height=1.0)
    one, both = (scene(square(), materials=[{**flat(0, 0, 0, 1), "doubleSided": sides}]) for sides in (False, True))
    hidden = np.rint(np.array(LIGHT) * 255).tolist()
    assert picture(one, camera=back, cull=True)[8, 8].tolist() == hidden
    assert picture(one, camera=back)[8, 8].tolist() == [0, 0, 0]
    assert picture(both, camera=back, cull=True)[8, 8].tolist() == [0, 0, 0]
    assert picture(one, cull=True)[8, 8].tolist() == [0, 0, 0]


def test_supersampling_smooths_edges():
    tilted = Camera(np.array([0.5, 0.5, 3.0]), np.array([0.5, 0.5, 0.0]), up=(0.3, 1, 0), fov=None, height=2.0)
    asset = scene(square(), materials=[flat(0, 0, 0, 1)])
    hard, soft = (picture(asset, camera=tilted, supersample=n, size=32) for n in (1, 4))
    assert len(np.unique(hard)) == 2
    assert len(np.unique(soft)) > 6
    assert hard.mean() == pytest.approx(soft.mean(), abs=12)


def test_own_normals_shade():
    """A flat square whose normals are those of a bulge is bright at its middle and darker at its sides."""
    positions, faces = grid(8)
    bulge = np.stack([positions[:, 0] * 4 - 2, 0 * positions[:, 0], np.ones(len(positions))], axis=1)
    normals = (bulge / np.linalg.norm(bulge, axis=1, keepdims=True)).astype(np.float32)
    mesh = Mesh(positions, faces, attributes={"NORMAL": normals})
    bulging, plain = Model(Asset("bulge", (mesh,))), Model(Asset("flat", (Mesh(positions, faces),)))
    with_own, without = (render(model, FRONT, 32, 32, supersample=1) for model in (bulging, plain))
    assert int(with_own[16, 12, 0]) - int(with_own[16, 31, 0]) > 20
    assert np.ptp(without) <= 1
    shapes = [render(model, FRONT, 32, 32, Style(mode="clay")) for model in (bulging, plain)]
    np.testing.assert_array_equal(*shapes)  # clay shows what the triangles say
    assert shapes[0].max() < without.max()


def test_both_sides_of_a_face_are_lit():
    back = Camera(np.array([0.5, 0.5, -3.0]), np.array([0.5, 0.5, 0.0]), fov=None, height=1.0)
    lit = Asset("square", (Mesh(*grid(1)),))
    front_view, back_view = (render(Model(lit), camera, 8, 8) for camera in (FRONT, back))
    assert back_view[4, 4, 0] > 150
    np.testing.assert_allclose(back_view.astype(int), front_view, atol=2)


def test_buffers_of_a_sphere():
    asset = Asset("ball", (Mesh(sphere(5)[0] * 2.0 + [100.0, 0, 0], sphere(5)[1]),))
    camera = Camera.around(np.array([100.0, 0, 0]), 2.0, (0, 0, 1), fov=None, margin=1.25)
    seen = buffers(Model(asset), camera, 100, 100)
    assert seen.hit.mean() == pytest.approx(np.pi * 40**2 / 100**2, rel=0.01)
    assert (seen.faces >= 0).tolist() == seen.hit.tolist()
    assert np.isinf(seen.depth[~seen.hit]).all()
    distance = np.linalg.norm(camera.position - camera.target)
    assert seen.depth.min() == pytest.approx(distance - 2, rel=1e-3)
    y, x = np.nonzero(seen.hit)
    flat_normal = np.stack([(x + 0.5) / 50 - 1, 1 - (y + 0.5) / 50], axis=1) * 1.25
    np.testing.assert_allclose(seen.normals[y, x, :2], flat_normal, atol=0.03)
    assert (seen.normals[y, x, 2] > -1e-6).all()
    assert silhouette_picture(seen)[50, 50].tolist() == [0, 0, 0]
    assert normal_picture(seen, camera)[50, 50].tolist() == pytest.approx([128, 128, 255], abs=2)
    assert depth_picture(seen)[50, 50, 0] == 255
    assert depth_picture(seen)[0, 0, 0] == 0


def test_nothing_to_see():
    empty = Model(Asset("empty", ()))
    camera = Camera.around(empty.centre, empty.radius)
    assert len(np.unique(render(empty, camera, 8, 8))) == 1
    assert depth_picture(buffers(empty, camera, 8, 8)).max() == 0


@pytest.mark.parametrize("supersample", [1, 2, 4])
def test_wires_follow_the_edges(supersample):
    asset = scene(square(), materials=[flat(1, 1, 1, 1)])
    wired = picture(asset, size=64, supersample=supersample, wireframe=1)
    dark = wired[:, :, 0] < 210
    along = np.arange(2, 62)
    assert dark[63 - along, along].all()  # the diagonal, up to the right
    assert not dark[along, along][np.abs(along - 31.5) > 3].any()
    assert dark[:, 0].all()
    assert 0.06 < dark.mean() < 0.14


@pytest.mark.parametrize(("scale", "offset"), [(1e-19, 0.0), (1e31, 0.0), (1.0, 3e7)])
def test_anything_anywhere_looks_the_same(scale, offset):
    def shot(scale, offset):
        model = Model(Asset("box", (Mesh(box()[0] * scale + offset, box()[1]),)))
        return render(model, Camera.around(model.centre, model.radius), 48, 48).astype(int)

    assert np.abs(shot(scale, offset) - shot(1.0, 0.0)).mean() < 0.1


def test_bands_and_threads_leave_no_trace(monkeypatch):
    asset = Asset("ball", (Mesh(*sphere(3)),))
    pictures = []
    for batch, threads in ((1 << 18, 1), (1 << 18, 2), (500, 0)):
        monkeypatch.setattr("lodpipe.geometry.render.BATCH", batch)
        model = Model(asset, threads=threads)
        pictures.append(render(model, Camera.around(model.centre, model.radius), 60, 41))
        assert buffers(model, Camera.around(model.centre, model.radius), 60, 41).hit.sum() > 500
    assert (pictures[0] == pictures[1]).all()
    assert (pictures[0] == pictures[2]).all()


def test_a_missing_texture_leaves_the_factor():
    asset = scene(
        square(),
        materials=[{"pbrMetallicRoughness": {"baseColorFactor": [0, 1, 0, 1], "baseColorTexture": {"index": 0}}}],
    )
    assert render(Model(asset), FRONT, 8, 8)[4, 4].tolist() == [0, 255, 0]


def test_parts_with_and_without_what_a_material_wants():
    """One primitive has no UV and no colours: it shows its factor."""
    positions, faces = grid(1)
    attributes = {
        "TEXCOORD_0": np.full((4, 2), 0.1, np.float32),
        "COLOR_0": np.full((4, 4), 0.0, np.float32),
    }
    primitives = (Primitive(material=0, attributes=tuple(attributes)), Primitive(material=0))
    mesh = Mesh(positions, faces, None, attributes, np.array([0, 1], np.int32), primitives)
    asset = Asset("two", (mesh,), (Material({**UNLIT, **textured()}),), document={"textures": [{"source": 0}]})
    image = picture(asset, np.zeros((4, 4, 3), np.uint8))
    assert (image[12, 12].tolist(), image[3, 3].tolist()) == ([0, 0, 0], [255, 255, 255])


def test_parts_with_and_without_normals():
    """What stands in the columns of a primitive without normals is not taken for one."""
    positions, faces = grid(1)
    sideways = {"NORMAL": np.tile(np.array([1, 0, 0.01], np.float32), (4, 1))}
    primitives = (Primitive(attributes=("NORMAL",)), Primitive())
    mesh = Mesh(positions, faces, None, sideways, np.array([0, 1], np.int32), primitives)
    image = render(Model(Asset("two", (mesh,))), FRONT, 16, 16)
    plain = render(Model(Asset("one", (Mesh(positions, faces),))), FRONT, 16, 16)
    assert image[3, 3, 0] == plain[3, 3, 0] > image[12, 12, 0] + 50


def test_nearest_texels_where_the_sampler_says_so():
    seen = [
        len(np.unique(picture(scene(square(), materials=[textured()], samplers=[{"magFilter": mode}]), size=64)))
        for mode in (9728, 9729)
    ]
    assert seen[0] == 2 < seen[1]


def test_which_image_a_texture_means():
    assert image_index({"source": 2}) == 2
    assert image_index({"source": 2, "extensions": {"EXT_texture_webp": {"source": 5}}}) == 5
    assert image_index({}) is None
