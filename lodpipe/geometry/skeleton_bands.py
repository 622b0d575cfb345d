"""The graph of a field's level sets, by face bands.

The cuts divide each face into bands. Two neighbouring faces' parts of one band belong together where the edge between
them reaches into the band; two consecutive bands of a face are joined across the cut between them. Connected parts of
a band are the graph's nodes, closed curves (or arcs) of a cut its links. On a closed surface whose parts are all of
genus 0 the graph has as many loops as the surface has handles, however irregular the mesh (Reeb graph; compare the
test of branches on vertices in Pao 2003, 2.1.2, which finds false loops).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lodpipe.core.mesh import F64, I32
from lodpipe.geometry.skeleton_surface import I64, Surface

SPLIT = 8
"""Parts into which a band with a handle inside is cut."""
MOST_ROUNDS = 12


@dataclass(frozen=True, eq=False)
class BandGraph:
    """Parts of bands and the curves between them.

    centre     (P, 3) area centroid of each part; area (P,)
    low, high  (P,) range of x in it
    component  (P,) int32
    links      (L, 2) int32: parts below and above each curve; two parts may have several curves between them
    at         (L,) x of each curve; curve (L, 3) its centroid
    handles    (P,) genus of the part itself, 0 but where the rounds of refinement did not do
    vertex     (V,) int32 the part in which each vertex lies
    cuts       as they were refined
    """

    centre: F64
    area: F64
    low: F64
    high: F64
    component: I32
    links: I64
    at: F64
    curve: F64
    handles: I64
    vertex: I32
    cuts: F64


def band_graph(surface: Surface, x: F64, cuts: F64) -> BandGraph:
    """The graph of x over the surface, with more cuts where a part would hide a handle."""
    closed = np.array([g is not None for g in surface.genus], bool)
    for _ in range(MOST_ROUNDS):
        graph = _graph(surface, x, cuts)
        hidden = np.flatnonzero((graph.handles > 0) & closed[graph.component])
        if not len(hidden):
            break
        more = []
        for part in hidden:
            inside = np.sort(x[graph.vertex == part])
            if len(inside) > 1:
                steps = np.linspace(0, len(inside) - 1, min(SPLIT, len(inside)) + 1)[1:-1].round().astype(int)
                more.append((inside[steps - 1] + inside[steps]) / 2)
        finer = np.unique(np.concatenate([cuts, *more]))
        if len(finer) == len(cuts):
            break
        cuts = finer
    return graph


def _graph(surface: Surface, x: F64, cuts: F64) -> BandGraph:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    faces = surface.faces
    band = np.searchsorted(cuts, x, side="right").astype(np.int32)
    bands = band[faces]
    low = bands.min(axis=1)
    spans = bands.max(axis=1) - low + 1
    start = np.cumsum(spans) - spans  # of each face's pairs (face, band)
    size = int(spans.sum())
    face = np.repeat(np.arange(len(faces)), spans)
    pair_band = np.arange(size) - start[face] + low[face]

    edge, one, other = surface.adjacent
    ends = band[surface.edges[edge]]
    edge_low = ends.min(axis=1)
    number = ends.max(axis=1) - edge_low + 1
    row = np.repeat(np.arange(len(edge)), number)
    step = np.arange(len(row)) - (np.cumsum(number) - number)[row]
    level = edge_low[row] + step
    left, right = (start[f[row]] + level - low[f[row]] for f in (one, other))

    def parts(a: I64, b: I64) -> I32:
        return np.asarray(
            connected_components(coo_array((np.ones(len(a), bool), (a, b)), shape=(size, size)), False)[1]
        )

    part = parts(left, right)
    corner_pair = start[:, None] + bands - low[:, None]
    count = int(part.max(initial=-1)) + 1
    crossing = np.flatnonzero(pair_band > low[face])  # each pair but a face's first lies above a crossing
    crossed = step > 0
    apart = parts(left[crossed], right[crossed])[crossing]
    _, first, curve = np.unique(apart, return_index=True, return_inverse=True)
    chosen = crossing[first]
    links = np.stack([part[chosen - 1], part[chosen]], axis=1).astype(np.int64)
    at = cuts[pair_band[chosen] - 1]

    vertex = np.full(len(x), -1, np.int32)
    vertex[faces] = part[corner_pair]
    used = vertex >= 0
    euler = np.bincount(vertex[used], minlength=count) + np.bincount(part, minlength=count)
    euler = euler - np.bincount(part[left], minlength=count)
    curves = np.bincount(links.ravel(), minlength=count)
    component = np.zeros(count, np.int32)
    component[part] = surface.component[faces[face, 0]]
    centre, area = _centres(surface, x, cuts, face, pair_band, part, count)
    bottom, top = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(bottom, vertex[used], x[used])
    np.maximum.at(top, vertex[used], x[used])
    np.minimum.at(bottom, links[:, 0], at)
    np.maximum.at(top, links[:, 0], at)
    np.minimum.at(bottom, links[:, 1], at)
    np.maximum.at(top, links[:, 1], at)
    middle = _curve_centres(surface, x, cuts, face[crossing], pair_band[crossing], curve, len(links))
    handles = (2 - curves - euler) // 2
    return BandGraph(centre, area, bottom, top, component, links, at, middle, handles, vertex, cuts)


def _centres(surface: Surface, x: F64, cuts: F64, face: I64, band: I64, part: I32, count: int) -> tuple[F64, F64]:
    """Area centroids and areas of the parts: what of each face lies between its band's two cuts."""
    order = np.argsort(x[surface.faces], axis=1)
    corners = np.take_along_axis(surface.faces, order, axis=1)
    p, h = surface.points[corners], x[corners]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    whole = np.maximum(np.sqrt(np.einsum("ij,ij->i", normal, normal)) / 2, 1e-18)
    edges = np.concatenate([[-np.inf], cuts, [np.inf]])
    area, moment = np.zeros(len(face)), np.zeros((len(face), 3))
    for cut, sign in ((edges[band + 1], 1.0), (edges[band], -1.0)):
        a, m = _below(p[face], h[face], whole[face], cut)
        area += sign * a
        moment += sign * m
    area = np.maximum(area, 1e-18)
    total = np.asarray(np.bincount(part, area, count), np.float64)
    sums = np.stack([np.bincount(part, moment[:, k], count) for k in range(3)], axis=1)
    centre = sums / total[:, None]
    thin = np.flatnonzero((total <= 1e-12)[part])  # slivers of no area: the middle of their faces
    if len(thin):
        middle = surface.points[surface.faces[face[thin]]].mean(axis=1)
        number = np.maximum(np.bincount(part[thin], minlength=count), 1)
        means = np.stack([np.bincount(part[thin], middle[:, k], count) for k in range(3)], axis=1) / number[:, None]
        centre = np.where((total <= 1e-12)[:, None], means, centre)
    return centre, total


