"""What can be seen from afar: shifts of known size, and models that differ by a known length."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from lodpipe.core.asset import Asset, Target
from lodpipe.core.errors import InvalidMesh
from lodpipe.core.material import Image
from lodpipe.core.mesh import Mesh
from lodpipe.geometry.decimate import decimate, decimate_asset
from lodpipe.geometry.pictures import Gallery, Setup
from lodpipe.geometry.texture import Textures
from lodpipe.geometry.visible import HEIGHTS, NOTICED, Sight, coarsest
from lodpipe.kernel import picture_reference
from lodpipe.kernel.picture_reference import phases
from lodpipe.kernel.pictures import shrunk
from meshes import sphere


def unexplained(a, b):
    return picture_reference.unexplained(a, b, NOTICED)


SETUP = Setup(views=4, size=256)


def scenery():
    rng = np.random.default_rng(5)
    return rng.random((10, 10, 4)).repeat(8, 0).repeat(8, 1).astype(np.float32)


def flat(picture):
    """A picture of whole pixels, each of them constant over its area, in phases."""
    rgba = np.dstack([picture, np.ones(picture.shape[:2], np.float32)])
    return phases(rgba.repeat(2, 0).repeat(2, 1), len(picture))[:, :, :3]


@pytest.mark.parametrize(("dx", "dy"), [(0, 0), (2, 0), (0, -2), (2, 2), (-1, 1), (1, 0), (2, -1)])
def test_a_shift_of_up_to_one_pixel_explains_all(dx, dy):
    fine = scenery()
    a, b = (phases(x, 40) for x in (fine, np.roll(fine, (dy, dx), (0, 1))))  # two rows a pixel
    assert not unexplained(a, b)[2:-2, 2:-2].any()


def test_a_shift_of_two_pixels_does_not():
    fine = scenery()
    assert unexplained(phases(fine, 40), phases(np.roll(fine, 4, 1), 40))[4:-4, 4:-4].mean() > 0.05


@pytest.mark.parametrize(("change", "seen"), [(0.9, False), (-0.9, False), (1.1, True), (-1.1, True)])
def test_a_change_counts_from_what_can_be_noticed(change, seen):
    a = np.full((9, 9, 3), 0.5, np.float32)
    b = a.copy()
    b[2:7, 2:7, 1] += np.float32(change * NOTICED)
    assert unexplained(flat(a), flat(b))[4, 4] == unexplained(flat(b), flat(a))[4, 4] == seen


def test_shrinking_keeps_the_mean_and_areas():
    image = np.random.default_rng(0).random((60, 60, 4)).astype(np.float32)
    small = shrunk(image, 20)
    np.testing.assert_allclose(small, image.reshape(20, 3, 20, 3, 4).mean((1, 3)), atol=1e-5)
    assert shrunk(image, 23).mean() == pytest.approx(image.mean(), rel=2e-3)
    assert shrunk(image, 60) is image


def ball(radius: float = 1.0, divisions: int = 5) -> Asset:
    return Asset("ball", (Mesh(*sphere(divisions, radius)),))


def gallery(asset: Asset, frame=None, setup: Setup = SETUP) -> Gallery:
    made = Gallery(asset, setup, Textures(), frame)
    made.model.prepare()
    return made


@pytest.mark.parametrize("gap", [0.02, 0.03, 0.06])
def test_a_gap_at_the_outline_is_seen_from_one_pixel_on(gap):
    """A ball that is smaller by `gap` radii is told from the whole where that is a little more than a pixel."""
    source = gallery(ball(divisions=6))
    height, seen = Sight(source).unseen_height(gallery(ball(1 - gap, 6), source.sphere))
    assert seen
    assert 0.95 < gap * height / 2 / np.sqrt(3) < 1.4  # the diagonal of the ball's box is 2·√3 radii


def test_the_same_is_never_told_apart():
    source = gallery(ball())
    height, seen = Sight(source).unseen_height(source)
    assert not seen
    assert height == pytest.approx(Sight(source).scale * SETUP.size)
    closer, _ = Sight(source).unseen_height(source, largest=500.0)  # in larger pictures
    assert closer >= 500.0


def test_nothing_in_its_place_is_seen_at_every_height():
    source = gallery(ball())
    empty = Asset("empty", (Mesh(np.zeros((0, 3)), np.zeros((0, 3), int)),))
    assert Sight(source).unseen_height(gallery(empty, source.sphere)) == (0.0, True)


def test_coarser_is_seen_from_farther():
    source = gallery(ball())
    sight = Sight(source)
    heights = [sight.of(ball(divisions=n)) for n in (5, 3, 2, 1)]
    assert heights[0] >= heights[1] > heights[2] > heights[3] > 0


@pytest.mark.parametrize("wanted", [3.0, 40.0, 410.0, 5000.0])
@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_search_finds_the_coarsest_in_few_steps(wanted, power):
    asked = []

    def height_of(number: int) -> float:
        asked.append(number)
        return (0.02 * number) ** power

    found = coarsest(height_of, wanted, {100_000: math.inf})
    exact = wanted ** (1 / power) / 0.02
    assert exact <= found <= max(exact * 1.03, exact + 2) or found == 100_000 < exact
    assert len(asked) <= 16


def test_search_over_steps_ends():
    """Heights come in steps: the search ends at an edge, whatever its guesses."""
    steps = {100: 10.0, 400: 90.0}
    known = {1000: math.inf}
    found = coarsest(lambda n: max((h for edge, h in steps.items() if n >= edge), default=0.0), 50.0, known)
    assert 400 <= found <= 408
    before = len(known)
    assert coarsest(lambda n: pytest.fail("it is known"), 50.0, known) == found
    assert len(known) == before


def test_a_target_in_pixels_is_met():
    asset = ball(divisions=4)
    targets = [Target(pixels=1, screen=0.15), Target(pixels=3, screen=0.15)]
    sight = Sight(gallery(asset, setup=dataclasses.replace(SETUP, views=2, size=128)))
    levels = decimate_asset(asset, targets, unseen=sight.of)
    assert [level.stop_reason for level in levels[1:]] == ["pixels", "pixels"]
    assert levels[0].triangles > levels[1].triangles > levels[2].triangles
    for level, target in zip(levels[1:], targets, strict=True):
        height = target.screen * 1080 / target.pixels
        assert sight.of(asset.at(level), height) >= height
        coarser = decimate(asset, int(level.triangles * 0.8))
        assert sight.of(coarser, height) < height


def test_a_target_that_needs_every_triangle_gives_the_source():
    asset = Asset("eight", (Mesh(*sphere(0)),))  # no vertex of an octahedron can go unseen
    (_, level) = decimate_asset(asset, [Target(pixels=1, screen=0.2)], unseen=Sight(gallery(asset)).of)
    assert (level.triangles, level.stop_reason) == (8, "pixels")


def test_textures_have_to_be_seen():
    asset = dataclasses.replace(ball(divisions=1), images=(Image(b"x"),))
    with pytest.raises(InvalidMesh, match="has to see the textures; use the stage"):
        decimate(asset, Target(pixels=1, screen=0.5))


@pytest.mark.parametrize(
    "target", [Target(pixels=1), Target(screen=0.5), Target(pixels=0, screen=1), Target(pixels=1, screen=2)]
)
def test_targets_out_of_range(target):
    with pytest.raises(InvalidMesh, match="pixels above 0 at a screen share"):
        decimate(ball(divisions=1), target)


def test_heights_ascend():
    assert (np.diff(HEIGHTS) > 0).all()
