"""Textures that have slipped by known lengths."""

from __future__ import annotations

import numpy as np
import pytest

from lodpipe.core.asset import Asset
from lodpipe.core.mesh import Mesh
from lodpipe.geometry.slip import texture_slip
from lodpipe.geometry.surface import Model
from meshes import grid


def sheet(uv=None, cells: int = 6, scale: float = 1.0, offset: float = 0.0) -> Model:
    positions, faces = grid(cells)
    given = positions[:, :2] if uv is None else uv(positions[:, :2])
    mesh = Mesh(positions * scale + offset, faces, attributes={"TEXCOORD_0": given.astype(np.float32)})
    return Model(Asset("sheet", (mesh,)))


@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (1e5, 3e6), (1e-9, 0.0)])
def test_a_shifted_texture_has_slipped_by_its_shift(scale, offset):
    shifted = sheet(lambda uv: uv + np.array([0.03, 0.04]), 3, scale, offset)
    slip = texture_slip(sheet(scale=scale, offset=offset), shifted, 2000)
    expected = 100 * 0.05 / np.sqrt(2)  # of the diagonal
    assert (slip.mean, slip.rms) == pytest.approx((expected, expected), rel=1e-2)
    assert slip.corresponding == 1.0


def test_the_same_layout_on_other_triangles_has_not_slipped():
    slip = texture_slip(sheet(), sheet(cells=5), 2000)
    assert slip.mean < 1e-4


def test_what_the_scale_of_uvs_is_does_not_matter():
    a, b = (sheet(lambda uv, s=s: 40 * (uv + np.array([s, 0]))) for s in (0.0, 0.01))
    assert texture_slip(a, b, 2000).mean == pytest.approx(100 * 0.01 / np.sqrt(2), rel=1e-3)


def test_other_layouts_are_told():
    assert "do not correspond: 0 %" in texture_slip(sheet(), sheet(lambda uv: uv + 7), 2000)
    half = sheet(lambda uv: uv + np.where(uv[:, :1] > 0.4, 7, 0))
    assert "do not correspond" in texture_slip(sheet(), half, 2000)


def test_without_uvs_there_is_no_figure():
    plain = Model(Asset("plain", (Mesh(*grid(2)),)))
    assert texture_slip(plain, sheet(), 100) == texture_slip(sheet(), plain, 100) == "one of the two has no UVs"
    assert "no face of the first" in texture_slip(sheet(lambda uv: uv * 0), sheet(), 100)
    broken = sheet(lambda uv: np.where(uv > 0.9, np.nan, uv))
    assert np.isfinite(texture_slip(broken, sheet(), 2000).mean)
