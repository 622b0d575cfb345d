"""Quadrics of faces and vertices as the papers define them, in plain NumPy and float64, in any unit.

GH97   Garland & Heckbert 1997, "Surface simplification using quadric error metrics"
GH98   Garland & Heckbert 1998, "Simplifying surfaces with color and texture using quadric error metrics"
H99    Hoppe 1999, "New quadric metric for simplifying meshes with appearance attributes"
G99    Garland 1999, "Quadric-based polygonal surface simplification" (thesis; area weights)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from lodpipe.core.mesh import F32, F64, I32
from lodpipe.kernel import QuadricOptions

DAMPING = 3e-6
"""Share of the trace that pulls the optimum to the edge's middle where nothing else holds it."""
REACH = 2.0
"""The optimum lies within so many edge lengths of the edge's middle, or is not believed."""


@dataclass(frozen=True)
class Quadric:
    """E(x) = xᵀ A x + 2 b·x + c in any number of dimensions; A symmetric."""

    A: F64
    b: F64
    c: float

    @staticmethod
    def zero(dimensions: int = 3) -> Quadric:
        return Quadric(np.zeros((dimensions, dimensions)), np.zeros(dimensions), 0.0)

    @staticmethod
    def of_plane(normal: F64, offset: float, weight: float = 1.0) -> Quadric:
        """weight · (normal·x + offset)²: K_p of GH97, section 5; the normal need not have unit length."""
        return Quadric(weight * np.outer(normal, normal), weight * offset * normal, weight * offset**2)

    def __add__(self, other: Quadric) -> Quadric:
        return Quadric(self.A + other.A, self.b + other.b, self.c + other.c)

    def __mul__(self, factor: float) -> Quadric:
        return Quadric(factor * self.A, factor * self.b, factor * self.c)

    def at(self, x: F64) -> float:
        return float(x @ self.A @ x + 2 * self.b @ x + self.c)

    @property
    def trace(self) -> float:
        return float(np.trace(self.A))


# ------------------------------------------------------------------------------------------------ quadrics of a face


def gradients(corners: F64, values: F64) -> tuple[F64, F64]:
    """Each of K attributes as the linear function g·x + d over a triangle, g in its plane (H99, section 3).

    corners (3, 3), values (3, K) at the corners; returns g (K, 3) and d (K,). Zero for a triangle without area.
    """
    e1, e2 = corners[1] - corners[0], corners[2] - corners[0]
    normal = np.cross(e1, e2)
    if not normal @ normal > 0:
        return np.zeros((values.shape[1], 3)), np.zeros(values.shape[1])
    g1, g2 = np.cross(e2, normal) / (normal @ normal), np.cross(normal, e1) / (normal @ normal)
    g = np.outer(values[1] - values[0], g1) + np.outer(values[2] - values[0], g2)
    return g, values[0] - g @ corners[0]


def attribute_quadric(corners: F64, values: F64) -> Quadric:
    """H99 over (x, s) in R^(3+K): squared distance of x to the plane + Σ (g·x + d − s)². Unweighted."""
    normal = normal_of(corners)
    width = values.shape[1]
    total = Quadric.of_plane(np.concatenate([normal, np.zeros(width)]), float(-normal @ corners[0]))
    for k, (g, d) in enumerate(zip(*gradients(corners, values), strict=True)):
        total += Quadric.of_plane(np.concatenate([g, -np.eye(width)[k]]), float(d))
    return total


def attribute_quadric_gh98(corners: F64, values: F64) -> Quadric:
    """GH98, section 3: squared distance in R^(3+K) to the plane through the corners, A = I − e₁e₁ᵀ − e₂e₂ᵀ. Unweighted.

    It measures at right angles in R^(3+K) where `attribute_quadric` measures along x and s apart, so it is never the
    larger; it needs all of A, where H99's rows for s are diagonal, and knows of one s at a vertex only.
    """
    p, q, r = np.hstack([corners, values])
    e1 = (q - p) / np.linalg.norm(q - p)
    e2 = r - p - (e1 @ (r - p)) * e1
    e2 /= np.linalg.norm(e2)
    A = np.eye(len(p)) - np.outer(e1, e1) - np.outer(e2, e2)
    return Quadric(A, (p @ e1) * e1 + (p @ e2) * e2 - p, float(p @ p - (p @ e1) ** 2 - (p @ e2) ** 2))


def normal_of(corners: F64) -> F64:
    """Unit normal; zeros for a triangle without area."""
    normal: F64 = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    length = float(np.linalg.norm(normal))
    return normal / length if length > 0 else np.zeros(3)


def area_of(corners: F64) -> float:
    """Area of a triangle (3, 3)."""
    return float(np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))) / 2


def quality_of(corners: F64) -> float:
    """2 · area / longest edge²."""
    longest = max(float(np.sum((corners[i] - corners[i - 1]) ** 2)) for i in range(3))
    return 2 * area_of(corners) / longest if longest > 0 else 0.0


