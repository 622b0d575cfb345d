"""Parts of an asset by name: segments, kinds and parts of segments, nodes, meshes and materials."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.asset import Asset
from lodpipe.core.errors import InvalidMesh
from lodpipe.core.mesh import F32, I32
from lodpipe.core.skeleton import NODE_TYPES, PARTS
from lodpipe.kernel import Decimation, Level

STEP, TRIES = 4.0, 12
"""Quadrics of a part that must keep more triangles are multiplied by so much, at most so often."""

Bool = NDArray[np.bool_]


@dataclass(frozen=True)
class PartRule:
    """What is asked of a part.

    pin     its vertices are neither moved nor removed
    weight  multiplies its vertices' quadrics, > 0
    keep    share of its triangles that it keeps at every level that has room for them, 0…1; 1 is `pin`
    """

    pin: bool = False
    weight: float = 1.0
    keep: float | None = None


@dataclass(frozen=True, eq=False)
class Part:
    """The vertices and the faces of a part: for each mesh (V,) bool and (F,) bool."""

    vertices: tuple[Bool, ...]
    faces: tuple[Bool, ...]


def part_names(asset: Asset) -> dict[str, str]:
    """Every name that `part` knows, and what it names."""
    names: dict[str, str] = {}
    for material in asset.materials:
        if material.name:
            names[material.name] = "material"
    for mesh in asset.meshes:
        if mesh.name:
            names[mesh.name] = "mesh"
    for node in asset.document.get("nodes", ()):
        if node.get("name") and "mesh" in node:
            names[str(node["name"])] = "node"
    if asset.segments is not None:
        names |= dict.fromkeys(NODE_TYPES, "node type")
        names |= dict.fromkeys(asset.segments.names, "segment")
        names |= dict.fromkeys(PARTS, "kind")
    return names


def part(asset: Asset, name: str) -> Part:
    """The part called `name`. Raises InvalidMesh if there is none, and says which there are."""
    names = part_names(asset)
    kind = names.get(name)
    if kind is None:
        close = difflib.get_close_matches(name, names, 1)
        hint = f"did you mean '{close[0]}'?" if close else f"there are: {', '.join(sorted(names)) or 'none'}"
        if asset.segments is None:
            hint += " (segments need `skeleton` and `segment` before this stage)"
        raise InvalidMesh(f"there is no part '{name}'", advice=hint)
    vertices, faces = [], []
    for index, mesh in enumerate(asset.meshes):
        inside = np.zeros(len(mesh.positions), bool)
        if kind == "material":
            rows = [i for i, m in enumerate(asset.materials) if m.name == name]
            own = np.isin(mesh.face_material, rows)
            inside[mesh.faces[own]] = True
        else:
            inside = _vertices(asset, index, name, kind)
            own = np.asarray(inside[mesh.faces].all(axis=1))
        vertices.append(inside)
        faces.append(own)
    return Part(tuple(vertices), tuple(faces))


def _vertices(asset: Asset, index: int, name: str, kind: str) -> Bool:
    mesh, segments = asset.meshes[index], asset.segments
    if kind in ("mesh", "node") or segments is None:
        nodes = asset.document.get("nodes", ())
        named = mesh.name == name or any(n.get("mesh") == index and n.get("name") == name for n in nodes)
        return np.full(len(mesh.positions), named)
    if kind == "node type":
        return np.asarray(segments.vertex_part[index] == NODE_TYPES.index(name))
    if kind == "segment" and name not in PARTS:
        return np.asarray(segments.vertex_segment[index] == segments.names.index(name))
    chosen = np.append(segments.kind == PARTS.index(name), False)
    return np.asarray(chosen[segments.vertex_segment[index]])


def hold_shares(
    faces: I32,
    levels: Sequence[Level],
    shares: Sequence[tuple[float, Bool]],
    factors: F32,
    run: Callable[[F32 | None, list[int]], Decimation],
) -> list[Level]:
    """Levels at which each part (keep, (F,) faces) has its share of triangles left, as far as the level has room.

    The quadrics of a part that has too few are multiplied, by STEP each time, until it has enough or TRIES are over.
    """
    held = []
    for level in levels:
        best, weight = level, factors.astype(np.float64)
        for _ in range(TRIES):
            short = [mask for keep, mask in shares if _left(best, mask) < min(keep * mask.sum(), best.target)]
            if not short:
                break
            for mask in short:
                inside = np.zeros(len(weight), bool)
                inside[faces[mask]] = True
                weight[inside] *= STEP
            best = run(weight.astype(np.float32), [level.target]).levels[0]
        held.append(best)
    return held


def _left(level: Level, mask: Bool) -> int:
    return int(mask[level.face_source].sum())
