"""Skeletons of domain balls: points pushed into the middle by a repulsive force, merged, connected along the surface.

After the domain connected graph of Wu, Ma, Liou, Liang & Ouhyoung (The Visual Computer 2005), of which only the
abstract and another report's account could be read; the force is that of their paper of 2003. Ours differs in that
domains are connected by a spanning tree of their contacts, with as many loops as the surface has handles, and in that
tips of the mean distance which no ball reaches become ends.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lodpipe import kernel
from lodpipe.core.mesh import F64, I32
from lodpipe.geometry.camera import views
from lodpipe.geometry.skeleton_net import Net
from lodpipe.geometry.skeleton_rays import Rays
from lodpipe.geometry.skeleton_surface import I64, Surface

SEEDS = 600
DIRECTIONS = 96
ROUNDS = 24
SEEN = 0.95
"""A seed that fewer of its rays have walls for lies outside, or at a hole."""
PROXY = 5000
"""Triangles on which larger surfaces are worked on."""
STEP, LEAST_STEP = 0.4, 0.02
"""A step's length, in distances to the nearest wall: at first, and that at which a seed has come to rest."""


def proxy(surface: Surface) -> tuple[Surface, I32]:
    """A surface of the same components and handles with few triangles, and the row in it for each vertex."""
    same = np.arange(len(surface.points), dtype=np.int32)
    if len(surface.faces) <= 1.2 * PROXY:
        return surface, same
    options = kernel.QuadricOptions(keep_topology=True, may_relax=False, keep_last=True, follow=True)
    (level,) = kernel.decimate(surface.points, surface.faces, [PROXY], options).levels
    small = replace(surface, points=level.positions, faces=level.faces, vertex=(), holes=())
    if small.component_count != surface.component_count or small.genus != surface.genus:
        return surface, same
    from scipy.spatial import cKDTree

    row = level.vertex_to.copy()
    lost = np.flatnonzero(row < 0)
    row[lost] = cKDTree(level.positions).query(surface.points[lost])[1]
    return small, row


def domain_net(surface: Surface, rays: Rays, height: F64) -> tuple[Net, I32]:
    """Balls and their links, and each vertex's ball. `height` (V,): a distance along the surface, to order nodes by."""
    seeds = _seeds(surface)
    place, radius, ok = _at_rest(surface, rays, seeds)
    component = surface.component
    held = np.zeros(surface.component_count, bool)
    held[component[seeds[ok]]] = True
    for c in np.flatnonzero(~held):  # flat, or nothing but holes: its middle has to do
        mine = np.flatnonzero(component[seeds] == c)
        place[mine[0]], radius[mine[0]], ok[mine[0]] = surface.points[component == c].mean(axis=0), 0.0, True
    seeds, place, radius = seeds[ok], place[ok], radius[ok]
    ball = _merged(place, radius, component[seeds])
    kept, ball = np.unique(ball, return_inverse=True)
    net = Net()
    vertex = ball[_nearest(surface, seeds)].astype(np.int32)
    heights = np.bincount(vertex, height, len(kept)) / np.maximum(np.bincount(vertex, minlength=len(kept)), 1)
    for n, row in enumerate(kept):
        net.add(place[row], float(heights[n]), int(component[seeds[row]]), radius=float(radius[row]))
    for a, b in _links(surface, vertex, place[kept]):
        net.link(a, b)
    return net, vertex


def _seeds(surface: Surface) -> I64:
    """About SEEDS vertices spread by area, at least one for each component."""
    corner = surface.points[surface.faces]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) + 1e-15
    at = (np.arange(SEEDS) + 0.5) / SEEDS
    face = np.minimum(np.searchsorted(np.cumsum(area) / area.sum(), at), len(area) - 1)
    _, first = np.unique(surface.component, return_index=True)
    return np.unique(np.concatenate([surface.faces[face, np.arange(SEEDS) % 3], first]).astype(np.int64))


