"""Distances between surfaces, sampled in both directions as Metro does.

Cignoni, Rocchini & Scopigno 1998, "Metro: measuring error on simplified surfaces"; the mean square is E_i of Garland
& Heckbert 1997. Points are spread over a surface by area, and the other surface's closest point is found for each.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.asset import Asset, ErrorFigures
from lodpipe.core.errors import InvalidMesh
from lodpipe.core.mesh import F32, F64, I32
from lodpipe.geometry.flatten import Bool, Soup, flatten
from lodpipe.kernel.surfaces import TriangleTree

I64 = NDArray[np.int64]

BATCH = 1 << 18
"""Faces looked at at once, which bounds the memory that takes."""
SAMPLES_PER_FACE = 1000
"""No triangle needs more; the few triangles of a very coarse level lie far inside a fine source, where a closest
point can take a millisecond."""
WALL = 1e-3
"""Part of the diagonal within which a thin wall's other side is looked for, besides twice the distance."""


class Progress(Protocol):
    """Called with how much is done, out of how much; may raise to stop the work."""

    def __call__(self, done: float, total: float) -> None: ...


def measure_levels(
    asset: Asset, samples: int = 100_000, seed: int = 0, threads: int = 0, progress: Progress | None = None
) -> list[ErrorFigures | None]:
    """How far each of `asset.lods` is from `asset.meshes`, all instances placed; see `distance_between`.

    The source's search structure is built once. A level that equals the source has zeros. None stands for a level
    without triangles of a source that has some: it has no closest points.
    """
    source = flatten(asset)
    frame, options = _Frame.around(source), _Options(samples, seed, threads)
    reference = _Surface(source, frame, options)
    figures: list[ErrorFigures | None] = []
    for index, level in enumerate(asset.lods):
        if all(a is b for a, b in zip(level.meshes, asset.meshes, strict=True)):
            figures.append(ErrorFigures(0.0, 0.0, 0.0, 0.0))
        else:
            soup = flatten(asset, level.meshes)
            empty = len(source.faces) > 0 and len(soup.faces) == 0
            figures.append(None if empty else _both_ways(reference, _Surface(soup, frame, options)))
        if progress is not None:
            progress(index + 1, len(asset.lods))
    return figures


def distance_between(a: Soup, b: Soup, samples: int = 100_000, seed: int = 0, threads: int = 0) -> ErrorFigures:
    """Distances between the surfaces `a` and `b`, in % of the diagonal of a's bounding box.

    From each surface `samples` points, spread by area (fewer on surfaces of very few triangles), look for the
    closest point of the other. `mean` and `rms` give both directions the same weight. `max` is the larger
    direction's; it looks at the vertices as well, at no more than `samples` / 2 of those that could be farther.

    `normal_degrees` is the mean angle, 0…180, between the *facing* normals at a sample and at its closest point:
    normals point to the side from which a face is counter-clockwise, so that a face turned over counts as 180°. On
    a thin wall the closest point may lie on the wall's other side: where the angle exceeds 90° the sample is
    compared with the nearest surface on its normal line that faces the same way, if there is one within twice the
    sample's distance (and 0.1 % of the diagonal), or with the twin of a face that is there once for either side.

    The result is the same for any number of threads. Precision is about 1e-7 of the diagonal, wherever in space
    and however large the surfaces are. Raises InvalidMesh if one of the two has no triangles.
    """
    if (len(a.faces) == 0) != (len(b.faces) == 0):
        raise InvalidMesh("there is no distance to a model without triangles")
    frame, options = _Frame.around(a), _Options(samples, seed, threads)
    return _both_ways(_Surface(a, frame, options), _Surface(b, frame, options))


