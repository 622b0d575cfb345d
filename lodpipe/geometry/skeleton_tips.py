"""Tips: where limbs end, whatever finds their skeleton.

The mean distance along the surface to all of it has a peak at the end of every limb (Hilaga et al. 2001). Which peaks
are tips is told by how far each rises above the pass to a higher one (its persistence, Edelsbrunner et al. 2002), and
by how far it sticks out of the ball in the middle of what it hangs on: noise, elbows, corners and bellies have peaks.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lodpipe.core.mesh import F64
from lodpipe.geometry.skeleton_net import Net
from lodpipe.geometry.skeleton_rays import Rays
from lodpipe.geometry.skeleton_surface import I64, Surface

LEAST_RISE = 0.3
"""A tip rises by at least this share of a branch's least length."""
PRONG = 1.8
"""A tip is at least so many radii from the middle of what it hangs on: the corner of a cube is at √3, the outside of
an elbow that turns back by 135° at 1.7."""
BASE, STARTS, ALIKE = 0.3, 8, 0.9
"""The ball is looked for from STARTS vertices of the lowest BASE of the limb: the nearest of those about as large as
the largest."""
REACHED = 1.5
"""An end whose ball's centre is farther from the tip than so many radii gets nodes towards it."""
BANDS = 48
"""Nodes that a limb as long as the field's whole range would get."""


@dataclass(frozen=True, eq=False)
class Tip:
    """The end of a limb: its vertex, the limb's vertices, and how far it rises above the rest."""

    vertex: int
    region: I64
    rise: float


def peaks(surface: Surface, field: F64, least: F64) -> list[Tip]:
    """The maxima of `field` that rise by `least` (C,) or more, highest rise first; a component's highest has no pass.

    Exact persistence: every vertex belongs to the maximum to which steepest ascent leads; basins are merged across
    their highest passes, the lower of two maxima into the higher.
    """
    count = len(field)
    a, b = surface.edges.T
    low, high = np.where(field[a] < field[b], a, b), np.where(field[a] < field[b], b, a)
    order = np.lexsort((field[high], low))
    last = order[np.flatnonzero(np.diff(low[order], append=-1))]
    up = np.arange(count)
    up[low[last]] = high[last]
    while not np.array_equal(further := up[up], up):
        up = further
    ends = np.sort(np.stack([up[a], up[b]], axis=1), axis=1)
    across = ends[:, 0] != ends[:, 1]
    ends, height = ends[across], np.minimum(field[a], field[b])[across]
    key = ends[:, 0].astype(np.int64) * count + ends[:, 1]
    order = np.lexsort((height, key))
    passes = order[np.flatnonzero(np.diff(key[order], append=-1))]
    passes = passes[np.argsort(-height[passes], kind="stable")]
    parent = {int(top): int(top) for top in np.unique(up)}
    members = {top: [top] for top in parent}
    limb: dict[int, Tip] = {}

    def root(top: int) -> int:
        while parent[top] != top:
            parent[top] = parent[parent[top]]
            top = parent[top]
        return top

    def keep(top: int, at: float) -> None:
        """A limb ends at the first pass that counts; its rise is that above the pass across which it is merged."""
        known = limb.get(top)
        region = known.region if known else np.flatnonzero(np.isin(up, members[top]) & (field >= at))
        limb[top] = Tip(top, region, float(field[top]) - at)

    for row in passes.tolist():
        one, other, at = root(int(ends[row, 0])), root(int(ends[row, 1])), float(height[row])
        if one == other:
            continue
        if (field[one], -one) > (field[other], -other):
            one, other = other, one
        if float(field[one]) - at >= least[surface.component[one]]:
            keep(one, at)
            keep(other, at)
        parent[one] = other
        members[other] += members[one]
    return sorted(limb.values(), key=lambda tip: (-tip.rise, tip.vertex))


def tips(surface: Surface, rays: Rays, field: F64, least: F64) -> list[Tip]:
    """Those of the peaks that are ends of limbs; `least` (C,) the least length of a branch."""
    candidates = peaks(surface, field, LEAST_RISE * least)
    if not candidates:
        return []
    out = _outsticking(surface, rays, field, candidates)
    rise = np.array([tip.rise for tip in candidates])
    wanted = least[surface.component[[tip.vertex for tip in candidates]]]
    return [candidates[n] for n in np.flatnonzero((out >= PRONG) & (rise * out >= wanted))]


