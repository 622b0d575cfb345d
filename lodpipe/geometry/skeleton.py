"""Curve skeletons of assets: the methods, and the one result that they all give."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from lodpipe.core.asset import Asset
from lodpipe.core.errors import InvalidMesh
from lodpipe.core.mesh import F64, I32
from lodpipe.core.skeleton import NODE_TYPES, Skeleton, SkeletonComponent
from lodpipe.geometry import skeleton_field as fields
from lodpipe.geometry.skeleton_bands import BandGraph, band_graph
from lodpipe.geometry.skeleton_dcg import domain_net, proxy
from lodpipe.geometry.skeleton_net import Net
from lodpipe.geometry.skeleton_rays import Rays
from lodpipe.geometry.skeleton_surface import Bool, Surface
from lodpipe.geometry.skeleton_tips import settle, tips

TRUNK = 2.0
"""The fattest node of a component without joints is its trunk if it is so many times as fat as its branch is."""
PERSISTENCE = 0.4
"""Share of a branch's least length that must stick out of what it hangs on."""
SPECK = 0.02
"""Components smaller than this share of the whole's diagonal get a single node."""


@dataclass(frozen=True)
class SkeletonOptions:
    """How a skeleton is made; see docs/skeleton.md for when to change what."""

    method: Literal["geodesic", "dcg"] = "geodesic"
    """`geodesic`: level sets of a distance along the surface; `dcg`: domain balls of a repulsive force inside."""
    distance: Literal["dijkstra", "heat"] = "dijkstra"
    """Shortest paths along edges, or the heat method (needs potpourri3d): smoother, slower."""
    sources: Literal["single", "multi"] = "multi"
    """One source at an end of the model; or that, with branches that it misses taken from the mean distance."""
    levels: int | Literal["formula", "adaptive"] = "adaptive"
    """Bands for each component: a number from 2, max distance / (2 · mean edge), or following the local edge length."""
    least_branch: float = 5.0
    """Branches shorter than this are pruned, in % of their component's diagonal; 0…100."""
    centre: bool = True
    """Move nodes into the middle of the surface, and links that leave it inside."""


def load_libraries() -> None:
    """Import what `skeleton` needs, which takes longer than most skeletons: for callers that measure time."""
    import scipy.sparse.csgraph  # noqa: F401 it is the import that takes the time

    import lodpipe.o3d  # noqa: F401 the same


def skeleton(asset: Asset, options: SkeletonOptions | None = None, threads: int = 0) -> Skeleton:
    """The skeleton of `asset.meshes`, each in the largest of its placements.

    Every connected component has one: a net of nodes and links, a single node if it is compact, tiny or flat. What
    could not be done for a component stands in its notes. Raises InvalidMesh for an option out of range.
    """
    options = options or SkeletonOptions()
    if isinstance(options.levels, int) and options.levels < 2:
        raise InvalidMesh(f"levels must be 2 or more (got {options.levels})")
    if not 0 <= options.least_branch <= 100:
        raise InvalidMesh(f"least_branch lies from 0 to 100 % (got {options.least_branch:g})")
    surface = Surface.of(asset)
    if not len(surface.faces):
        return _empty(asset, options.method)
    method = _dcg if options.method == "dcg" else _geodesic
    return method(surface, options, Rays(surface, threads))


def _geodesic(surface: Surface, options: SkeletonOptions, rays: Rays) -> Skeleton:
    source = fields.far_ends(surface)
    field = fields.distances(surface, source, options.distance)
    x, unit = fields.normalised(surface, field)
    graph = band_graph(surface, x, fields.cuts_of(surface, x, unit, options.levels))
    net = _net(graph, unit)
    least = options.least_branch / 100 * surface.diagonals
    least[surface.diagonals < SPECK] = np.inf
    net.prune(PERSISTENCE * least)
    vertex = graph.vertex
    if options.sources == "multi":
        mean = fields.mean_distance(surface, source, options.distance)
        vertex = settle(surface, net, vertex, mean, tips(surface, rays, mean, least))
    if options.centre:
        net.centre(net.alive, rays, vertex)
        net.smooth()
        net.centre(net.alive, rays, vertex)
        net.smooth()
        if options.sources == "single":
            net.prune(least, straight=True)
        net.absorb()
        if options.sources == "single":
            net.trim(rays, surface.points, vertex)
        net.join_joints(least)
        net.straighten(rays, vertex, least)
    _, level = fields.level_of(x, graph.cuts, surface.component)
    return _finished(surface, net, vertex, level, _on_level(surface, x, graph.cuts), rays, options)