def sample_surface(positions: F32, faces: I32, area: F32, count: int, seed: int) -> tuple[F32, I32]:
    """`count` points spread evenly by `area` (F,) over the triangles: positions (count, 3), their faces (count,).

    One random point in each of `count` equal shares of the area, in the order of the faces: less noise than
    independent points, and neighbours follow one another, which closest-point searches like. Surfaces without
    area are sampled by face.
    """
    if not area.any():
        area = np.ones_like(area)
    until = np.cumsum(area, dtype=np.float64)
    rng = np.random.default_rng(seed)
    picked = np.searchsorted(until, (np.arange(count) + rng.random(count)) / count * until[-1], side="right")
    # rounding in the sum must not lead past the last face, nor onto a face without area behind it
    picked = np.minimum(picked, np.flatnonzero(area)[-1]).astype(np.int32)
    r, s = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    p, q, t = (positions[faces[picked, k]].astype(np.float64) for k in range(3))
    return ((1 - r) * p + r * (1 - s) * q + r * s * t).astype(np.float32), picked


@dataclass(frozen=True)
class _Frame:
    """The source's box, moved to the origin and scaled to a diagonal of 1: single precision is enough there."""

    centre: F64
    scale: float

    @classmethod
    def around(cls, soup: Soup) -> _Frame:
        low, high = soup.bounds
        return cls(low + (high - low) / 2, soup.diagonal or 1.0)


@dataclass(frozen=True)
class _Options:
    samples: int
    seed: int
    threads: int


class _Surface:
    """A soup in the frame's coordinates, its search structure and its samples, each made when first asked for."""

    def __init__(self, soup: Soup, frame: _Frame, options: _Options) -> None:
        self.positions: F32 = ((soup.positions - frame.centre) / frame.scale).astype(np.float32)
        self.faces = soup.faces
        self._soup = soup
        self._options = options

    @cached_property
    def _tree(self) -> TriangleTree:
        return TriangleTree(self.positions, self.faces, self._options.threads)

    @cached_property
    def samples(self) -> tuple[F32, I32]:
        """Points spread over the surface, and the faces that they lie on."""
        count = min(self._options.samples, SAMPLES_PER_FACE * len(self.faces))
        area = doubled_areas(self.positions, self.faces)
        return sample_surface(self.positions, self.faces, area, count, self._options.seed)

    @cached_property
    def sample_normals(self) -> F64:
        """The unit normals at the samples."""
        return self.normals(self.samples[1])

    @cached_property
    def vertices(self) -> tuple[F32, I64, F32]:
        """The vertices that faces use; for each the number of a sample near it, and the way there."""
        points, own_faces = self.samples
        face_of = np.zeros(len(self.positions), np.int32)
        face_of[self.faces] = np.arange(len(self.faces), dtype=np.int32)[:, None]
        used = self._soup.used
        first = np.searchsorted(own_faces, np.arange(len(self.faces)))  # each face's first sample, or the next face's
        near = np.minimum(first, len(points) - 1)[face_of[used]]
        gap = self.positions[used] - points[near]
        return self.positions[used], near, np.sqrt(np.einsum("ij,ij->i", gap, gap))

    def normals(self, faces: I32) -> F64:
        """Unit normals (N, 3) of `faces` (N,), zero for a face without area."""
        vectors = _area_vectors(self.positions, self.faces[faces])
        length = np.linalg.norm(vectors, axis=1, keepdims=True)
        return vectors / np.where(length > 0, length, 1.0)

    def closest(self, points: F32) -> tuple[F64, I32]:
        """Distance (N,) and face (N,) of the closest point to each of `points` (N, 3)."""
        distance, _, faces = self._tree.closest(points)
        return distance, faces

    def has_twin(self, faces: I32) -> Bool:
        """Which of `faces` (N,) are there a second time, wound the other way round."""
        # turned so that the lowest corner comes first: the twin of (a, b, c) is then (a, c, b)
        twins = _lowest_first(self.faces[faces])[:, [0, 2, 1]]
        near = np.zeros(len(self.positions), bool)
        near[twins] = True
        candidates = near[self.faces[:, 0]] & near[self.faces[:, 1]] & near[self.faces[:, 2]]
        present = _lowest_first(self.faces[candidates])
        _, ids = np.unique(np.concatenate([present, twins]), axis=0, return_inverse=True)
        return np.isin(ids[len(present) :], ids[: len(present)])

    def facing_cosine(self, points: F32, normals: F64, reach: F64) -> F64:
        """Of the surfaces within ±`reach` (N,) on each point's normal line that face the same way, the nearest's
        cosine with the normal; −1 where there is none."""
        faces = self._tree.facing(points, normals, reach)
        cosine = np.einsum("ij,ij->i", self.normals(faces), normals)
        return np.where(faces >= 0, cosine, -1.0)