# ---------------------------------------------------------------------------------------------- quadrics of a vertex


def plane_quadrics(
    positions: F64,
    faces: I32,
    options: QuadricOptions | None = None,
    *,
    wedges: I32 | None = None,
    seam_scale: F32 | None = None,
) -> list[Quadric]:
    """Of each vertex: the planes of its faces, and those that hold borders, seams and creases.

    positions (V, 3), faces (F, 3), wedges (F, 3) as for `lodpipe.kernel.decimate`; faces with two equal corners are
    left out. A face's plane weighs 1, area / 3 (G99), or area × angle / π. At an edge that is a discontinuity each
    face adds a plane through the edge, perpendicular to the face (GH97, section 6).
    """
    options = options or QuadricOptions()
    wedges = faces if wedges is None else wedges
    scale = np.ones(faces.shape) if seam_scale is None else seam_scale
    live = solid_faces(faces)
    total = [Quadric.zero() for _ in positions]
    for f in live:
        corners = positions[faces[f]]
        plane = Quadric.of_plane(normal_of(corners), float(-normal_of(corners) @ corners[0]))
        for k in range(3):
            if area_of(corners) > 0:
                total[faces[f, k]] += plane * _weight(corners, k, options)
    for (a, b), around in edges_of(faces, live).items():
        first = next(k for k in range(3) if {faces[around[0], k], faces[around[0], (k + 1) % 3]} == {a, b})
        held = replace(options, seam_weight=options.seam_weight * float(scale[around[0], first]))
        weight = _discontinuity(positions, faces, wedges, (a, b), around, held)
        if not weight > 0:
            continue
        along = positions[b] - positions[a]
        size = 1.0 if options.weighting == "uniform" else float(along @ along)
        for f in around:
            across = np.cross(along, normal_of(positions[faces[f]]))
            if across @ across > 0:
                across /= np.linalg.norm(across)
                plane = Quadric.of_plane(across, float(-across @ positions[a]), weight * size)
                total[a] += plane
                total[b] += plane
    return total


def _weight(corners: F64, k: int, options: QuadricOptions) -> float:
    if options.weighting == "uniform":
        return 1.0
    if options.weighting == "area":
        return area_of(corners) / 3
    e1, e2 = corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]
    cosine = e1 @ e2 / (np.linalg.norm(e1) * np.linalg.norm(e2))
    return area_of(corners) * float(np.arccos(np.clip(cosine, -1, 1))) / np.pi


def _discontinuity(
    positions: F64, faces: I32, wedges: I32, edge: tuple[int, int], around: list[int], options: QuadricOptions
) -> float:
    """The weight that holds an edge: an open border, a seam (also between more than two faces), a crease, or none."""
    if len(around) == 1:
        return options.boundary_weight
    if len(around) > 2:
        return options.seam_weight
    f, g = around
    if any(wedges[f][faces[f] == end] != wedges[g][faces[g] == end] for end in edge):
        return options.seam_weight
    turn = float(normal_of(positions[faces[f]]) @ normal_of(positions[faces[g]]))
    return options.crease_weight if turn < np.cos(np.radians(options.crease_degrees)) else 0.0


def solid_faces(faces: I32) -> list[int]:
    """Rows of the faces (F, 3) with three different corners."""
    return [f for f, corners in enumerate(faces) if len(set(corners.tolist())) == 3]


def edges_of(faces: I32, live: Sequence[int]) -> dict[tuple[int, int], list[int]]:
    """Edge (lower, higher vertex) -> its faces."""
    found: dict[tuple[int, int], list[int]] = {}
    for f in live:
        for a, b in combinations(sorted(faces[f].tolist()), 2):
            found.setdefault((a, b), []).append(f)
    return found


# ---------------------------------------------------------------------------------------------------------- minimum


def minimise(quadric: Quadric, p: F64, q: F64) -> F64:
    """The place of least error for merging p and q (GH97, section 5, with its fall-backs).

    The quadric's minimum, drawn a little to the middle; if that is singular or farther than `REACH` edge lengths from
    the middle, the best point of the segment; if the quadric is flat along it, the middle.
    """
    along, middle = q - p, (p + q) / 2
    x = damped_minimum(quadric, middle)
    if np.linalg.norm(x - middle) <= REACH * np.linalg.norm(along):
        return x
    curve = float(along @ quadric.A @ along)
    if curve <= 1e-12 * quadric.trace * float(along @ along):
        return middle
    slope = float(along @ (quadric.A @ p + quadric.b))
    return np.asarray(p + along * np.clip(-slope / curve, 0, 1), np.float64)


def damped_minimum(quadric: Quadric, toward: F64) -> F64:
    """Where E(x) + damping · |x − toward|² is least; infinity if there is no such place."""
    damping = DAMPING * quadric.trace
    A = quadric.A + damping * np.eye(3)
    if not np.linalg.det(A) > 0:
        return np.full(3, np.inf)
    return np.asarray(np.linalg.solve(A, damping * toward - quadric.b), np.float64)
