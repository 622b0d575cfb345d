"""Distance fields over a surface, and where level sets cut them.

A field here is x = component + SPAN · f / max f for each vertex, f a distance along the surface: one sorted list of
cuts serves all components, and no two vertices of a component are equal.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from lodpipe.core.errors import LodpipeError
from lodpipe.core.mesh import F64, I32
from lodpipe.geometry.skeleton_surface import I64, Surface

SPAN = 0.98
"""What a field takes of each component's unit interval."""
TIE = 1e-9
"""Vertices of equal distance are told apart by less than this."""
BINS = 256
"""Steps in which the local edge length is followed."""
MOST_LEVELS = 400
SAMPLES = 16
"""Sources of a mean field, spread by farthest points."""

Distance = Literal["dijkstra", "heat"]


def distances(surface: Surface, sources: I64, method: Distance = "dijkstra") -> F64:
    """(V,) distance to the nearest of `sources` (rows of the vertices) along the surface; infinity out of reach.

    dijkstra  shortest paths along edges (Pao 2003, 2.1.1)
    heat      the heat method (Crane, Weischedel & Wardetzky 2013), shifted so that each component begins at 0: smooth,
              and not bound to the edges. One linear system is set up per surface.
    """
    if method == "heat":
        return _heat(surface, sources)
    from scipy.sparse.csgraph import dijkstra

    found: F64 = dijkstra(surface.graph, directed=True, indices=sources, min_only=True)
    return found


def _heat(surface: Surface, sources: I64) -> F64:
    try:
        import potpourri3d
    except ImportError as error:
        raise LodpipeError("the heat method needs the package potpourri3d", advice="pip install potpourri3d") from error

    solver = potpourri3d.MeshHeatMethodDistanceSolver(surface.points, surface.faces)
    field = solver.compute_distance_multisource(sources)
    low = np.full(surface.component_count, np.inf)
    np.minimum.at(low, surface.component, field)
    return np.asarray(np.maximum(field - low[surface.component], 0.0))


def farthest(surface: Surface, field: F64) -> I64:
    """(C,) for each component the vertex where `field` is largest, the lowest of equals."""
    if surface.component_count == 1:
        return np.array([np.argmax(field)], np.int64)
    order = np.lexsort((-np.arange(len(field)), field, surface.component))
    last = np.flatnonzero(np.diff(surface.component[order], append=-1))
    return order[last]


def far_ends(surface: Surface) -> I64:
    """(C,) a vertex of each component that lies at an end of it: the farthest from the farthest (two sweeps)."""
    _, first = np.unique(surface.component, return_index=True)
    here = farthest(surface, distances(surface, first))
    return farthest(surface, distances(surface, here))


def mean_distance(surface: Surface, start: I64, method: Distance = "dijkstra", samples: int = SAMPLES) -> F64:
    """(V,) mean distance to `samples` vertices spread over each component by farthest points, `start` the first.

    Its maxima are the ends of limbs, wherever a single source lies (Hilaga et al. 2001, integral geodesic distance).
    """
    nearest = distances(surface, start, method)
    total = nearest.copy()
    for _ in range(samples - 1):
        field = distances(surface, farthest(surface, nearest), method)
        np.minimum(nearest, field, out=nearest)
        total += field
    return total / samples


def normalised(surface: Surface, field: F64) -> tuple[F64, F64]:
    """The field as x for each vertex (see the module), and (C,) the distance that a unit of x stands for."""
    finite = np.where(np.isfinite(field), field, 0.0)
    component = surface.component
    low, high = np.full(surface.component_count, np.inf), np.zeros(surface.component_count)
    np.minimum.at(low, component, finite)
    np.maximum.at(high, component, finite)
    span = np.maximum(high - low, 1e-12)
    golden = np.arange(len(field)) * 0.6180339887498949 % 1.0  # generic: equals are told apart, whatever their order
    share = (finite - low[component]) / span[component] * (1 - TIE) + TIE * golden
    return component + SPAN * share, span / SPAN


def cuts_of(surface: Surface, x: F64, unit: F64, levels: int | Literal["formula", "adaptive"]) -> F64:
    """Ascending values of x where level sets lie.

    levels  a number of bands for each component; `formula`: max distance / (2 · mean edge) (Pao 2003, 2.1.1), at most
            MOST_LEVELS; `adaptive`: ADAPTIVE bands spaced by the local edge length, up to 2 times finer or coarser
    """
    count = surface.component_count
    of_edge = surface.component[surface.edges[:, 0]]
    mean = np.bincount(of_edge, surface.lengths, count) / np.maximum(np.bincount(of_edge, minlength=count), 1)
    formula = np.clip(SPAN * unit / (2 * np.maximum(mean, 1e-12)), 2, MOST_LEVELS).astype(np.int64)
    if levels == "formula":
        wanted = formula
    else:  # bands much narrower than the edges would say nothing new
        wanted = np.minimum(ADAPTIVE if levels == "adaptive" else int(levels), 4 * formula)
    start = np.cumsum(wanted - 1) - (wanted - 1)
    owner = np.repeat(np.arange(count), wanted - 1)
    share = (np.arange(len(owner)) - start[owner] + 1) / wanted[owner]
    if levels == "adaptive" and count <= len(x) // BINS + 1:
        share = _warped(surface, x, owner, share)
    return np.asarray(owner + SPAN * share)


ADAPTIVE = 48


def _warped(surface: Surface, x: F64, owner: I64, share: F64) -> F64:
    """Even shares of each component's span moved so that bands follow the mean edge length along the field."""
    a, b = surface.edges.T
    component = surface.component[a]
    place = np.clip(((x[a] + x[b]) / 2 - component) / SPAN, 0, 1 - 1e-9)
    slot = component * BINS + (place * BINS).astype(np.int64)
    size = surface.component_count * BINS
    number, total = np.bincount(slot, minlength=size), np.bincount(slot, surface.lengths, size)
    window = np.ones(BINS // 8)
    out = share.copy()
    for c in np.unique(owner):
        rows = slice(c * BINS, (c + 1) * BINS)
        smooth = np.convolve(total[rows], window, "same") / np.maximum(np.convolve(number[rows], window, "same"), 1e-12)
        smooth = np.where(smooth > 0, smooth, smooth[smooth > 0].mean() if (smooth > 0).any() else 1.0)
        density = np.clip(np.median(smooth) / smooth, 0.5, 2.0)
        reached = np.concatenate([[0.0], np.cumsum(density)]) / density.sum()
        mine = owner == c
        out[mine] = np.interp(share[mine], reached, np.linspace(0, 1, BINS + 1))
    return out


def level_of(x: F64, cuts: F64, component: I32) -> tuple[I32, I32]:
    """The band of each vertex, counted through all components, and counted from 0 in its own."""
    band = np.searchsorted(cuts, x, side="right").astype(np.int32)
    first = np.searchsorted(cuts, np.arange(int(component.max(initial=-1)) + 1), side="left")
    return band, (band - first[component]).astype(np.int32)
