"""`recenter`: move and scale a model to a pivot, as game engines and catalogues want it."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from lodpipe.core.asset import Asset
from lodpipe.core.errors import InvalidMesh
from lodpipe.core.mesh import F64, Mesh
from lodpipe.geometry.flatten import flatten
from lodpipe.stage import Context, Params, stage


class RecenterParams(Params):
    """Parameters of `recenter`."""

    pivot: Literal["base", "centre", "origin"] = "base"
    """What comes to stand at the origin: the middle of the bounding box's underside, its centre, or what is there
    already (nothing is moved)."""
    up: Literal["x", "y", "z"] = "y"
    """The axis that points up, which is what makes a side the underside. glTF's is y."""
    size: Annotated[float, Field(gt=0)] | None = None
    """Length of the bounding box's longest side afterwards; left out, the scale stays."""


@stage("recenter")
def recenter(asset: Asset, params: RecenterParams, context: Context) -> Asset:
    """Move a model's pivot to the origin, and scale the model to a size if one is given.

    Acts through the node tree, with one root node above all others, so that meshes, levels, skins and animations
    stay as they are. A file without nodes (OBJ, PLY, …) has its positions moved, in every level.
    """
    soup = flatten(asset)
    low, high = soup.bounds
    longest = float((high - low).max())
    if params.size is not None and not longest > 0:
        raise InvalidMesh("the model has no extent, so it cannot be scaled", advice="leave `size` out")
    scale = 1.0 if params.size is None else params.size / longest
    pivot = np.zeros(3) if params.pivot == "origin" else (low + high) / 2
    if params.pivot == "base":
        axis = "xyz".index(params.up)
        pivot[axis] = low[axis]
    context.record("scale", scale)
    context.record("moved", float(np.linalg.norm(pivot)), "source unit")
    if scale == 1.0 and not pivot.any():
        return asset
    if asset.document.get("nodes") and asset.document.get("scenes"):
        return dataclasses.replace(asset, document=_under_root(asset.document, pivot, scale))
    return _moved(asset, pivot, scale)


def _under_root(document: Mapping[str, Any], pivot: F64, scale: float) -> dict[str, Any]:
    """The document with every scene's roots under one new node: p -> scale · (p − pivot)."""
    nodes = [dict(node) for node in document["nodes"]]
    scenes = [dict(scene) for scene in document["scenes"]]
    for scene in scenes:
        roots = list(scene.get("nodes", ()))
        if not roots:
            continue
        scene["nodes"] = [len(nodes)]
        nodes.append(
            {
                "name": "recenter",
                "children": roots,
                "translation": (-scale * pivot).tolist(),
                "scale": [scale] * 3,
            }
        )
    return {**document, "nodes": nodes, "scenes": scenes}


def _moved(asset: Asset, pivot: F64, scale: float) -> Asset:
    def moved(mesh: Mesh) -> Mesh:
        return dataclasses.replace(mesh, positions=(mesh.positions - pivot) * scale)

    done = {id(mesh): moved(mesh) for mesh in asset.meshes}  # a level that shares a mesh goes on sharing it
    levels = [
        dataclasses.replace(level, meshes=tuple(done.get(id(mesh)) or moved(mesh) for mesh in level.meshes))
        for level in asset.lods
    ]
    return dataclasses.replace(asset, meshes=tuple(done[id(mesh)] for mesh in asset.meshes), lods=tuple(levels))
