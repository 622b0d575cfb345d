"""How much of each vertex's surroundings can be seen from outside."""

from __future__ import annotations

import numpy as np

from lodpipe.core.asset import Asset
from lodpipe.core.mesh import F32, F64, I32
from lodpipe.geometry.camera import bounding_sphere, views
from lodpipe.geometry.flatten import Part, Soup, flatten

VIEWS = 30
RAYS_PER_FACE = 8
RAYS = (200_000, 3_000_000)
"""Least and most rays over all views."""


def vertex_visibility(asset: Asset, threads: int = 0) -> list[F32]:
    """For each of the asset's meshes (V,) float32 in 0…1: the share of a vertex's faces that is seen from outside.

    Parallel rays from `VIEWS` directions all round: of the rays that would meet a face if nothing else were there,
    how many do, one side of it taken alone. 1 for what nothing ever covers; a vertex has the largest share among its
    neighbours, so that what is seen at a shallow angle past an edge counts. Of several placements of a mesh the one
    that is seen most counts. What is glass or cut out by alpha covers nothing and counts as seen.
    """
    soup = flatten(asset)
    shares: list[F32] = [np.zeros(len(mesh.positions), np.float32) for mesh in asset.meshes]
    placed = {id(mesh): number for number, mesh in enumerate(asset.meshes)}
    if not len(soup.faces):
        return shares
    met, wanted = _rays(soup, _opaque(asset, soup), threads)
    for part in soup.parts:
        share = shares[placed[id(part.mesh)]]
        rows = slice(part.first_face, part.first_face + len(part.mesh.faces))
        np.maximum(share, _at_vertices(part, met[rows], wanted[rows]), out=share)
    return shares


def _opaque(asset: Asset, soup: Soup) -> I32:
    """Rows of the soup's faces that hide what lies behind them."""
    clear = [number for number, m in enumerate(asset.materials) if m.alpha_mode != "OPAQUE"]
    return np.flatnonzero(~np.isin(soup.face_material, clear)).astype(np.int32)


def _rays(soup: Soup, opaque: I32, threads: int) -> tuple[F64, F64]:
    """For each face of the soup: rays that met it, and that would have if it were alone."""
    from lodpipe.o3d import RayScene

    centre, radius = bounding_sphere(soup)
    positions = ((soup.positions - centre) / radius).astype(np.float32)
    scene = RayScene(positions, soup.faces[opaque], threads)
    side = int(np.sqrt(np.clip(RAYS_PER_FACE * len(soup.faces), *RAYS) / VIEWS))
    grid = (np.arange(side, dtype=np.float32) + 0.5) / side * 2 - 1
    x, y = np.meshgrid(grid, grid)
    corners = positions[soup.faces].astype(np.float64)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    met, wanted = np.zeros(len(soup.faces)), np.zeros(len(soup.faces))
    for towards in views(VIEWS):
        right = np.cross(towards, np.eye(3)[np.argmin(np.abs(towards))])
        right /= np.linalg.norm(right)
        up = np.cross(towards, right)
        origins = x.reshape(-1, 1) * right + y.reshape(-1, 1) * up + 2 * towards
        hits = scene.cast(origins.astype(np.float32), np.broadcast_to(-towards, origins.shape).astype(np.float32))
        found = opaque[hits.faces[hits.faces >= 0]]
        met += np.bincount(found, minlength=len(met))
        wanted += np.abs(across @ towards)
    wanted *= side * side / 4 / 2  # a face has two sides, each seen from half of the views
    clear = np.ones(len(met), bool)
    clear[opaque] = False
    met[clear] = wanted[clear]
    return met, wanted


def _at_vertices(part: Part, met: F64, wanted: F64) -> F32:
    count = len(part.mesh.positions)
    faces = part.mesh.faces
    seen = np.bincount(faces.ravel(), np.repeat(met, 3), count)
    share = np.minimum(seen / np.maximum(np.bincount(faces.ravel(), np.repeat(wanted, 3), count), 1e-12), 1.0)
    spread = share.copy()
    np.maximum.at(spread, faces.ravel(), np.repeat(share[faces].max(axis=1), 3))
    return spread.astype(np.float32)
