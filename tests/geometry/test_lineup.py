"""Pictures of levels beside the source."""

from __future__ import annotations

import io

import numpy as np
import PIL.Image

from lodpipe.core.asset import Asset, Lod
from lodpipe.core.mesh import Mesh
from lodpipe.core.page import Page
from lodpipe.geometry import lineup
from lodpipe.geometry.surface import Model
from meshes import sphere


def balls(monkeypatch, size: int = 48) -> tuple[Asset, dict[int, Model]]:
    monkeypatch.setattr(lineup, "SIZE", size)
    monkeypatch.setattr(lineup, "SHEET", size // 2)
    meshes = [Mesh(*sphere(3)), Mesh(*sphere(1))]
    asset = Asset("ball", (meshes[0],), lods=tuple(Lod((mesh,)) for mesh in meshes))
    return asset, {n: Model(asset, level.meshes) for n, level in enumerate(asset.lods)}


def opened(picture) -> np.ndarray:
    return np.array(PIL.Image.open(io.BytesIO(picture.data)))


def test_each_level_is_seen_from_each_side_beside_the_source(monkeypatch):
    asset, models = balls(monkeypatch)
    page, asked = Page(), []
    lineup.take(page, asset, models, 2, between=lambda: asked.append(1))
    named = {picture.name: picture for picture in page.pictures}
    sides = [
        f"LOD{n}_{view}{kind}.webp" for view in ("front", "back") for n, kind in ((0, ""), (1, ""), (1, "_difference"))
    ]
    assert sorted(named) == sorted([*sides, "levels.png", "thumbnail.webp"])
    assert page.views == ["front", "back"]
    assert len(asked) == 6
    for picture in page.pictures:
        assert opened(picture).shape[:2] == (picture.height, picture.width)
        assert picture.alt
    # two rows of two, with labels
    assert named["levels.png"].width > 2 * 24
    assert named["levels.png"].height > 2 * 24


def test_the_difference_is_dark_where_nothing_differs_and_light_where_much_does():
    paper = np.full((64, 64, 4), 255, np.uint8)
    half = paper.copy()
    half[:, 32:, :3] = 0
    off = lineup.difference(paper, half)
    assert (off[:, :8, :3].max(axis=2) < 40).all()
    assert (off[:, -8:, :3].min(axis=2) > 60).all()
    clear = np.zeros((64, 64, 4), np.uint8)
    assert (lineup.difference(clear, clear)[..., 3] == 0).all()
    assert (lineup.difference(clear, paper)[..., 3] == 255).all()


def test_halving_does_not_let_what_is_not_there_bleed_in():
    picture = np.zeros((4, 4, 4), np.uint8)
    picture[::2, ::2] = 255, 0, 0, 255
    assert (lineup.halved(picture)[..., :3] == (255, 0, 0)).all()


def test_the_same_bytes_every_time_and_with_any_threads(monkeypatch):
    asset, _ = balls(monkeypatch)
    found = []
    for threads in (1, 2):
        page = Page()
        lineup.take(page, asset, {n: Model(asset, x.meshes, threads=threads) for n, x in enumerate(asset.lods)}, 1)
        found.append([picture.data for picture in page.pictures])
    assert found[0] == found[1]
