"""How much of each vertex's surroundings can be seen from outside."""

from __future__ import annotations

import numpy as np

from lodpipe import kernel
from lodpipe.core.asset import Asset
from lodpipe.core.mesh import F32
from lodpipe.geometry.camera import bounding_sphere, views
from lodpipe.geometry.flatten import Bool, Soup, flatten

VIEWS = 30
PIXELS_PER_FACE = 16
PIXELS = (400_000, 6_000_000)
"""Least and most pixels over all views."""


def vertex_visibility(asset: Asset, threads: int = 0) -> list[F32]:
    """For each of the asset's meshes (V,) float32 in 0…1: the share of a vertex's faces that is seen from outside.

    In pictures from `VIEWS` directions all round: of the pixels that a face would take up if nothing else were there,
    how many does it, one side of it taken alone. 1 for what nothing ever covers; a vertex has the largest share among
    its neighbours, so that what is seen at a shallow angle past an edge counts. Of several placements of a mesh the
    one that is seen most counts. What is glass or cut out by alpha covers nothing and counts as seen.
    """
    soup = flatten(asset)
    shares: list[F32] = [np.zeros(len(mesh.positions), np.float32) for mesh in asset.meshes]
    placed = {id(mesh): number for number, mesh in enumerate(asset.meshes)}
    if not len(soup.faces):
        return shares
    centre, radius = bounding_sphere(soup)
    positions = ((soup.positions - centre) / radius).astype(np.float32)
    side = int(np.sqrt(np.clip(PIXELS_PER_FACE * len(soup.faces), *PIXELS) / VIEWS))
    half = views(VIEWS)[: VIEWS // 2]  # each stands for its opposite, too
    seen = kernel.vertex_visibility(positions, soup.faces, _opaque(asset, soup), half, side, threads)
    start = 0
    for part in soup.parts:
        share = shares[placed[id(part.mesh)]]
        np.maximum(share, seen[start : start + len(share)], out=share)
        start += len(share)
    return shares


def _opaque(asset: Asset, soup: Soup) -> Bool:
    """(F,) bool: which of the soup's faces hide what lies behind them."""
    clear = [number for number, m in enumerate(asset.materials) if m.alpha_mode != "OPAQUE"]
    hides: Bool = ~np.isin(soup.face_material, clear)
    return hides
