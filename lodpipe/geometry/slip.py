"""How far a texture has slipped over the surface, where two models have the same UV layout."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lodpipe.core.mesh import F32, F64, I32
from lodpipe.geometry.distance import doubled_areas, sample_surface
from lodpipe.geometry.surface import Model
from lodpipe.kernel.surfaces import TriangleTree

UV = "TEXCOORD_0"
FAR = 5.0
"""Per cent of the diagonal beyond which a texture has not slipped: another part of it is there."""
ENOUGH = 0.8
"""Share of the samples that must have slipped by less than FAR for the layouts to be the same."""


@dataclass(frozen=True)
class Slip:
    """Texture deviation in % of the diagonal of a's bounding box (after Cohen, Olano & Manocha 1998).

    mean, rms      over the samples whose UVs correspond
    corresponding  the share of those, 0…1: the others lie at seams, or where other parts of the texture are
    """

    mean: float
    rms: float
    corresponding: float


def texture_slip(a: Model, b: Model, samples: int = 50_000, seed: int = 0) -> Slip | str:
    """How far the texture of `b` has slipped against a's, or why that cannot be said.

    Points spread over `a` by area look for the closest point of `b`. What their UVs differ by, times the size that
    a's face has in space over its size in UV space, is the length by which the texture has slipped there.
    """
    ours, theirs = a.soup.attribute(UV), b.soup.attribute(UV)
    if ours is None or theirs is None:
        return "one of the two has no UVs"
    area = doubled_areas(a.positions, a.faces)
    uv = ours[0][a.soup.wedges].astype(np.float64)[:, :, :2]
    d, e = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    flat = np.abs(d[:, 0] * e[:, 1] - d[:, 1] * e[:, 0])
    usable = np.where(ours[1] & (flat > 0) & np.isfinite(flat), area, np.float32(0.0))
    if not usable.any():
        return "no face of the first has an area in UV space"
    points, faces = sample_surface(a.positions, a.faces, usable, samples, seed)
    world = points.astype(np.float64) * a.radius + a.centre
    _, near, there = TriangleTree(b.positions, b.faces).closest(((world - b.centre) / b.radius).astype(np.float32))
    theirs_uv = theirs[0][b.soup.wedges[there]].astype(np.float64)[:, :, :2]
    gap = _at(points, a.positions, a.faces[faces], uv[faces]) - _at(near, b.positions, b.faces[there], theirs_uv)
    length = np.sqrt(area[faces] / flat[faces]) * a.radius
    slip = 100 * np.linalg.norm(gap, axis=1) * length / a.soup.diagonal
    good = np.isfinite(slip) & (slip <= FAR) & theirs[1][there]
    share = float(good.mean())
    if share < ENOUGH:
        return f"the UV layouts do not correspond: {100 * share:.0f} % of the surface has the same part of the texture"
    return Slip(float(slip[good].mean()), float(np.sqrt(np.square(slip[good]).mean())), share)


def _at(points: F32 | F64, positions: F32, faces: I32, uv: F64) -> F64:
    """(N, 2): the UVs (N, 3, 2) of triangles `faces` (N, 3), at `points` (N, 3) that lie in them."""
    p, q, r = (positions[faces[:, k]].astype(np.float64) for k in range(3))
    to, e, f = points.astype(np.float64) - p, q - p, r - p
    ee, ef, ff = (np.einsum("nd,nd->n", x, y) for x, y in ((e, e), (e, f), (f, f)))
    te, tf = np.einsum("nd,nd->n", to, e), np.einsum("nd,nd->n", to, f)
    determinant = ee * ff - ef * ef
    safe = np.where(determinant > 1e-12 * ee * ff, determinant, np.inf)  # a face without area: its first corner's UVs
    v, w = (ff * te - ef * tf) / safe, (ee * tf - ef * te) / safe
    v, w = np.clip(v, 0, 1)[:, None], np.clip(w, 0, 1)[:, None]
    blended: F64 = uv[:, 0] * (1 - v - w) + uv[:, 1] * v + uv[:, 2] * w
    return blended
