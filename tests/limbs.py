"""Meshes of known limbs: unions of capsules, as `Mesh`."""

from __future__ import annotations

import numpy as np

from lodpipe.core.asset import Asset
from lodpipe.core.mesh import Mesh
from sample_assets.implicit import capsule, polygonise, union


def blob(fields, low, high, step=0.06, blend=0.08):
    """The union of distance fields as a closed mesh, on a grid of cells of size `step`."""
    planes = [np.arange(a - 2 * step, b + 3 * step, step) for a, b in zip(low, high, strict=True)]
    return Mesh(*polygonise(union(fields, blend), planes))


def star(arms, radius=0.14, hub=0.0):
    """`arms` arms of length 1 from one place, spread over the sphere, about a ball of radius `hub`."""
    reach = (1 + max(radius, hub),) * 3
    return blob(star_fields(arms, radius, hub), -np.array(reach), reach)


def star_fields(arms, radius=0.14, hub=0.0, turn=0.3):
    i = np.arange(arms) + 0.5
    z = 1 - 2 * i / arms if arms > 2 else np.zeros(arms)
    angle = np.pi * (1 + 5**0.5) * i + turn if arms > 2 else np.arange(arms) * 2.4 + turn
    ends = np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], axis=1)
    fields = [capsule((0, 0, 0), end, radius) for end in ends]
    if hub:
        fields.append(capsule((0, 0, 0), (1e-3, 0, 0), hub))
    return fields


def tree(seed):
    """A random tree of capsules whose limbs stay apart and part at 100° or more, and the number of its ends."""
    rng = np.random.default_rng(seed)
    points, parent = [np.zeros(3)], [-1]
    for _ in range(200):
        if len(points) > int(rng.integers(4, 8)):
            break
        start = int(rng.integers(len(points)))
        step = rng.normal(size=3)
        end = points[start] + step / np.linalg.norm(step) * rng.uniform(0.9, 1.3)
        limbs = [(points[p], points[n], p, n) for n, p in enumerate(parent) if p >= 0]
        apart = all(
            _between(points[start], end, a, b) > 0.5 if start not in (p, n) else _turn(points[start], end, a, b) > 100
            for a, b, p, n in limbs
        )
        if apart:
            points.append(end)
            parent.append(start)
    degree = np.bincount([*parent[1:], *range(1, len(points))], minlength=len(points))
    fields = [capsule(points[p], points[n], 0.13) for n, p in enumerate(parent) if p >= 0]
    places = np.array(points)
    mesh = blob(fields, places.min(axis=0) - 0.2, places.max(axis=0) + 0.2, step=0.07)
    return mesh, int((degree == 1).sum())


def asset(*meshes):
    return Asset("limbs", meshes)


def _between(a, b, c, d):
    t = np.linspace(0, 1, 12)[:, None]
    return np.linalg.norm((a + t * (b - a))[:, None] - (c + t * (d - c))[None], axis=2).min()


def _turn(start, end, a, b):
    """Degrees between two limbs that share `start`."""
    other = b if np.allclose(a, start) else a
    u, v = end - start, other - start
    return np.degrees(np.arccos(np.clip(u @ v / np.linalg.norm(u) / np.linalg.norm(v), -1, 1)))