def _dcg(surface: Surface, options: SkeletonOptions, rays: Rays) -> Skeleton:
    source = fields.far_ends(surface)
    x, unit = fields.normalised(surface, fields.distances(surface, source, options.distance))
    cuts = fields.cuts_of(surface, x, unit, options.levels)
    small, row = proxy(surface)
    few = rays if small is surface else Rays(small, rays.threads)
    start = fields.far_ends(small)
    net, vertex = domain_net(small, few, fields.distances(small, start))
    least = options.least_branch / 100 * small.diagonals
    least[small.diagonals < SPECK] = np.inf
    mean = fields.mean_distance(small, start)
    vertex = settle(small, net, vertex, mean, tips(small, few, mean, least))
    net.join_joints(least)
    if options.centre:
        net.centre([n for n in net.alive if 0 < len(net.near[n]) < 3], few, vertex)
        net.straighten(few, vertex, least)
    _, level = fields.level_of(x, cuts, surface.component)
    return _finished(surface, net, vertex[row], level, _on_level(surface, x, cuts), rays, options)


def _net(graph: BandGraph, unit: F64) -> Net:
    """A node for each part of a band; where two parts meet in several curves, one for each further curve as well."""
    net = Net()
    scale = unit[graph.component]
    low, high = ((h - graph.component) * scale for h in (graph.low, graph.high))
    for n in range(len(graph.area)):
        middle = float(low[n] + high[n]) / 2
        net.add(graph.centre[n], middle, int(graph.component[n]), reach=float(high[n] - low[n]) / 2)
    for (a, b), at, middle in zip(graph.links.tolist(), graph.at, graph.curve, strict=True):
        if b in net.near[a]:
            c = int(graph.component[a])
            between = net.add(middle, float(at - c) * float(unit[c]), c)
            net.link(a, between)
            net.link(between, b)
        else:
            net.link(a, b)
    return net


def _on_level(surface: Surface, x: F64, cuts: F64) -> Bool:
    """(V,) whether a level set's curve touches the vertex: it is the nearer end of an edge that the curve crosses."""
    a, b = surface.edges.T
    low, high = np.where(x[a] < x[b], a, b), np.where(x[a] < x[b], b, a)
    before, after = np.searchsorted(cuts, x[low], side="right"), np.searchsorted(cuts, x[high], side="right")
    crossed = before < after
    first, last = (
        cuts[np.minimum(before, len(cuts) - 1)] if len(cuts) else x[low],
        cuts[after - 1] if len(cuts) else x[low],
    )
    touched = np.zeros(len(x), bool)
    touched[low[crossed & (first - x[low] <= x[high] - first)]] = True
    touched[high[crossed & (x[high] - last <= last - x[low])]] = True
    return touched


def _finished(
    surface: Surface, net: Net, vertex: I32, level: I32, on_level: Bool, rays: Rays, options: SkeletonOptions
) -> Skeleton:
    """The result, nodes in the order of component and height, all in world space and for the asset's own vertices."""
    alive = sorted(net.alive, key=lambda n: (net.component[n], net.height[n], n))
    number = np.full(len(net.into), -1, np.int32)
    number[alive] = np.arange(len(alive), dtype=np.int32)
    node = number[net.owners()[vertex]]
    place = np.array([net.place[n] for n in alive])
    component = np.array([net.component[n] for n in alive], np.int32)
    edges = np.array([sorted((number[a], number[b])) for a, b in net.links()], np.int32).reshape(-1, 2)
    edges = edges[np.lexsort(edges.T[::-1])]
    degree = np.bincount(edges.ravel(), minlength=len(alive))
    kind = np.select([degree == 0, degree == 1, degree == 2], [3, 0, 1], 2).astype(np.int8)
    radius = np.array([net.radius[n] for n in alive])
    _mark_trunks(kind, degree, radius, component)
    tips = _tips(surface, place, edges, degree, kind, node)
    mesh, row = _in_asset(surface, tips)
    shares: list[float | None] = [None] * surface.component_count
    if options.centre:
        shares = net.inside_shares(rays, surface.component_count)
    ranks = np.bincount(component[edges[:, 0]], minlength=surface.component_count)
    ranks = ranks - np.bincount(component, minlength=surface.component_count) + 1
    parts = tuple(
        SkeletonComponent(int(rank), genus, share, _notes(surface, c, genus))
        for c, (rank, genus, share) in enumerate(zip(ranks, surface.genus, shares, strict=True))
    )
    return Skeleton(
        method=options.method,
        positions=surface.unplaced(place),
        radius=radius * surface.scale,
        node_type=kind,
        component=component,
        edges=edges,
        tip=row,
        tip_mesh=mesh,
        vertex_node=_spread(surface, node, -1),
        vertex_level=_spread(surface, level, -1),
        on_level=_spread(surface, on_level, False),
        components=parts,
    )


