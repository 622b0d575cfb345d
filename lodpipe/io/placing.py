"""Where in the node tree the written meshes go: offsets of far meshes, and the levels of MSFT_lod."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from lodpipe.io.clean import Warn
from lodpipe.io.gltf_read import INSTANCING

LOD = "MSFT_lod"
Json = dict[str, Any]
_POSE = ("matrix", "translation", "rotation", "scale", "skin", "weights")


@dataclass
class Placing:
    """rows[i][level]: the written mesh that stands for the asset's mesh i; None where it has no face left.

    `offsets` are the translations that were taken out of written meshes.
    """

    rows: list[list[int | None]]
    offsets: dict[int, list[float]] = field(default_factory=dict)


def is_bound(node: Json) -> bool:
    """Whether the mesh cannot leave the node: skinned, instanced, or with its own weights of morph targets."""
    return "skin" in node or "weights" in node or INSTANCING in node.get("extensions", {})


def place_meshes(tree: Json, placing: Placing, coverages: Sequence[float], warn: Warn) -> None:
    """Let the nodes of `tree` point at the written meshes.

    A node whose mesh has levels gets MSFT_lod: `ids` are nodes with the coarser meshes, which are in no scene, and
    `extras.MSFT_screencoverage` are the screen coverages below which the next of them is shown, one more than ids.
    Where the node has more to it than its mesh (children, motion, a light), or the mesh an offset, the mesh goes to
    a new child, so that a level replaces the mesh alone.
    """
    nodes: list[Json] = tree["nodes"]
    animated = {c["target"].get("node") for a in tree.get("animations", ()) for c in a["channels"]}
    for index in range(len(nodes)):
        node = nodes[index]
        if "mesh" not in node:
            continue
        rows = placing.rows[node["mesh"]]
        levels = any(row != rows[0] for row in rows)
        extensions = set(node.get("extensions", {}))
        if levels and LOD in extensions:
            warn(f"nodes[{index}] has levels of its own ({LOD}); they are kept, and no others added to it")
            levels = False
        more = bool(node.get("children")) or index in animated or "camera" in node or extensions - {INSTANCING}
        moved = any(row in placing.offsets for row in rows) or (levels and bool(more) and not is_bound(node))
        holder = _child(nodes, index) if moved else node
        pose = {key: holder[key] for key in _POSE if key in holder}
        _put(holder, rows[0], placing)
        if levels:
            _add_levels(nodes, holder, pose, rows, placing)
            extras = holder.get("extras")
            holder["extras"] = {**(extras if isinstance(extras, dict) else {}), "MSFT_screencoverage": list(coverages)}
    _drop_weights(tree)
    _rename_pointers(tree, [rows[0] for rows in placing.rows])


def _put(node: Json, row: int | None, placing: Placing) -> None:
    """Give `node` the written mesh `row`, with its offset."""
    if row is None:
        for key in ("mesh", "skin", "weights"):
            node.pop(key, None)
        return
    node["mesh"] = row
    if row in placing.offsets:
        node["translation"] = placing.offsets[row]


def _child(nodes: list[Json], index: int) -> Json:
    """A new child of a node that takes over its mesh."""
    node = nodes[index]
    child = {"mesh": node.pop("mesh")}
    if "name" in node:
        child["name"] = f"{node['name']}_mesh"
    node["children"] = [*node.get("children", ()), len(nodes)]
    nodes.append(child)
    return child


def _add_levels(nodes: list[Json], holder: Json, pose: Json, rows: Sequence[int | None], placing: Placing) -> None:
    """A node for each coarser level, with the pose of `holder`, named in its MSFT_lod."""
    instances = holder.get("extensions", {}).get(INSTANCING)
    ids = []
    for level, row in enumerate(rows[1:], start=1):
        node = {"name": f"{holder.get('name', 'node')}_LOD{level}", **pose}
        if instances is not None:
            node["extensions"] = {INSTANCING: instances}
        _put(node, row, placing)
        ids.append(len(nodes))
        nodes.append(node)
    holder["extensions"] = {**holder.get("extensions", {}), LOD: {"ids": ids}}


def _drop_weights(tree: Json) -> None:
    """Channels for the weights of a mesh that is no longer there, and animations that have no others."""
    nodes = tree["nodes"]
    for animation in tree.get("animations", ()):
        animation["channels"] = [
            c
            for c in animation["channels"]
            if c["target"]["path"] != "weights" or "node" not in c["target"] or "mesh" in nodes[c["target"]["node"]]
        ]
    if "animations" in tree:
        tree["animations"] = [a for a in tree["animations"] if a["channels"]]


def _rename_pointers(tree: Json, rows: list[int | None]) -> None:
    """KHR_animation_pointer names meshes in texts: /meshes/3/weights/0."""
    for animation in tree.get("animations", ()):
        for channel in animation["channels"]:
            said = channel["target"].get("extensions", {}).get("KHR_animation_pointer", {})
            match = re.match(r"/meshes/(\d+)(/.*)", str(said.get("pointer", "")))
            if match and int(match[1]) < len(rows) and rows[int(match[1])] is not None:
                said["pointer"] = f"/meshes/{rows[int(match[1])]}{match[2]}"
