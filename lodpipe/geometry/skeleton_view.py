"""A skeleton and the segments as a model that any viewer shows: tubes and balls in a surface of coloured faces."""

from __future__ import annotations

import numpy as np

from lodpipe.core.asset import Asset
from lodpipe.core.material import Material
from lodpipe.core.mesh import F32, F64, I32, Mesh, Primitive
from lodpipe.core.skeleton import NODE_TYPES, Segments, Skeleton
from lodpipe.geometry.flatten import flatten_once

TUBE, BALL = 0.004, {"end": 0.013, "connection": 0.006, "joint": 0.016, "single": 0.016}
"""Radii, shares of the model's diagonal."""
NODE_COLOURS = {
    "end": (0.85, 0.1, 0.08),
    "connection": (0.9, 0.7, 0.1),
    "joint": (0.1, 0.25, 0.85),
    "single": (0.1, 0.25, 0.85),
}
TUBE_COLOUR = (0.08, 0.08, 0.1)
MAIN_COLOUR = (0.62, 0.62, 0.6)
SIDES = 8
Parts = list[tuple[F64, I32, tuple[float, float, float]]]


def skeleton_model(asset: Asset, skeleton: Skeleton, segments: Segments | None = None, opacity: float = 0.45) -> Asset:
    """A new asset: mesh ``skeleton`` (ends red, joints blue, connections yellow), and mesh ``segments`` if given.

    `opacity` of the segments' surface, 0…1. Both meshes are in world space and carry linear COLOR_0.
    """
    meshes, materials, nodes = [], [], []
    tubes = _tubes(skeleton, flatten_once(asset).diagonal or 1.0)
    if tubes:
        meshes.append(_coloured("skeleton", tubes))
        materials.append(_material("skeleton", 1.0))
    if segments is not None:
        meshes.append(_surface(asset, segments, len(materials)))
        materials.append(_material("segments", opacity))
    for index, mesh in enumerate(meshes):
        nodes.append({"name": mesh.name, "mesh": index})
    document = {"scene": 0, "scenes": [{"nodes": list(range(len(nodes)))}], "nodes": nodes}
    return Asset(f"{asset.name}_skeleton", tuple(meshes), tuple(materials), document=document, format="glb")


def segment_colours(segments: Segments) -> F32:
    """(S, 3) float32 linear colours: grey for main bodies, well-spread hues for branches."""
    colours = np.empty((len(segments.names), 3), np.float32)
    branch = np.cumsum(segments.kind == 1) - 1
    for row, kind in enumerate(segments.kind):
        colours[row] = MAIN_COLOUR if kind == 0 else _hue(branch[row] * 0.61803 % 1, 0.35 + 0.3 * (branch[row] % 2))
    return colours


def _hue(hue: float, light: float) -> F64:
    wave = np.clip(np.abs((hue * 6 + np.array([0.0, 4.0, 2.0])) % 6 - 3) - 1, 0, 1)
    return np.asarray((0.15 + 0.85 * wave) * light * 1.4)


def _surface(asset: Asset, segments: Segments, material: int) -> Mesh:
    soup = flatten_once(asset)
    drawn = [index for index, mesh in enumerate(asset.meshes) if len(mesh.faces)]
    label = np.concatenate([segments.vertex_segment[index] for index in drawn])
    own = label[soup.faces]
    middle = np.where(own[:, 1] == own[:, 2], own[:, 1], own[:, 0])  # most of the corners decide
    key = soup.faces.astype(np.int64) * (len(segments.names) + 1) + middle[:, None] + 1
    wedge, wedges = np.unique(key, return_inverse=True)
    palette = np.concatenate([[[0.3, 0.3, 0.3]], segment_colours(segments)])
    colours = np.ones((len(wedge), 4), np.float32)
    colours[:, :3] = palette[wedge % (len(segments.names) + 1)]
    primitive = (Primitive(material, ("COLOR_0",)),)
    corners: I32 = wedges.reshape(-1, 3).astype(np.int32)
    return Mesh(soup.positions, soup.faces, corners, {"COLOR_0": colours}, primitives=primitive, name="segments")


def _tubes(skeleton: Skeleton, diagonal: float) -> Parts:
    parts: Parts = []
    ball, ball_faces = _ball()
    for place, kind in zip(skeleton.positions, skeleton.node_type, strict=True):
        name = NODE_TYPES[kind]
        parts.append((place + ball * BALL[name] * diagonal, ball_faces, NODE_COLOURS[name]))
    for a, b in skeleton.edges:
        start, end = skeleton.positions[a], skeleton.positions[b]
        if np.array_equal(start, end):
            continue
        along = (end - start) / np.linalg.norm(end - start)
        side = np.cross(along, np.eye(3)[np.abs(along).argmin()])
        side /= np.linalg.norm(side)
        angle = np.arange(SIDES) * 2 * np.pi / SIDES
        ring = (np.outer(np.cos(angle), side) + np.outer(np.sin(angle), np.cross(along, side))) * TUBE * diagonal
        i = np.arange(SIDES)
        j = (i + 1) % SIDES
        faces = np.concatenate([np.stack([i, j, j + SIDES], axis=1), np.stack([i, j + SIDES, i + SIDES], axis=1)])
        parts.append((np.concatenate([start + ring, end + ring]), faces.astype(np.int32), TUBE_COLOUR))
    return parts


def _ball() -> tuple[F64, I32]:
    """An icosahedron on the unit sphere."""
    g = (1 + 5**0.5) / 2
    points = np.array([[s, t * g, 0] for s in (-1, 1) for t in (-1, 1)], float)
    points = np.concatenate([points, points[:, [2, 0, 1]], points[:, [1, 2, 0]]])
    far = np.linalg.norm(points[:, None] - points[None], axis=2)
    near = (far > 0) & (far < 2.1)
    faces = []
    for a in range(12):
        for b in range(a + 1, 12):
            for c in range(b + 1, 12):
                if near[a, b] and near[b, c] and near[a, c]:
                    out = np.linalg.det(points[[a, b, c]]) > 0
                    faces.append([a, b, c] if out else [a, c, b])
    return points / np.linalg.norm(points[0]), np.array(faces, np.int32)


def _coloured(name: str, parts: Parts) -> Mesh:
    start = np.cumsum([0] + [len(points) for points, _, _ in parts])
    faces = np.concatenate([faces + s for (_, faces, _), s in zip(parts, start, strict=False)]).astype(np.int32)
    colours = np.concatenate([np.tile([*colour, 1.0], (len(points), 1)) for points, _, colour in parts])
    points = np.concatenate([points for points, _, _ in parts])
    return Mesh(
        points,
        faces,
        attributes={"COLOR_0": colours.astype(np.float32)},
        primitives=(Primitive(0, ("COLOR_0",)),),
        name=name,
    )


def _material(name: str, opacity: float) -> Material:
    gltf = {
        "name": name,
        "doubleSided": True,
        "pbrMetallicRoughness": {
            "baseColorFactor": [1.0, 1.0, 1.0, opacity],
            "metallicFactor": 0,
            "roughnessFactor": 0.9,
        },
    }
    return Material(gltf | {"alphaMode": "BLEND"} if opacity < 1 else gltf)