def _outsticking(surface: Surface, rays: Rays, field: F64, candidates: Sequence[Tip]) -> F64:
    """How many radii each peak is away from the middle of what it hangs on."""
    starts, owner = [], []
    for number, tip in enumerate(candidates):
        value = field[tip.region]
        base = tip.region[value <= value.min() + BASE * tip.rise]
        rows = base[np.linspace(0, len(base) - 1, min(STARTS, len(base))).astype(int)]
        starts.append(rows)
        owner.append(np.full(len(rows), number))
    vertex, tip_of = np.concatenate(starts), np.concatenate(owner)
    component = surface.component[vertex]
    inward = -surface.normals(vertex)
    place = surface.points[vertex] + 1e-4 * inward
    depth = rays.walls(place, inward[:, None], component)[:, 0]
    place = place + np.where(np.isfinite(depth), depth, 0.0)[:, None] / 2 * inward
    centre, radius = rays.centred(place, np.zeros_like(place), component, np.zeros(len(place), bool))
    peak = np.array([tip.vertex for tip in candidates])
    largest = np.zeros(len(candidates))
    np.maximum.at(largest, tip_of, radius)
    away = np.linalg.norm(surface.points[peak[tip_of]] - centre, axis=1)
    away[radius < ALIKE * largest[tip_of]] = np.inf
    order = np.lexsort((-away, tip_of))
    best = order[np.flatnonzero(np.diff(tip_of[order], append=-1))]
    rise = np.array([field[tip.vertex] - field[tip.region].min() for tip in candidates])
    return np.asarray(np.maximum(away[best], rise) / np.maximum(radius[best], 1e-9))


def settle(surface: Surface, net: Net, vertex: np.ndarray, field: F64, found: Sequence[Tip]) -> np.ndarray:
    """Make the ends of `net` those limbs that end in tips; each vertex's node (V,) afterwards.

    An end in whose branch no tip lies goes, one branch after another; a tip without an end gets a branch of nodes along
    its limb, on the node at the limb's foot. A tree that is added has no loops, and every vertex keeps one node: Pao
    2003, 2.1.3, corrects by further sources and asks that their levels do not overlap.
    """
    vertex = vertex.copy()
    ends = _ends(net, net.owners()[vertex], found)
    _drop(net, vertex, [tip for tip, end in zip(found, ends, strict=True) if end >= 0])
    span = np.zeros(surface.component_count)
    np.maximum.at(span, surface.component, np.where(np.isfinite(field), field, 0.0))
    for tip, end in zip(found, ends, strict=True):
        rows, value = tip.region, field[tip.region]
        low, top = float(value.min()), float(field[tip.vertex])
        host = end
        if end < 0:
            owner = net.owners()[vertex[rows]]
            host = int(np.bincount(owner[value <= low + 0.1 * (top - low)]).argmax())
            number = BANDS * (top - low) / max(span[net.component[host]], 1e-12)
        else:
            away = float(np.linalg.norm(surface.points[tip.vertex] - net.place[end]))
            number = away / net.radius[end] / 2 if away > REACHED * net.radius[end] > 0 else 0.0
            rows = np.flatnonzero(net.owners()[vertex] == end)
            low = float(np.median(field[rows])) if len(rows) else top
            rows = rows[field[rows] > low]
        if number > 0 and len(rows):
            host = _grown(surface, net, vertex, field, rows, low, host, int(np.clip(np.ceil(number), 1, BANDS)))
        net.kept.add(host)
    return vertex


def _grown(
    surface: Surface, net: Net, vertex: np.ndarray, field: F64, rows: I64, low: float, host: int, number: int
) -> int:
    """A chain of `number` nodes on `host` along `rows`, vertices above `low`, which become theirs; the last node."""
    step = (float(field[rows].max()) - low) / number
    band = np.minimum(((field[rows] - low) / max(step, 1e-12)).astype(int), number - 1)
    foot, component = net.height[host], net.component[host]
    for k in np.unique(band):
        mine = rows[band == k]
        new = net.add(surface.points[mine].mean(axis=0), foot + (float(k) + 0.5) * step, component, step / 2)
        net.link(host, new)
        vertex[mine] = new
        host = new
    return host


def _branches(net: Net) -> list[list[int]]:
    """The paths from the ends to what they hang on, without that; of a path between two ends a half for each."""
    paths = []
    for leaf in net.alive:
        if len(net.near[leaf]) == 1:
            path = net.path(leaf, next(iter(net.near[leaf])))
            paths.append(path[: (len(path) + 1) // 2] if len(net.near[path[-1]]) == 1 else path[:-1])
    return paths


def _ends(net: Net, owner: np.ndarray, found: Sequence[Tip]) -> list[int]:
    """For each tip its end, −1 if it has none: an end whose domain is mostly the tip's limb, one tip for each."""
    place = {n: path for path in _branches(net) for n in path}
    size = np.bincount(owner, minlength=len(net.into))
    ends: list[int] = []
    for tip in found:
        path = place.get(int(owner[tip.vertex]))
        end = path[0] if path else -1
        mostly = end >= 0 and 2 * int((owner[tip.region] == end).sum()) > int(size[end])
        ends.append(end if mostly and end not in ends else -1)
    return ends


def _drop(net: Net, vertex: np.ndarray, own: Sequence[Tip]) -> None:
    """Merge branches without tips into the joints that they hang on."""
    again = True
    while again:
        again = False
        real = set(net.owners()[vertex[[tip.vertex for tip in own]]].tolist())
        for leaf in net.alive:
            if len(net.near[leaf]) != 1:
                continue
            path = net.path(leaf, next(iter(net.near[leaf])))
            if len(net.near[path[-1]]) < 3 or not real.isdisjoint(path[:-1]):
                continue
            for gone, stays in itertools.pairwise(path):
                net.unlink(gone, stays)
                net.into[gone] = path[-1]
            again = True
