"""Ambient occlusion: how much of the sky over a surface its own shape leaves open."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lodpipe.core.asset import Asset
from lodpipe.core.mesh import F32, F64
from lodpipe.geometry.flatten import flatten
from lodpipe.geometry.normals import unit

if TYPE_CHECKING:
    from lodpipe.o3d import RayScene

FAR = 0.2
"""What is farther away than this share of the bounding box's diagonal darkens nothing: rooms are not black inside."""
LIFT = 1e-4
"""Rays begin so far above the surface, in diagonals."""
BATCH = 1 << 20
"""Rays followed at once."""


class Occlusion:
    """The sky over the surface of an asset, all its meshes in their places."""

    def __init__(self, asset: Asset, rays: int = 16, threads: int = 0) -> None:
        from lodpipe.o3d import RayScene

        soup = flatten(asset)
        self._size = soup.diagonal or 1.0
        self._centre = (soup.positions.min(axis=0) + soup.positions.max(axis=0)) / 2
        positions = ((soup.positions - self._centre) / self._size).astype(np.float32)
        self._scene: RayScene = RayScene(positions, soup.faces, threads)
        self._places: dict[int, F64] = {}
        for number, matrix in asset.instances():
            self._places.setdefault(number, matrix)
        # stratified over the disc; on the hemisphere above it that is by the cosine (Malley's method)
        row = np.arange(rays)
        self._radius = np.sqrt((row + 0.5) / rays)
        self._angle = row * (np.pi * (3 - np.sqrt(5)))

    def at(self, number: int, points: F64, normals: F64) -> F32:
        """(N,) 0…1, 1 where nothing is in the way: over `points` (N, 3) of mesh `number`, in its own space, with unit
        `normals` (N, 3). A mesh that is placed several times has the sky of its first place."""
        matrix = self._places.get(number, np.eye(4))
        start = points @ matrix[:3, :3].T + matrix[:3, 3]
        up = unit(normals @ np.linalg.pinv(matrix[:3, :3]))
        start = (start - self._centre) / self._size + up * LIFT
        helper = np.where(np.abs(up[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
        along = unit(np.cross(up, helper))
        across = np.cross(up, along)
        turn = 2 * np.pi * _noise(start)
        result = np.empty(len(points), np.float32)
        step = max(1, BATCH // len(self._radius))
        for first in range(0, len(points), step):
            some = slice(first, first + step)
            angle = self._angle + turn[some, None]
            x, y = self._radius * np.cos(angle), self._radius * np.sin(angle)
            z = np.sqrt(np.maximum(1 - self._radius**2, 0.0))
            rays = along[some, None] * x[..., None] + across[some, None] * y[..., None]
            rays += up[some, None] * np.broadcast_to(z, x.shape)[..., None]
            origins = np.broadcast_to(start[some, None], rays.shape).reshape(-1, 3)
            hits = self._scene.cast(origins.astype(np.float32), rays.reshape(-1, 3).astype(np.float32))
            open_ = (hits.faces < 0) | (hits.distance > FAR)
            result[some] = open_.reshape(x.shape).mean(axis=1)
        return result


def _noise(points: F64) -> F64:
    """(N,) 0…1, the same for the same place, far apart for neighbours (as Jimenez 2014 turns samples from pixel to
    pixel, "Next generation post processing in Call of Duty", here in space)."""
    phase = (points * 8192.0) @ np.array([0.06711056, 0.00583715, 0.03729231])
    noise: F64 = np.mod(52.9829189 * np.mod(phase, 1.0), 1.0)
    return noise
