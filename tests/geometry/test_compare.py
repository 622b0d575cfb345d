"""Models whose difference is known, compared in pictures."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lodpipe.core.asset import Asset, Lod
from lodpipe.core.cache import Cache
from lodpipe.core.mesh import Mesh
from lodpipe.geometry.compare import compare_models, compare_pictures, galleries, look_at_levels, pictures
from lodpipe.geometry.pictures import PAPERS, Gallery, Setup
from lodpipe.geometry.texture import Textures
from meshes import grid, sphere

SMALL = Setup(views=6, size=96)


def ball(radius: float = 1.0, divisions: int = 4, name: str = "ball") -> Asset:
    return Asset(name, (Mesh(*sphere(divisions, radius)),))


def compared(a: Asset, b: Asset, setup: Setup = SMALL):
    return compare_models(*galleries(a, b, (Textures(), Textures()), setup), samples=2000)


@pytest.mark.parametrize("setup", [SMALL, dataclasses.replace(PAPERS, views=3, size=64)])
def test_a_model_and_itself(setup):
    figures = compared(ball(), ball(), setup).data()
    visual = figures["visual"]
    assert (visual["luminance_rms"], visual["flip"], visual["normal_degrees"]) == (0.0, 0.0, 0.0)
    assert (visual["ssim"], visual["ms_ssim"], visual["silhouette_iou"]) == (1.0, 1.0, 1.0)
    assert visual["psnr"] is None
    assert visual["psnr_reason"] == "the pictures are equal"
    assert (figures["error"]["mean"], figures["error"]["max"]) == (0.0, 0.0)


def test_from_farther_away_less_is_seen():
    found = compared(ball(divisions=5), ball(divisions=2), dataclasses.replace(SMALL, size=128)).by_size
    assert [entry["size"] for entry in found] == [128, 64, 32]
    assert (np.diff([entry["psnr"] for entry in found]) > 0).all()
    assert (np.diff([entry["ssim"] for entry in found]) > 0).all()


def test_a_smaller_ball_covers_its_share():
    figures = compared(ball(divisions=5), ball(0.8, 5), dataclasses.replace(SMALL, size=200)).visual
    assert figures.silhouette_iou == pytest.approx(0.64, abs=0.005)
    # at the same pixel the smaller ball's normal leans more: mean of asin(r / 0.8) − asin(r) over its disc
    r = np.sqrt((np.arange(20_000) + 0.5) / 20_000) * 0.8
    expected = np.degrees(np.arcsin(r / 0.8) - np.arcsin(r)).mean()
    assert figures.normal_degrees == pytest.approx(expected, rel=0.02)


def test_coarser_is_never_closer():
    fine = ball(divisions=5)
    chain = [compared(fine, ball(divisions=n)).visual for n in (4, 3, 2, 1, 0)]
    assert (np.diff([f.luminance_rms for f in chain]) > 0).all()
    for name in ("psnr", "ssim", "ms_ssim", "silhouette_iou"):
        assert (np.diff([getattr(f, name) for f in chain]) < 0).all(), name
    assert (np.diff([f.normal_degrees for f in chain]) > 0).all()
    assert (np.diff([f.flip for f in chain]) > 0).all()


def test_what_vanishes_against_one_background_is_seen_against_the_other():
    """A model as bright as the light background: its loss is seen by every second view alone."""
    white = Asset("white", (Mesh(*sphere(3)),))
    nothing = Asset("nothing", (Mesh(np.zeros((0, 3)), np.zeros((0, 3), int)),))
    light, dark = (dataclasses.replace(SMALL, views=1, backgrounds=(c,)) for c in ((0.93,) * 3, (0.08,) * 3))
    both = dataclasses.replace(SMALL, views=2)
    seen = [compared(white, nothing, setup).visual.luminance_rms for setup in (light, dark, both)]
    assert seen[0] < seen[2] < seen[1]


def test_a_model_without_triangles():
    nothing = Asset("nothing", (Mesh(np.zeros((0, 3)), np.zeros((0, 3), int)),))
    figures = compared(ball(), nothing).data()
    assert figures["error"] is None
    assert "without triangles" in figures["error_reason"]
    assert figures["visual"]["silhouette_iou"] == 0.0
    assert figures["visual"]["normal_degrees"] is None
    assert "both are seen" in figures["visual"]["normal_degrees_reason"]
    neither = compared(nothing, nothing).data()["visual"]
    assert neither["silhouette_iou"] is None
    assert neither["silhouette_iou_reason"] == neither["psnr_reason"] == "neither model shows anything"


def test_a_sheet_seen_edge_on_and_without_area():
    positions, faces = grid(4)
    flat = Asset("flat", (Mesh(positions * [1, 1, 0], faces),))
    line = Asset("line", (Mesh(positions * [1, 0, 0], faces),))  # no triangle has any area
    for a, b in ((flat, line), (line, flat), (line, line)):
        figures = compared(a, b).data()
        for value in (*figures["visual"].values(), *(figures["error"] or {}).values()):
            assert not isinstance(value, float) or np.isfinite(value), figures


def test_the_other_may_be_far_larger():
    """The cameras stand outside of both; the frame is the reference's."""
    figures = compared(ball(), ball(30.0)).visual
    assert figures.silhouette_iou == pytest.approx(np.pi / 4 / 1.02**2, abs=0.02)


