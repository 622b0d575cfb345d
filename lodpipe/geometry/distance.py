"""Distances between surfaces, sampled in both directions as Metro does.

Cignoni, Rocchini & Scopigno 1998, "Metro: measuring error on simplified surfaces"; the mean square is E_i of Garland
& Heckbert 1997. Points are spread over a surface by area, and the other surface's closest point is found for each.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.asset import Asset, ErrorFigures
from lodpipe.core.errors import InvalidMesh
from lodpipe.core.mesh import F32, F64, I32
from lodpipe.geometry.flatten import Bool, Soup, flatten

if TYPE_CHECKING:
    from lodpipe.o3d import RayScene

I64 = NDArray[np.int64]

BATCH = 1 << 18
"""Points asked about at once, which bounds the memory of a question to about 30 MB."""
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
    and however large the surfaces are (1e-5 on fans of needles a thousand times as long as thick). Raises
    InvalidMesh if one of the two has no triangles.
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
    def _scene(self) -> tuple[RayScene, I32 | None]:
        """The search structure and, where it holds pieces of faces, the face that each piece is of."""
        from lodpipe.o3d import RayScene

        positions, faces, parents = split_slivers(self.positions, self.faces, *self._sizes)
        return RayScene(positions, faces, self._options.threads), parents

    @cached_property
    def _sizes(self) -> tuple[F32, F32]:
        return face_sizes(self.positions, self.faces)

    @cached_property
    def samples(self) -> tuple[F32, I32]:
        """Points spread over the surface, and the faces that they lie on."""
        count = min(self._options.samples, SAMPLES_PER_FACE * len(self.faces))
        return sample_surface(self.positions, self.faces, self._sizes[0], count, self._options.seed)

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
        scene, parents = self._scene
        distance, faces = np.empty(len(points)), np.empty(len(points), np.int32)
        for start in range(0, len(points), BATCH):
            part = slice(start, start + BATCH)
            found, faces[part] = scene.closest(points[part])
            distance[part] = np.linalg.norm(found.astype(np.float64) - points[part], axis=1)
        return distance, faces if parents is None else parents[faces]

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
        direction = normals.astype(np.float32)
        start = points - direction * reach[:, None].astype(np.float32)
        scene, parents = self._scene
        found = scene.crossings(start, direction)
        faces = found.faces if parents is None else parents[found.faces]
        cosine = np.einsum("ij,ij->i", self.normals(faces), normals[found.rays])
        away = np.abs(found.distance - reach[found.rays])
        fits = np.flatnonzero((cosine > 0) & (away <= reach[found.rays]))
        fits = fits[np.lexsort((faces[fits], away[fits], found.rays[fits]))]
        rays, first = np.unique(found.rays[fits], return_index=True)
        best = np.full(len(points), -1.0)
        best[rays] = cosine[fits[first]]
        return best


def _both_ways(a: _Surface, b: _Surface) -> ErrorFigures:
    if np.array_equal(a.faces, b.faces) and np.array_equal(a.positions, b.positions):
        return ErrorFigures(0.0, 0.0, 0.0, 0.0)
    to, back = _one_way(a, b), _one_way(b, a)
    return ErrorFigures(
        mean=50.0 * (to.mean + back.mean),
        rms=100.0 * float(np.sqrt((to.rms**2 + back.rms**2) / 2)),
        max=100.0 * max(to.max, back.max),
        normal_degrees=(to.normal_degrees + back.normal_degrees) / 2,
    )


class _Deviation(NamedTuple):
    """One direction's figures, distances in diagonals."""

    mean: float
    rms: float
    max: float
    normal_degrees: float


def _one_way(a: _Surface, b: _Surface) -> _Deviation:
    points, _ = a.samples
    distance, faces = b.closest(points)
    return _Deviation(
        mean=float(distance.mean()),
        rms=float(np.sqrt(np.square(distance).mean())),
        max=_largest(a, b, distance),
        normal_degrees=_normal_deviation(points, a.sample_normals, distance, faces, b),
    )


