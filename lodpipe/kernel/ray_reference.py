"""Rays, samples, colours and UV overlaps of the similarity decimator in plain NumPy: parts of `similarity_reference`.

Sections are those of Liao 2004, "Mesh simplification with geometry and material preserving".
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.mesh import F64, I32
from lodpipe.kernel.similarity import Appearance, Look

I64 = NDArray[np.int64]

MISSING = 0.5
"""Half of the brightest light, where a ray meets nothing."""
INSET = 0.98
"""Samples are drawn towards their triangle's middle by this factor."""


@dataclass
class Surface:
    """Triangles: corners (T, 3, 3), what is at them (T, 3, 7: normal, u, v, tint, alpha), and looks (T,)."""

    corners: F64
    at: F64
    look: I32


def intersect(origin: F64, directions: F64, corners: F64, low: F64, high: F64) -> tuple[F64, I32, F64]:
    """The nearest triangle (T, 3, 3) that each ray (N, 3) meets with low ≤ t ≤ high: t, triangle or −1, weights (N, 3).

    With the corners as seen from the origin, a, b, c: a ray is inside where d·(b × c), d·(c × a) and d·(a × b) have one
    sign, and t = a·(b × c) / their sum.
    """
    count = len(directions)
    if not len(corners):
        return np.full(count, np.inf), np.full(count, -1, np.int32), np.zeros((count, 3))
    a, b, c = (corners[:, k] - origin for k in range(3))
    planes = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    volume = np.einsum("tk,tk->t", a, planes[:, 0])
    inside = np.einsum("tjk,nk->ntj", planes, directions) * np.sign(volume)[:, None]
    total = inside.sum(axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.abs(volume) / total
        hit = (inside >= -1e-5 * total[..., None]).all(axis=2) & (np.abs(volume) > 1e-20) & (total > 0)
    hit &= (t >= low[:, None]) & (t <= high[:, None])
    t = np.where(hit, t, np.inf)
    nearest = t.argmin(axis=1)
    rows = np.arange(count)
    found = hit[rows, nearest]
    weights = inside[rows, nearest] / np.where(found, total[rows, nearest], 1.0)[:, None]
    return t[rows, nearest], np.where(found, nearest, -1).astype(np.int32), weights


def hemisphere(count: int, axis: F64) -> F64:
    """(count, 3): unit vectors spread evenly over the hemisphere round `axis`, from the top down (section 3.2.1)."""
    i = np.arange(count) + 0.5
    height = 1 - i / count
    level, turn = np.sqrt(1 - height**2), np.pi * (1 + 5**0.5) * i
    sign = np.copysign(1.0, axis[2])
    a = -1 / (sign + axis[2])
    b = axis[0] * axis[1] * a
    u = np.array([1 + sign * axis[0] ** 2 * a, sign * b, -sign * axis[0]])
    v = np.array([b, sign + axis[1] ** 2 * a, -axis[1]])
    return np.outer(level * np.cos(turn), u) + np.outer(level * np.sin(turn), v) + np.outer(height, axis)


def scan_lines(corners: F64, step: float) -> F64:
    """(N, 3): the points of scan lines over a triangle, parallel to its first edge (section 3.2.2)."""
    a, b, c = corners
    normal = np.cross(b - a, c - a)
    width, doubled = float(np.linalg.norm(b - a)), float(np.linalg.norm(normal))
    if not doubled > 1e-12 * ((b - a) @ (b - a) + (c - a) @ (c - a)):
        return np.empty((0, 3))
    i = (b - a) / width
    j = np.cross(normal / doubled, i)
    height, across = doubled / width, float((c - a) @ i)
    points = []
    for y in np.arange(int((height + 1e-9 * step) // step) + 1) * step:
        left, right = across * y / height, width + (across - width) * y / height
        while left <= right + 1e-9 * step:
            points.append(a + left * i + y * j)
            left += step
    middle = corners.mean(axis=0)
    inset: F64 = middle + (np.array(points) - middle) * INSET
    return inset


def colours(surface: Surface, appearance: Appearance, triangle: I32, weights: F64, directions: F64) -> F64:
    """Cost(R, M), (3.1): luminance at hits (N,), lit from where the rays come from; MISSING where there is none.

    Both sides of a face are lit: its winding does not tell in every model which one is looked at.
    """
    out = np.full(len(triangle), MISSING)
    for row, look in enumerate(appearance.looks):
        n = np.flatnonzero(
            (triangle >= 0) & (surface.look[np.maximum(triangle, 0)] == row if len(surface.look) else False)
        )
        if not len(n):
            continue
        corners, rays = surface.corners[triangle[n]], directions[n]
        values = np.einsum("nk,nkj->nj", weights[n], surface.at[triangle[n]])
        flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal = np.where((values[:, :3] ** 2).sum(axis=1)[:, None] > 1e-12, values[:, :3], flat)
        length = np.linalg.norm(normal, axis=1) * np.linalg.norm(rays, axis=1)
        facing = np.abs((normal * rays).sum(axis=1)) / length
        texel = _texels(appearance, look, values[:, 3:5])
        alpha = texel[:, 1] * look.alpha * values[:, 6]
        if look.cutoff is not None:
            alpha = (alpha >= look.cutoff).astype(float)
        alpha = np.clip(alpha, 0, 1)
        lit = np.clip(texel[:, 0] * look.luminance * values[:, 5], 0, 1) * np.minimum(facing, 1.0)
        out[n] = alpha * lit + (1 - alpha) * MISSING
    return out


def _texels(appearance: Appearance, look: Look, uv: F64) -> F64:
    """(N, 2): luminance and alpha of the look's image at (N, 2), bilinear."""
    if look.image is None or look.uv_column is None:
        return np.ones((len(uv), 2))
    image = appearance.images[look.image]
    size = np.array(image.texels.shape[1::-1])
    at = uv * size - 0.5
    if image.nearest:
        at = np.floor(at + 0.5)
    low = np.floor(at).astype(np.int64)
    part = at - low

    def wrapped(i: I64, length: int, mode: str) -> I64:
        if mode == "clamp":
            return np.clip(i, 0, length - 1)
        folded = i % (2 * length) if mode == "mirror" else i % length
        return np.minimum(folded, 2 * length - 1 - folded) if mode == "mirror" else folded

    result = np.zeros((len(uv), 2))
    for dx, dy in product((0, 1), (0, 1)):
        columns, rows = (wrapped(low[:, k] + d, int(size[k]), image.wrap[k]) for k, d in ((0, dx), (1, dy)))
        share = np.abs(1 - dx - part[:, 0]) * np.abs(1 - dy - part[:, 1])
        result += share[:, None] * image.texels[rows, columns] / 255.0
    return result


def within(origin: F64, rays: F64, radius: float) -> tuple[F64, F64]:
    """Least and most t at which rays from `origin` are within a sphere about the origin of coordinates."""
    a, b, c = (rays**2).sum(axis=1), rays @ origin, origin @ origin - radius**2
    root = np.sqrt(np.maximum(b * b - a * c, 0))
    return (-b - root) / a, (-b + root) / a


def barycentric(point: F64, triangle: F64) -> F64:
    """(3,) weights of a point (2,) in a triangle (3, 2) of the plane."""
    matrix = np.vstack([triangle.T, np.ones(3)])
    return np.linalg.solve(matrix, [*point, 1.0])


def is_flat(triangle: F64) -> bool:
    """Whether a triangle (3, 2) of the plane has no area."""
    (a, b), (c, d) = triangle[1] - triangle[0], triangle[2] - triangle[0]
    return not abs(a * d - b * c) > 1e-10 * float(np.ptp(triangle, axis=0).max()) ** 2


def common(a: F64, b: F64) -> F64:
    """(N, 2): corners of what two triangles (3, 2) share: corners of one inside the other, and crossings of edges.

    Empty if they only touch.
    """
    if is_flat(a) or is_flat(b):
        return np.empty((0, 2))
    points = [p for one, other in ((a, b), (b, a)) for p in one if barycentric(p, other).min() >= -1e-12]
    for i, j in product(range(3), range(3)):
        p, d, q, e = a[i], a[i - 1] - a[i], b[j], b[j - 1] - b[j]
        det = d[0] * e[1] - d[1] * e[0]
        if abs(det) > 1e-15:
            s, t = np.linalg.solve(np.stack([d, -e], axis=1), q - p)
            if -1e-12 <= s <= 1 + 1e-12 and -1e-12 <= t <= 1 + 1e-12:
                points.append(p + s * d)
    if len(points) < 3:
        return np.empty((0, 2))
    found = np.array(points)
    middle = found - found.mean(axis=0)
    turn: NDArray[np.float64] = found[np.argsort(np.arctan2(middle[:, 1], middle[:, 0]))]
    x, y = turn.T
    area = abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))

    def doubled(t: F64) -> float:
        (u, v), (s, w) = t[1] - t[0], t[2] - t[0]
        return abs(float(u * w - v * s))

    return found if area > 1e-6 * min(doubled(a), doubled(b)) else np.empty((0, 2))
