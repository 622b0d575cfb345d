"""Segments of an asset along its skeleton: main bodies and branches, their borders and their parts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lodpipe.core.asset import Asset
from lodpipe.core.mesh import F64, I32
from lodpipe.core.skeleton import NODE_TYPES, PARTS, Segments, Skeleton

TRUNK_SHARE = 0.6
"""A link between joints is part of the main body if it is at least so fat, compared with the joint it starts from."""
END_SHARE = 1 / 3
"""Of a branch that ends, the share of its length that is its end part."""
JOINT = NODE_TYPES.index("joint")


def segment(asset: Asset, skeleton: Skeleton) -> Segments:
    """Cut `asset.meshes` along their skeleton.

    The main body of a component with joints is its fattest node, with all joints and links that a fat enough path joins
    to it; a component without joints is a main body as a whole. Every other path is a branch, and takes along the
    thinner joint that it leads to, if any. Names are ``main`` and ``branch1``, ``branch2`` … from the longest down;
    with several components ``part1.main`` and so on.
    """
    node_segment, kinds, components, lengths = _cut(skeleton)
    order = _order(kinds, components, lengths)
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    node_segment = rank[node_segment]
    kinds, components = kinds[order], components[order]
    of_vertex = tuple(_take(node_segment, nodes) for nodes in skeleton.vertex_node)
    part = tuple(_take(_parts(skeleton, node_segment, kinds), nodes) for nodes in skeleton.vertex_node)
    border = tuple(_border(mesh.faces, own) for mesh, own in zip(asset.meshes, of_vertex, strict=True))
    return Segments(_names(kinds, components), kinds, components, node_segment, of_vertex, part, border)


def _cut(skeleton: Skeleton) -> tuple[I32, np.ndarray, I32, F64]:
    """(N,) segment of each node; kind, component and length of each segment."""
    count = len(skeleton.positions)
    near: list[list[int]] = [[] for _ in range(count)]
    for a, b in skeleton.edges.tolist():
        near[a].append(b)
        near[b].append(a)
    joint = skeleton.node_type == JOINT
    node_segment = np.full(count, -1, np.int32)
    kinds: list[int] = []
    owner: list[int] = []
    lengths: list[float] = []

    def new(kind: str, first: int, nodes: Sequence[int]) -> int:
        kinds.append(PARTS.index(kind))
        owner.append(int(skeleton.component[first]))
        lengths.append(0.0)
        node_segment[list(nodes)] = len(kinds) - 1
        return len(kinds) - 1

    for component in range(len(skeleton.components)):
        members = np.flatnonzero(skeleton.component == component)
        joints = members[joint[members]]
        if not len(joints):
            new("main", int(members[0]), members.tolist())
            continue
        trunk = int(members[skeleton.radius[members].argmax()])
        joint[trunk] = True
        main = new("main", trunk, [trunk])
        todo = [trunk]
        while todo:  # first the trunk as far as it goes, so that no branch takes it
            start = todo.pop()
            for step in near[start]:
                path = _path(near, joint, start, step)
                end, between = path[-1], path[1:-1]
                if not joint[end] or node_segment[end] >= 0:
                    if joint[end] and end != start and node_segment[end] == main and _fat(skeleton, start, between):
                        node_segment[between] = main
                    continue
                if _fat(skeleton, start, between):
                    node_segment[[*between, end]] = main
                    todo.append(end)
        todo = [n for n in members.tolist() if joint[n] and node_segment[n] == main]
        while todo:
            start = todo.pop(0)
            for step in near[start]:
                path = _path(near, joint, start, step)
                fresh = [n for n in path[1:] if node_segment[n] < 0]
                if not fresh:
                    continue
                branch = new("branch", start, fresh)
                lengths[branch] = _length(skeleton, path)
                if joint[path[-1]] and path[-1] in fresh:
                    todo.append(path[-1])
    return node_segment, np.array(kinds, np.int8), np.array(owner, np.int32), np.array(lengths)


def _parts(skeleton: Skeleton, node_segment: I32, kinds: np.ndarray) -> np.ndarray:
    """(N,) int8 the part that each node's domain is of (see `Segments.vertex_part`)."""
    part = skeleton.node_type.copy()
    near: list[list[int]] = [[] for _ in part]
    for a, b in skeleton.edges.tolist():
        near[a].append(b)
        near[b].append(a)
    has_joint = np.zeros(len(skeleton.components), bool)
    has_joint[skeleton.component[part == JOINT]] = True
    main = (kinds[node_segment] == PARTS.index("main")) & has_joint[skeleton.component]
    part[main & (part != NODE_TYPES.index("single"))] = JOINT
    for end in np.flatnonzero(part == NODE_TYPES.index("end")):
        path = [int(end)]
        while True:
            further = [n for n in near[path[-1]] if n not in path[-2:]]
            if len(path) > 1 and len(further) != 1:
                break
            path.append(further[0])
            if part[path[-1]] == JOINT:
                break
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(skeleton.positions[path], axis=0), axis=1))])
        for n in np.array(path)[along < END_SHARE * along[-1]]:
            if part[n] == NODE_TYPES.index("connection"):
                part[n] = NODE_TYPES.index("end")
    return part


def _path(near: list[list[int]], joint: np.ndarray, start: int, step: int) -> list[int]:
    """From a joint over `step` to the next joint or an end."""
    path = [start, step]
    while not joint[path[-1]]:
        further = [n for n in near[path[-1]] if n != path[-2]]
        if len(further) != 1 or further[0] == start:
            return [*path, start] if further and further[0] == start else path
        path.append(further[0])
    return path


def _fat(skeleton: Skeleton, start: int, between: Sequence[int]) -> bool:
    if not len(between):
        return True
    return bool(np.median(skeleton.radius[list(between)]) >= TRUNK_SHARE * skeleton.radius[start])


def _length(skeleton: Skeleton, path: Sequence[int]) -> float:
    return float(np.linalg.norm(np.diff(skeleton.positions[list(path)], axis=0), axis=1).sum())


def _order(kinds: np.ndarray, components: I32, lengths: F64) -> np.ndarray:
    return np.lexsort((np.arange(len(kinds)), -lengths.round(9), kinds, components))


def _names(kinds: np.ndarray, components: I32) -> tuple[str, ...]:
    several = len(components) > 0 and int(components.max()) > 0
    names = []
    number = 0
    for kind, component in zip(kinds, components, strict=True):
        number = 0 if PARTS[kind] == "main" else number + 1
        name = "main" if number == 0 else f"branch{number}"
        names.append(f"part{component + 1}.{name}" if several else name)
    return tuple(names)


def _take(table: np.ndarray, rows: I32) -> np.ndarray:
    return np.append(table, np.array([-1], table.dtype))[rows]


def _border(faces: I32, segment: I32) -> np.ndarray:
    own = segment[faces]
    mixed = (own != own[:, :1]).any(axis=1)
    border = np.zeros(len(segment), bool)
    border[faces[mixed]] = True
    return border