def _below(p: F64, h: F64, whole: F64, cut: F64) -> tuple[F64, F64]:
    """Area, and first moment, of what of triangles with ascending heights `h` lies below `cut`."""
    h0, h1, h2 = h.T
    small = np.clip((cut - h0) / (h1 - h0), 0, 1), np.clip((cut - h0) / (h2 - h0), 0, 1)
    rest = np.clip((h2 - cut) / (h2 - h1), 0, 1), np.clip((h2 - cut) / (h2 - h0), 0, 1)
    lower = cut <= h1
    s, t = np.where(lower, small[0], rest[0]), np.where(lower, small[1], rest[1])
    tip = np.where(lower[:, None], p[:, 0], p[:, 2])
    ends = p[:, 1] - tip, np.where(lower[:, None], p[:, 2], p[:, 0]) - tip
    area = whole * s * t
    moment = area[:, None] * (tip + (s[:, None] * ends[0] + t[:, None] * ends[1]) / 3)
    centroid = p.mean(axis=1)
    inner: F64 = np.where(lower, area, whole - area)
    return inner, np.where(lower[:, None], moment, whole[:, None] * centroid - moment)


def _curve_centres(surface: Surface, x: F64, cuts: F64, face: I64, band: I64, curve: I64, count: int) -> F64:
    """Centroids of the curves, by length."""
    corners = surface.faces[face]
    h, p = x[corners], surface.points[corners]
    cut = cuts[band - 1][:, None]
    upper = h >= cut
    ends = np.zeros((len(face), 3))
    pieces = []
    for k in range(3):
        j = (k + 1) % 3
        share = np.clip((cut[:, 0] - h[:, k]) / (h[:, j] - h[:, k]), 0, 1)
        crossed = upper[:, k] != upper[:, j]
        point = p[:, k] + share[:, None] * (p[:, j] - p[:, k])
        ends += np.where(crossed[:, None], point, 0)
        pieces.append((crossed, point))
    length = np.zeros(len(face))
    for k in range(3):  # of the three edges two are crossed
        j = (k + 1) % 3
        both = pieces[k][0] & pieces[j][0]
        length[both] = np.linalg.norm(pieces[k][1][both] - pieces[j][1][both], axis=1)
    length += 1e-12
    total = np.bincount(curve, length, count)
    sums = [np.bincount(curve, length * ends[:, k] / 2, count) for k in range(3)]
    return np.stack(sums, axis=1) / total[:, None]