def _largest(a: _Surface, b: _Surface, distance: F64) -> float:
    """The largest distance to `b` of a's samples, which is known, and of its vertices.

    No vertex is farther away than a sample is, plus the way between the two: only those are asked for that could
    be farther than the farthest sample, evenly thinned where they are more than half the number of samples.
    """
    vertices, near, way = a.vertices
    largest = float(distance.max())
    asked = np.flatnonzero(distance[near] + way > largest)
    asked = asked[:: 1 + 2 * len(asked) // len(distance)]
    return max(largest, float(b.closest(vertices[asked])[0].max(initial=0.0)))


def _normal_deviation(points: F32, normals: F64, distance: F64, faces: I32, other: _Surface) -> float:
    """Mean angle in degrees between `normals` at `points` and the facing normals of `other`; see distance_between."""
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


def split_slivers(positions: F32, faces: I32, doubled_area: F32, longest_edge: F32) -> tuple[F32, I32, I32 | None]:
    """Halve long slivers, until single precision finds their closest points or there are 100,000 pieces more.

    A closest point's barycentric coordinates lose what a triangle's length exceeds its height by: the point is off
    by about ε·L³ / 2A (L the longest edge, A the area). Each halving of the longest edge divides that by four.
    Returns positions and faces for the search, and the face of which each row is a piece (None: nothing was split).
    Faces without area are left out unless there are no others: their edges are their neighbours'.
    """
    weak, flat = _slivers(doubled_area, longest_edge)
    if not weak.any() and (not flat.any() or flat.all()):
        return positions, faces, None
    keep = ~flat
    parents = np.flatnonzero(keep).astype(np.int32)
    faces, weak = faces[keep], weak[keep]
    done, owners = [faces[~weak]], [parents[~weak]]
    faces, parents = faces[weak], parents[weak]
    limit = 2 * len(keep) + 100_000
    while len(faces) and sum(map(len, done)) + 2 * len(faces) < limit:
        corners = positions[faces]
        longest = np.linalg.norm(corners[:, [1, 2, 0]] - corners, axis=2).argmax(axis=1)
        a, b, c = (np.take_along_axis(faces, (longest[:, None] + k) % 3, axis=1)[:, 0] for k in range(3))
        middle = np.arange(len(positions), len(positions) + len(faces), dtype=np.int32)
        positions = np.concatenate([positions, (positions[a] + positions[b]) * np.float32(0.5)])
        faces = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
        parents = np.concatenate([parents, parents])
        weak, _ = _slivers(*face_sizes(positions, faces))
        done.append(faces[~weak])
        owners.append(parents[~weak])
        faces, parents = faces[weak], parents[weak]
    return positions, np.concatenate([*done, faces]), np.concatenate([*owners, parents])


def _slivers(doubled_area: F32, longest_edge: F32) -> tuple[Bool, Bool]:
    """Which faces need halving, and which have no area."""
    square = longest_edge * longest_edge
    flat = doubled_area <= 1e-7 * square
    return ~flat & (1.2e-7 * square * longest_edge > 1e-6 * doubled_area), flat


def face_sizes(positions: F32, faces: I32) -> tuple[F32, F32]:
    """Twice the area, and the longest edge, of each of `faces` (N, 3): (N,) float32 each."""
    doubled, longest = np.empty(len(faces), np.float32), np.empty(len(faces), np.float32)
    for start in range(0, len(faces), BATCH):
        part = slice(start, start + BATCH)
        a, b, c = (positions[faces[part, k]] for k in range(3))
        ab, ac, bc = (b - a).T, (c - a).T, (c - b).T
        normal = ab[1] * ac[2] - ab[2] * ac[1], ab[2] * ac[0] - ab[0] * ac[2], ab[0] * ac[1] - ab[1] * ac[0]
        doubled[part] = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
        longest[part] = np.sqrt(np.max([e[0] ** 2 + e[1] ** 2 + e[2] ** 2 for e in (ab, ac, bc)], axis=0))
    return doubled, longest


def _area_vectors(positions: F32, faces: I32) -> F64:
    """(N, 3) float64: normal times twice the area of each face."""
    a, b, c = (positions[faces[:, k]].astype(np.float64) for k in range(3))
    return np.cross(b - a, c - a)


def _lowest_first(faces: I32) -> I32:
    """Each face's corners turned, not reordered, so that the lowest comes first."""
    turn = (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3
    return np.take_along_axis(faces, turn, axis=1)
