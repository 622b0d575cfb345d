"""Tiny rigged models: tubes along x with two joints, as assets and as files."""

from __future__ import annotations

from typing import Any

import numpy as np

from lodpipe.core.asset import Accessor, Asset
from lodpipe.core.mesh import Mesh, Primitive


def tube(length: int = 48, around: int = 12, radius: float = 0.5, y: float = 0.0):
    """A closed tube from x = 0 to 8: rings of `around` vertices and two lids."""
    turn = np.arange(around) * 2 * np.pi / around
    x = np.repeat(np.linspace(0, 8, length + 1), around)
    points = np.stack(
        [x, y + radius * np.tile(np.cos(turn), length + 1), radius * np.tile(np.sin(turn), length + 1)], 1
    )
    ring, step = np.divmod(np.arange(length * around), around)
    a, b = ring * around + step, ring * around + (step + 1) % around
    faces = np.concatenate([np.stack([a, b, b + around], 1), np.stack([a, b + around, a + around], 1)])
    fan = np.arange(1, around - 1)
    last = length * around
    lids = [np.stack([0 * fan, fan + 1, fan], 1), np.stack([0 * fan, fan, fan + 1], 1) + last]
    return points, np.concatenate([faces, *lids]).astype(np.int32)


def ramp(x: Any) -> Any:
    """What the second joint weighs: nothing up to x = 3.5, everything from 4.5."""
    return np.clip(np.asarray(x) - 3.5, 0, 1)


def skinned(points: Any, faces: Any, weights: Any, joints: Any = (0, 1), **attributes: Any) -> Mesh:
    """A mesh whose vertices follow `joints` by 1 − weight and weight."""
    columns = {
        "JOINTS_0": np.tile(np.array([*joints, 0, 0], np.float32), (len(points), 1)),
        "WEIGHTS_0": np.stack([1 - weights, weights, 0 * weights, 0 * weights], 1).astype(np.float32),
        **attributes,
    }
    return Mesh(points, faces, attributes=columns, primitives=(Primitive(None, tuple(columns)),), name="arm")


def rigged(mesh: Mesh, turns: Any = ((0, 0, 0, 1), (0, 0, 0.5**0.5, 0.5**0.5))) -> Asset:
    """`mesh` on a shoulder at x = 0 and an elbow at x = 4, which an animation of a second turns by `turns`."""
    inverse = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))
    inverse[1, 3, 0] = -4  # column by column
    times = np.linspace(0, 1, len(turns)).astype(np.float32)[:, None]
    document = {
        "nodes": [{"mesh": 0, "skin": 0}, {"children": [2]}, {"translation": [4, 0, 0]}],
        "scenes": [{"nodes": [0, 1]}],
        "scene": 0,
        "skins": [{"joints": [1, 2], "inverseBindMatrices": 0}],
        "animations": [
            {
                "samplers": [{"input": 1, "output": 2}],
                "channels": [{"sampler": 0, "target": {"node": 2, "path": "rotation"}}],
            }
        ],
    }
    accessors = (
        Accessor(inverse.reshape(2, 16), "MAT4"),
        Accessor(times, "SCALAR"),
        Accessor(np.array(turns, np.float32), "VEC4"),
    )
    return Asset("arm", (mesh,), document=document, accessors=accessors)


def bent(mesh: Mesh, angle: float = np.pi / 2) -> Mesh:
    """The mesh with its elbow turned by an angle about z."""
    corner = np.zeros(len(mesh.positions), int)
    corner[mesh.faces] = mesh.wedges
    weight = (mesh.attributes["WEIGHTS_0"] * (mesh.attributes["JOINTS_0"] == 1)).sum(axis=1)[corner, None]
    x, y, z = mesh.positions.T
    c, s = np.cos(angle), np.sin(angle)
    turned = np.stack([4 + c * (x - 4) - s * y, s * (x - 4) + c * y, z], 1)
    return Mesh((1 - weight) * mesh.positions + weight * turned, mesh.faces)