def _mark_trunks(kind: np.ndarray, degree: np.ndarray, radius: F64, component: I32) -> None:
    """A path whose one end is much fatter than the rest is a trunk with one branch: that end is its joint."""
    count = int(component.max(initial=-1)) + 1
    joints = np.bincount(component[kind == 2], minlength=count)
    fattest = np.lexsort((-np.arange(len(radius)), radius, component))
    fattest = fattest[np.flatnonzero(np.diff(component[fattest], append=-1))]
    for n in fattest:
        c = component[n]
        if not joints[c] and degree[n] == 1 and radius[n] > TRUNK * np.median(radius[component == c]):
            kind[n] = NODE_TYPES.index("joint")


def _tips(surface: Surface, place: F64, edges: I32, degree: np.ndarray, kind: np.ndarray, node: I32) -> I32:
    """(N,) each end's terminal vertex: the one of its domain that goes farthest the way its link goes; else −1."""
    tips = np.full(len(place), -1, np.int32)
    towards = np.zeros_like(place)
    np.add.at(towards, edges[:, 0], place[edges[:, 0]] - place[edges[:, 1]])
    np.add.at(towards, edges[:, 1], place[edges[:, 1]] - place[edges[:, 0]])
    real = np.ones(len(surface.points), bool)
    real[list(surface.holes)] = False
    mine = np.flatnonzero((kind[node] == 0) & real)
    far = np.einsum("ij,ij->i", surface.points[mine] - place[node[mine]], towards[node[mine]])
    order = np.lexsort((-mine, far, node[mine]))
    last = order[np.flatnonzero(np.diff(node[mine][order], append=-1))]
    tips[node[mine[last]]] = mine[last]
    return tips


def _in_asset(surface: Surface, rows: I32) -> tuple[I32, I32]:
    """(mesh, position) of the asset for rows of the surface's vertices; −1 for −1."""
    mesh, position = np.full(len(rows), -1, np.int32), np.full(len(rows), -1, np.int32)
    for index in range(len(surface.vertex) - 1, -1, -1):  # the first mesh that has it wins
        found = np.full(len(surface.points), -1, np.int32)
        known = np.flatnonzero(surface.vertex[index] >= 0)
        found[surface.vertex[index][known][::-1]] = known[::-1]
        here = (rows >= 0) & (found[rows] >= 0)
        mesh[here], position[here] = index, found[rows[here]]
    return mesh, position


def _spread(surface: Surface, values: np.ndarray, missing: int | bool) -> tuple[np.ndarray, ...]:
    """Values of the surface's vertices as one array for each of the asset's meshes."""
    table = np.append(values, np.array([missing], values.dtype))
    return tuple(table[rows] for rows in surface.vertex)


def _notes(surface: Surface, component: int, genus: int | None) -> tuple[str, ...]:
    holes, several = surface.defects[component]
    notes = []
    if holes:
        notes.append(f"open: {holes} border loop{'s' if holes > 1 else ''} taken as closed")
    if several:
        notes.append(f"not a manifold: {several} edges of three or more faces; loops may be false")
    elif genus is None:
        notes.append("one-sided: it has no inside")
    if surface.diagonals[component] < SPECK:
        notes.append("tiny: branches are not looked for")
    return tuple(notes)


def _empty(asset: Asset, method: str) -> Skeleton:
    return Skeleton(
        method=method,
        positions=np.zeros((0, 3)),
        radius=np.zeros(0),
        node_type=np.zeros(0, np.int8),
        component=np.zeros(0, np.int32),
        edges=np.zeros((0, 2), np.int32),
        tip=np.zeros(0, np.int32),
        tip_mesh=np.zeros(0, np.int32),
        vertex_node=tuple(np.full(len(m.positions), -1, np.int32) for m in asset.meshes),
        vertex_level=tuple(np.full(len(m.positions), -1, np.int32) for m in asset.meshes),
        on_level=tuple(np.zeros(len(m.positions), bool) for m in asset.meshes),
    )
