"""`drop_small_parts`: leave out of each level the parts that nobody could see at the distance it is used at."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lodpipe.core.asset import Asset, Lod
from lodpipe.core.mesh import F64, Mesh
from lodpipe.geometry.flatten import flatten
from lodpipe.geometry.switch import SCREEN_HEIGHT, settle_switches
from lodpipe.geometry.topology import components
from lodpipe.stage import Context, Params, stage


class DropSmallPartsParams(Params):
    """Parameters of `drop_small_parts`."""

    pixels: Annotated[float, Field(gt=0)] = 1.0
    """A part whose bounding box has a shorter diagonal than this on the screen is dropped."""
    height: Annotated[int, Field(ge=1)] = SCREEN_HEIGHT
    """Height of the screen, in pixels."""


@stage("drop_small_parts")
def drop_small_parts(asset: Asset, params: DropSmallPartsParams, context: Context) -> Asset:
    """Drop connected parts smaller than a pixel at the screen coverage at which each level takes over.

    A model whose diagonal takes the share s of the screen's height shows a part of the length l with
    l / diagonal · s · height pixels. Level 0 stays whole, so does the largest part of each mesh, and so do meshes that
    may not be changed. The stage belongs between `decimate` and `report`: it takes the coverage from the decimator's
    estimate of the error, and what was measured before it is no longer true of a level that it changes.
    """
    asset = settle_switches(asset)
    diagonal = flatten(asset).diagonal
    scales = _scales(asset)
    levels = list(asset.lods)
    for number, level in enumerate(levels):
        if number == 0 or level.switch is None or not diagonal > 0:
            continue
        smallest = params.pixels * diagonal / (level.switch.screen_coverage * params.height)
        levels[number] = _without_small(level, scales, smallest)
        dropped = level.triangles - levels[number].triangles
        context.record(f"triangles dropped from level {number}", dropped)
    return dataclasses.replace(asset, lods=tuple(levels))


def _scales(asset: Asset) -> list[float]:
    """For each mesh the largest scale at which a node places it; 0 for one that is not placed."""
    scales = [0.0] * len(asset.meshes)
    for index, matrix in asset.instances():
        scales[index] = max(scales[index], float(np.linalg.norm(matrix[:3, :3], ord=2)))
    return scales


def _without_small(level: Lod, scales: list[float], smallest: float) -> Lod:
    """`level` with what is left of its meshes; what was measured of it before is no longer true then."""
    meshes = tuple(
        mesh if mesh.keep_reason or not scale else _keep_parts(mesh, smallest / scale)
        for mesh, scale in zip(level.meshes, scales, strict=True)
    )
    same = all(kept is mesh for kept, mesh in zip(meshes, level.meshes, strict=True))
    return level if same else dataclasses.replace(level, meshes=meshes, error=None)


def _keep_parts(mesh: Mesh, smallest: float) -> Mesh:
    """`mesh` without the parts whose bounding box's diagonal is under `smallest`; its largest part stays."""
    if not len(mesh.faces):
        return mesh
    label = components(mesh.faces, len(mesh.positions))[mesh.faces[:, 0]]
    labels, part = np.unique(label, return_inverse=True)
    sizes = _diagonals(mesh, part, len(labels))
    keep = (sizes >= smallest) | (sizes == sizes.max())
    if keep.all():
        return mesh
    faces: NDArray[np.bool_] = keep[part]
    return dataclasses.replace(
        mesh, faces=mesh.faces[faces], wedges=mesh.wedges[faces], face_primitive=mesh.face_primitive[faces]
    )


def _diagonals(mesh: Mesh, part: NDArray[np.intp], count: int) -> F64:
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    corners = mesh.positions[mesh.faces]
    np.minimum.at(low, part, corners.min(axis=1))
    np.maximum.at(high, part, corners.max(axis=1))
    diagonals: F64 = np.linalg.norm(high - low, axis=1)
    return diagonals