def _both_ways(a: _Surface, b: _Surface) -> ErrorFigures:
    if np.array_equal(a.faces, b.faces) and np.array_equal(a.positions, b.positions):
        return ErrorFigures(0.0, 0.0, 0.0, 0.0)
    to, back = _one_way(a, b), _one_way(b, a)
    largest = max(float(way.distance.max()) for way in (to, back))
    for way in (to, back):
        largest = _largest(way, largest)
    return ErrorFigures(
        mean=50.0 * float(to.distance.mean() + back.distance.mean()),
        rms=100.0 * float(np.sqrt((np.square(to.distance).mean() + np.square(back.distance).mean()) / 2)),
        max=100.0 * largest,
        normal_degrees=(_normal_deviation(to) + _normal_deviation(back)) / 2,
    )


class _Way(NamedTuple):
    """The samples of `a`: their distances (N,) from `b` in diagonals, and the faces of b's closest points."""

    a: _Surface
    b: _Surface
    distance: F64
    faces: I32


def _one_way(a: _Surface, b: _Surface) -> _Way:
    return _Way(a, b, *b.closest(a.samples[0]))


def _largest(way: _Way, largest: float) -> float:
    """The larger of `largest` and the distances of a's vertices to `b`.

    No vertex is farther away than a sample is, plus the way between the two: only those are asked for that could
    be farther than `largest`, evenly thinned where they are more than half the number of samples.
    """
    vertices, near, gap = way.a.vertices
    asked = np.flatnonzero(way.distance[near] + gap > largest)
    asked = asked[:: 1 + 2 * len(asked) // len(way.distance)]
    return max(largest, float(way.b.closest(vertices[asked])[0].max(initial=0.0)))


def _normal_deviation(way: _Way) -> float:
    """Mean angle in degrees between the normals at a's samples and b's facing normals; see distance_between."""
    (points, _), normals, distance, other = way.a.samples, way.a.sample_normals, way.distance, way.b
    faces = way.faces
    others = other.normals(faces)
    cosine = np.einsum("ij,ij->i", normals, others)
    defined = normals.any(axis=1) & others.any(axis=1)
    turned = np.flatnonzero(defined & (cosine < 0))
    if len(turned):
        twin = other.has_twin(faces[turned])
        cosine[turned[twin]] *= -1
        rest = turned[~twin]
        facing = other.facing_cosine(points[rest], normals[rest], 2 * distance[rest] + WALL)
        cosine[rest] = np.where(facing > 0, facing, cosine[rest])
    if not defined.any():
        return 0.0
    return float(np.degrees(np.arccos(np.clip(cosine[defined], -1.0, 1.0))).mean())


def doubled_areas(positions: F32, faces: I32) -> F32:
    """(N,) float32: twice the area of each of `faces` (N, 3)."""
    doubled = np.empty(len(faces), np.float32)
    for start in range(0, len(faces), BATCH):
        part = slice(start, start + BATCH)
        a, b, c = (positions[faces[part, k]] for k in range(3))
        ab, ac = (b - a).T, (c - a).T
        normal = ab[1] * ac[2] - ab[2] * ac[1], ab[2] * ac[0] - ab[0] * ac[2], ab[0] * ac[1] - ab[1] * ac[0]
        doubled[part] = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    return doubled


def _area_vectors(positions: F32, faces: I32) -> F64:
    """(N, 3) float64: normal times twice the area of each face."""
    a, b, c = (positions[faces[:, k]].astype(np.float64) for k in range(3))
    return np.cross(b - a, c - a)


def _lowest_first(faces: I32) -> I32:
    """Each face's corners turned, not reordered, so that the lowest comes first."""
    turn = (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3
    return np.take_along_axis(faces, turn, axis=1)
