"""Questions about the inside of a surface, answered by rays: is a point inside, where is the middle."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from lodpipe.core.mesh import F64, I32
from lodpipe.geometry.camera import views
from lodpipe.geometry.skeleton_surface import I64, Bool, Surface

if TYPE_CHECKING:
    from lodpipe.o3d import RayScene

SPOKES = 12
"""Pairs of opposite rays round a point in a plane."""
REACH = 3.0
"""A wall farther away than so many times the median counts as so far: it is seen along a limb or through a gap."""
ROUNDS = 5
STRANGE = 0.05
"""Walls of other nodes count as so much farther away, in diagonals."""
GENERIC = np.array(
    [[0.5370861, 0.7294322, 0.4236291], [-0.8317211, 0.3321412, 0.4449311], [0.1411231, -0.4612312, 0.8759932]]
)
"""Directions that no modeller aligns anything with."""


class Rays:
    """Rays against the surface; each point asks about the walls of its own component only."""

    def __init__(self, surface: Surface, threads: int = 0) -> None:
        self.surface, self.threads = surface, threads

    @cached_property
    def _scene(self) -> RayScene:
        from lodpipe.o3d import RayScene  # takes more than a second to load

        return RayScene(self.surface.points.astype(np.float32), self.surface.faces, self.threads)

    @cached_property
    def _owner(self) -> I32:
        return self.surface.component[self.surface.faces[:, 0]]

    def walls(self, points: F64, directions: F64, component: I32) -> F64:
        """(N, K) distance to the first wall from each of N points along each of (N, K, 3) unit directions, or inf."""
        origins = np.repeat(points, directions.shape[1], axis=0).astype(np.float32)
        along = directions.reshape(-1, 3).astype(np.float32)
        first = self._scene.cast(origins, along)
        nearest = first.distance.astype(np.float64)
        owner = component[np.arange(len(origins)) // directions.shape[1]]
        strange = np.flatnonzero((first.faces >= 0) & (self._owner[first.faces] != owner))
        if len(strange):  # another component's wall is in the way
            nearest[strange] = np.inf
            found = self._scene.crossings(origins[strange], along[strange])
            rays = strange[found.rays]
            own = self._owner[found.faces] == owner[rays]
            np.minimum.at(nearest, rays[own], found.distance[own])
        return nearest.reshape(len(points), -1)

    def inside(self, points: F64, component: I32) -> Bool:
        """(N,) whether each point is inside its component: an odd number of walls, by most of three directions."""
        count, votes = len(points), np.zeros(len(points), np.int64)
        for direction in GENERIC:
            rays = np.broadcast_to(direction, (count, 3)).astype(np.float32)
            found = self._scene.crossings(points.astype(np.float32), rays)
            own = self._owner[found.faces] == component[found.rays]
            votes += np.bincount(found.rays[own], minlength=count) % 2
        return np.asarray(votes >= 2)

    def centred(self, points: F64, tangents: F64, component: I32, fixed: Bool) -> tuple[F64, F64]:
        """Points moved to the middle of the walls round them, and how far the nearest of these walls is then.

        tangents  (N, 3): the walls are those seen across this direction; zero: those seen all round (at joints)

        Opposite rays tell how far a point is off between two walls. Of all steps the place with the farthest nearest
        wall is taken, so nothing gets worse. Where no wall is seen on some side the point stays, with what is seen;
        so do points that are `fixed` (N,).
        """
        place, best = points.copy(), points.copy()
        radius = np.full(len(points), -1.0)
        flat = np.einsum("ij,ij->i", tangents, tangents) > 0
        for chosen, directions, factor in self._spokes(tangents, flat):
            here = place[chosen]
            for _ in range(ROUNDS + 1):
                far = self.walls(here, directions, component[chosen])
                seen = np.isfinite(far)
                nearest = np.where(seen.any(axis=1), far.min(axis=1), 0.0)
                ok = seen.mean(axis=1) > 0.7
                better = nearest > radius[chosen]
                better &= (ok & ~fixed[chosen]) | (radius[chosen] < 0)
                rows = chosen[better]
                best[rows], radius[rows] = here[better], nearest[better]
                typical = np.median(np.where(seen, far, np.inf), axis=1)
                limit = np.where(np.isfinite(typical), typical, 0.0)[:, None] * REACH
                near = np.minimum(far, limit)
                half = near.shape[1] // 2
                off = (near[:, :half] - near[:, half:]) / 2
                shift = np.einsum("nk,nkd->nd", off, directions[:, :half]) / half * factor
                here = np.where(ok[:, None], here + 0.8 * shift, here)
        return best, np.maximum(radius, 0.0)

    def _spokes(self, tangents: F64, flat: Bool) -> list[tuple[I64, F64, float]]:
        """(rows, (N, K, 3) directions, the second half opposite to the first, dimensions) for both kinds."""
        kinds = []
        rows = np.flatnonzero(flat)
        if len(rows):
            t = tangents[rows] / np.linalg.norm(tangents[rows], axis=1, keepdims=True)
            helper = np.eye(3)[np.abs(t).argmin(axis=1)]
            u = np.cross(t, helper)
            u /= np.linalg.norm(u, axis=1, keepdims=True)
            w = np.cross(t, u)
            angle = np.arange(SPOKES) * np.pi / SPOKES
            half = np.cos(angle)[None, :, None] * u[:, None] + np.sin(angle)[None, :, None] * w[:, None]
            kinds.append((rows, np.concatenate([half, -half], axis=1), 2.0))
        rows = np.flatnonzero(~flat)
        if len(rows):
            half = np.broadcast_to(views(4 * SPOKES)[: 2 * SPOKES], (len(rows), 2 * SPOKES, 3))
            kinds.append((rows, np.concatenate([half, -half], axis=1), 3.0))
        return kinds

    def moved_in(self, points: F64, component: I32, wanted: list[set[int]], node: I32) -> F64:
        """Points that lie outside, moved into the nearest part of the surface, best one of their nodes'.

        wanted  for each point the nodes whose domain the wall must be of; node (V,) int32 each vertex's node

        A ray that enters through a wall and leaves again has the inside between the two: its middle is taken.
        """
        count = len(points)
        directions = views(8 * SPOKES)
        origins = np.repeat(points, len(directions), axis=0).astype(np.float32)
        found = self._scene.crossings(origins, np.tile(directions, (count, 1)).astype(np.float32))
        own = np.flatnonzero(self._owner[found.faces] == component[found.rays // len(directions)])
        order = own[np.lexsort((found.distance[own], found.rays[own]))]
        rays, distance, faces = found.rays[order], found.distance[order], found.faces[order]
        out = points.copy()
        nearest = np.full(count, np.inf)
        first = np.flatnonzero(np.diff(rays, prepend=-1))
        for i in first:
            if i + 1 >= len(rays) or rays[i + 1] != rays[i]:
                continue
            point = int(rays[i]) // len(directions)
            strange = wanted[point].isdisjoint(node[self.surface.faces[faces[i]]].tolist())
            away = distance[i] + (STRANGE if strange else 0.0)
            if away < nearest[point]:
                nearest[point] = away
                out[point] = points[point] + directions[rays[i] % len(directions)] * (distance[i] + distance[i + 1]) / 2
        return out