def _at_rest(surface: Surface, rays: Rays, seeds: I64) -> tuple[F64, F64, NDArray[np.bool_]]:
    """Where the seeds come to rest, the distance to the nearest wall there, and which of them are inside.

    At x the force is F = Σ (x − v) / |x − v|² over the walls v that rays from x meet. A seed goes along F for as long
    as |F| falls; where a step makes it grow, the step is halved.
    """
    component = surface.component[seeds]
    inward = -surface.normals(seeds)
    place = surface.points[seeds] + 1e-4 * inward
    depth = rays.walls(place, inward[:, None], component)[:, 0]
    place = (
        surface.points[seeds] + np.clip(0.3 * np.where(np.isfinite(depth), depth, 0.0), 1e-4, 0.01)[:, None] * inward
    )
    directions = np.broadcast_to(views(DIRECTIONS), (len(seeds), DIRECTIONS, 3))

    def force(at: F64, rows: I64) -> tuple[F64, F64, F64]:
        far = rays.walls(at, directions[: len(at)], component[rows])
        seen = np.isfinite(far)
        near = np.maximum(np.where(seen, far, np.inf), 1e-9)
        return -np.einsum("nk,kd->nd", 1 / near, directions[0]), near.min(axis=1), seen.mean(axis=1)

    rows = np.arange(len(seeds))
    pull, radius, seen = force(place, rows)
    ok = seen >= SEEN
    step = np.full(len(seeds), STEP)
    moving = rows[ok]
    for _ in range(ROUNDS):
        if not len(moving):
            break
        size = np.linalg.norm(pull[moving], axis=1)
        length = step[moving] * radius[moving] / np.maximum(size, 1e-12)
        further = place[moving] + length[:, None] * pull[moving]
        new, near, seen = force(further, moving)
        better = (np.linalg.norm(new, axis=1) < size) & (seen >= SEEN)
        gone = moving[better]
        place[gone], pull[gone], radius[gone] = further[better], new[better], near[better]
        step[moving[~better]] /= 2
        moving = moving[step[moving] > LEAST_STEP]
    return place, radius, ok


def _merged(place: F64, radius: F64, component: I32) -> I64:
    """For each ball the one that it becomes part of: the largest first, it takes all whose centre lies in it."""
    owner = np.full(len(place), -1)
    for n in np.lexsort((np.arange(len(place)), -radius)):
        if owner[n] < 0:
            free = np.flatnonzero((owner < 0) & (component == component[n]))
            owner[free[np.linalg.norm(place[free] - place[n], axis=1) <= radius[n]]] = n
            owner[n] = n
    return owner


def _nearest(surface: Surface, seeds: I64) -> I64:
    """(V,) for each vertex the row of the nearest seed along edges."""
    from scipy.sparse.csgraph import dijkstra

    source = dijkstra(surface.graph, indices=seeds, min_only=True, return_predecessors=True)[2]
    row = np.zeros(len(surface.points), np.int64)
    row[seeds] = np.arange(len(seeds))
    return np.asarray(row[source])


def _links(surface: Surface, vertex: I32, place: F64) -> list[tuple[int, int]]:
    """A spanning tree of the strongest contacts, and for each handle the contact that closes the longest way round."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components, dijkstra, minimum_spanning_tree

    count = len(place)
    ends = np.sort(vertex[surface.edges], axis=1)
    ends = ends[ends[:, 0] != ends[:, 1]]
    pairs, strength = np.unique(ends, axis=0, return_counts=True)
    if not len(pairs):
        return []
    cost = 1.0 / strength + 1e-9 * np.arange(len(pairs)) / len(pairs)
    tree = minimum_spanning_tree(coo_array((cost, pairs.T), shape=(count, count)))
    chosen = {(int(min(a, b)), int(max(a, b))) for a, b in zip(*tree.nonzero(), strict=True)}
    part = connected_components(coo_array((cost, pairs.T), shape=(count, count)), directed=False)[1]
    owner = np.zeros(count, np.int64)
    owner[vertex] = surface.component
    handles = [genus or 0 for genus in surface.genus]
    length = np.linalg.norm(place[pairs[:, 0]] - place[pairs[:, 1]], axis=1) + 1e-9
    for p in np.unique(part[pairs[:, 0]]):
        mine = np.flatnonzero(part[pairs[:, 0]] == p)
        for _ in range(handles[owner[pairs[mine[0], 0]]]):
            rows = [i for i in mine if (int(pairs[i, 0]), int(pairs[i, 1])) in chosen]
            rest = [i for i in mine if (int(pairs[i, 0]), int(pairs[i, 1])) not in chosen]
            if not rest:
                break
            graph = coo_array((length[rows], pairs[rows].T), shape=(count, count))
            way = dijkstra(graph.tocsr(), directed=False, indices=np.unique(pairs[rest, 0]))
            start = np.searchsorted(np.unique(pairs[rest, 0]), pairs[rest, 0])
            longest = rest[int(np.argmax(way[start, pairs[rest, 1]] + 1e-6 * strength[rest] / strength.max()))]
            chosen.add((int(pairs[longest, 0]), int(pairs[longest, 1])))
    return sorted(chosen)