def test_figures_do_not_depend_on_threads_or_place():
    def run(threads: int, scale: float = 1.0, offset: float = 0.0):
        models = [Asset("x", (Mesh(sphere(n)[0] * scale * [1.0, 0.7, 0.5] + offset, sphere(n)[1]),)) for n in (4, 2)]
        pair = galleries(*models, (Textures(), Textures()), SMALL, threads)
        return compare_pictures(*pair)

    assert run(1) == run(2) == run(0)
    assert run(1, 1e6, 3e7).psnr == pytest.approx(run(1).psnr, abs=0.2)


def test_levels_of_an_asset():
    asset = ball(divisions=4)
    levels = (Lod(asset.meshes), *(Lod((Mesh(*sphere(n)),)) for n in (3, 1)))
    asset = dataclasses.replace(asset, lods=levels)
    steps: list[float] = []
    cache = Cache()
    found = look_at_levels(
        asset, lambda shown: Textures(), SMALL, cache=cache, progress=lambda done, total: steps.append(done / total)
    )
    assert found[0].psnr is None
    assert found[1].psnr > found[2].psnr
    assert (np.diff(steps) > 0).all()
    assert steps[-1] == 1.0
    held = len(cache)
    again = look_at_levels(asset, lambda shown: Textures(), SMALL, cache=cache)
    assert again == found
    assert len(cache) == held


def test_reference_pictures_are_taken_once(monkeypatch):
    taken = []
    shoot = Gallery._take
    monkeypatch.setattr(Gallery, "_take", lambda self, view, size: taken.append(view) or shoot(self, view, size))
    cache = Cache()
    for _ in range(3):
        Gallery(ball(), SMALL, Textures(), cache=cache).shot(2)
    assert taken == [2]
    Gallery(ball(1.5), SMALL, Textures(), cache=cache).shot(2)
    Gallery(ball(), dataclasses.replace(SMALL, size=32), Textures(), cache=cache).shot(2)
    assert taken == [2, 2, 2]


def test_pairs_and_maps():
    shown = dict(pictures(*galleries(ball(), ball(0.8), (Textures(), Textures()), dataclasses.replace(SMALL, views=2))))
    assert list(shown) == [f"view0{n}_{name}" for n in (1, 2) for name in ("a", "b", "difference")] + ["all"]
    differs = shown["view02_difference"].astype(int).sum(axis=2)
    assert differs[48, 48] < differs[48, 6]  # the middle is nearly the same, the rim is not
    assert shown["all"].shape[1] > 3 * 96
