"""Tiny named meshes that tests draw on, as (positions (V, 3) float64, faces (F, 3) int32), or `Textured`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lodpipe.core.mesh import Mesh, Primitive


def grid(n: int = 1, height: float = 0.0):
    """The unit square in z = `height`, n × n cells of two triangles, seen from above."""
    step = np.linspace(0.0, 1.0, n + 1)
    x, y = np.meshgrid(step, step, indexing="ij")
    at = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (v.ravel() for v in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, height)], axis=1), faces.astype(np.int32)


def box(size: float = 1.0):
    """A cube about the origin, 8 corners and 12 triangles."""
    corners = np.array([[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)]) * size
    quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    faces = [[q[0], q[i], q[i + 1]] for q in quads for i in (1, 2)]
    return corners, np.array(faces, np.int32)


def sphere(divisions: int = 3, radius: float = 1.0):
    """An octahedron, each triangle divided in four `divisions` times, pushed out onto the sphere."""
    points = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    for _ in range(divisions):
        ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        edges, row = np.unique(ends, axis=0, return_inverse=True)
        ab, bc, ca = (row.reshape(3, -1) + len(points)).reshape(3, -1)
        points = np.concatenate([points, points[edges].mean(axis=1)])
        a, b, c = faces.T
        faces = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
        points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points * radius, faces.astype(np.int32)


def tetrahedron():
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], float)
    return corners, np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], np.int32)


def octahedron():
    return sphere(0)


def triangle():
    return np.eye(3), np.array([[0, 1, 2]], np.int32)


def folded(n: int = 8, degrees: float = 90.0):
    """A square sheet with one sharp fold along x = ½: `degrees` is the turn of its normal there."""
    positions, faces = grid(n)
    right, turn = np.maximum(positions[:, 0] - 0.5, 0), np.radians(degrees)
    positions[:, 0] = np.minimum(positions[:, 0], 0.5) + right * np.cos(turn)
    positions[:, 2] = right * np.sin(turn)
    return positions, faces


def terrain(n: int = 16, height: float = 0.1):
    """An open patch of hills that fall to 0 at the square's outline."""
    positions, faces = grid(n)
    x, y = positions[:, 0], positions[:, 1]
    hills = np.sin(11 * x + 1) * np.cos(9 * y) + 0.5 * np.sin(23 * x * y + 2)
    positions[:, 2] = height * hills * np.minimum(1, 8 * np.minimum(np.minimum(x, 1 - x), np.minimum(y, 1 - y)))
    return positions, faces


def torus(n: int = 24, m: int = 12, thickness: float = 0.35):
    """A ring about the z axis, radius 1; n steps round it, m round its tube."""
    around, tube = (np.arange(k) * 2 * np.pi / k for k in (n, m))
    a, t = (x.ravel() for x in np.meshgrid(around, tube, indexing="ij"))
    r = 1 + thickness * np.cos(t)
    at = np.arange(n * m).reshape(n, m)
    right, up = np.roll(at, -1, 0), np.roll(at, -1, 1)
    both = np.roll(right, -1, 1)
    faces = np.concatenate([np.stack([x.ravel() for x in f], 1) for f in ((at, right, both), (at, both, up))])
    return np.stack([r * np.cos(a), r * np.sin(a), thickness * np.sin(t)], axis=1), faces.astype(np.int32)


def moebius(n: int = 48, m: int = 4):
    """A strip with half a turn: one side, one border, and an edge across at which the winding changes."""
    a, t = (x.ravel() for x in np.meshgrid(np.arange(n) * 2 * np.pi / n, np.linspace(-0.4, 0.4, m + 1), indexing="ij"))
    r = 1 + t * np.cos(a / 2)
    at = np.arange(n * (m + 1)).reshape(n, m + 1)
    after = np.concatenate([at[1:], at[:1, ::-1]])
    quads = [x.ravel() for x in (at[:, :-1], after[:, :-1], after[:, 1:], at[:, 1:])]
    faces = np.concatenate([np.stack([quads[i] for i in t], axis=1) for t in ((0, 1, 2), (0, 2, 3))])
    return np.stack([r * np.cos(a), r * np.sin(a), t * np.sin(a / 2)], axis=1), faces.astype(np.int32)


def book():
    """Four faces on one edge."""
    pages = [[np.cos(a), np.sin(a), 0.5] for a in np.arange(4) * np.pi / 2]
    return np.array([[0, 0, 0], [0, 0, 1], *pages], float), np.array([[0, 1, k] for k in (2, 3, 4, 5)], np.int32)


def bow_tie():
    """Two triangles that share one vertex."""
    points = np.array([[0, 0, 0], [-1, -1, 0], [-1, 1, 0], [1, -1, 0], [1, 1, 0]], float)
    return points, np.array([[0, 2, 1], [0, 3, 4]], np.int32)


def hourglass(divisions: int = 2):
    """Two spheres that share one vertex."""
    points, faces = sphere(divisions)
    top, bottom = int(points[:, 2].argmax()), int(points[:, 2].argmin())
    upper = points - points[bottom]
    number = np.where(np.arange(len(points)) == bottom, top, np.arange(len(points)) + len(points))
    return np.concatenate([points - points[top], upper]), np.concatenate([faces, number[faces].astype(np.int32)])


def messy():
    """A bumpy sphere with doubled, turned over, collapsed and needle-like faces, doubled and unused positions."""
    points, faces = sphere(2)
    count = len(points)
    points = np.concatenate([points, points[:5], [[0.1, 0.2, 0.3], [0, 0, 0.5]]])
    bad = [
        faces[0],
        faces[0],
        faces[1][::-1],
        [3, 3, 7],
        [5, 5, 5],
        [0, count, 4],
        [2, count + 2, 9],
        [1, 8, count + 6],
    ]
    faces = np.concatenate([faces, np.array(bad, np.int32)])
    faces[40] = [count + 3 if v == 3 else v for v in faces[40]]
    return points, faces


def cone(n: int = 2000):
    """A fan about one vertex of n edges, closed below by another."""
    a = np.arange(n) * 2 * np.pi / n
    rim = np.stack([np.cos(a), np.sin(a), np.zeros(n)], axis=1)
    i = np.arange(n)
    here, after, tip, foot = i + 2, (i + 1) % n + 2, np.zeros(n, int), np.ones(n, int)
    faces = np.concatenate([np.stack([tip, here, after], axis=1), np.stack([foot, after, here], axis=1)])
    return np.concatenate([[[0, 0, 1], [0, 0, 0]], rim]), faces.astype(np.int32)


def cubes(n: int = 10, gap: float = 0.2):
    """n × n cubes of side 1 − gap, one unit from middle to middle (Garland & Heckbert 1997, figure 3)."""
    corners, faces = box(1 - gap)
    places = [(x, y, 0) for x in range(n) for y in range(n)]
    return (
        np.concatenate([corners + place for place in places]),
        np.concatenate([faces + 8 * i for i in range(len(places))]).astype(np.int32),
    )


def bumpy(divisions: int = 3, height: float = 0.1, seed: int = 0):
    """A sphere whose vertices lie at random heights: nothing on it is equal or flat."""
    points, faces = sphere(divisions)
    return points * (1 + height * np.random.default_rng(seed).random((len(points), 1))), faces


@dataclass(frozen=True)
class Textured:
    """A mesh with wedges: attributes (W, K) float32 by name, and the primitive of each face."""

    positions: np.ndarray
    faces: np.ndarray
    wedges: np.ndarray
    attributes: dict[str, np.ndarray]
    face_primitive: np.ndarray

    @property
    def values(self):
        """All attributes beside each other, as the kernel takes them."""
        return np.concatenate(list(self.attributes.values()), axis=1)

    def mesh(self, **more) -> Mesh:
        count = int(self.face_primitive.max(initial=0)) + 1
        materials = tuple(Primitive(i, tuple(self.attributes)) for i in range(count))
        return Mesh(self.positions, self.faces, self.wedges, self.attributes, self.face_primitive, materials, **more)


def sphere_attributes(direction, u=None):
    """UVs, normals and colours of a `uv_sphere` at the unit vectors `direction` (…, 3); `u` where that is ambiguous."""
    x, y, z = np.moveaxis(direction, -1, 0)
    u = np.arctan2(y, x) / (2 * np.pi) % 1 if u is None else u
    uv = np.stack([u, np.arccos(np.clip(z, -1, 1)) / np.pi], axis=-1)
    color = np.concatenate([direction * 0.5 + 0.5, np.ones((*direction.shape[:-1], 1))], axis=-1)
    return {"TEXCOORD_0": uv, "NORMAL": direction, "COLOR_0": color}


def uv_sphere(rows: int = 16, columns: int = 32, materials: int = 1) -> Textured:
    """A unit sphere with a UV seam from pole to pole; with two materials the lower half has the second.

    Poles have a wedge for each of their faces, the seam two, and so have positions on the border of the materials.
    """
    t, s = np.linspace(0, np.pi, rows + 1), np.arange(columns) * 2 * np.pi / columns
    body = np.stack(
        [np.outer(np.sin(t), np.cos(s)), np.outer(np.sin(t), np.sin(s)), np.outer(np.cos(t), np.ones(columns))], -1
    )
    positions = np.concatenate([[[0, 0, 1.0]], body[1:-1].reshape(-1, 3), [[0, 0, -1.0]]])
    i, j = (x.ravel() for x in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"))
    quad = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
    corners = np.concatenate([np.stack([np.stack(quad[k], -1) for k in t], 1) for t in ((0, 1, 2), (0, 2, 3))])
    last = np.isin(corners[..., 0], (0, rows))
    flat = np.concatenate([i == rows - 1, i == 0])  # the half of a cell that a pole makes vanish
    corners, last = corners[~flat], last[~flat]
    row, column = corners[..., 0], corners[..., 1]
    vertex = np.where(
        row == 0, 0, np.where(row == rows, len(positions) - 1, 1 + (row - 1) * columns + column % columns)
    )
    u = column / columns
    at_pole = np.where(last, (column.min(axis=1, keepdims=True) + 0.5) / columns, u)
    primitive = (row.max(axis=1) > rows // 2).astype(np.int32) if materials == 2 else np.zeros(len(row), np.int32)
    keys = np.stack([vertex, np.rint(at_pole * 2 * columns), np.broadcast_to(primitive[:, None], vertex.shape)], -1)
    _, first, wedges = np.unique(keys.reshape(-1, 3), axis=0, return_index=True, return_inverse=True)
    attributes = sphere_attributes(positions[vertex].reshape(-1, 3)[first], at_pole.ravel()[first])
    return Textured(
        positions,
        vertex.astype(np.int32),
        wedges.reshape(-1, 3).astype(np.int32),
        {name: values.astype(np.float32) for name, values in attributes.items()},
        primitive,
    )


def seam_cylinder(columns: int = 32, rows: int = 16, tiles: float = 3.0) -> Textured:
    """An open tube, radius 1, height 2; its texture goes round it `tiles` times: u from 0 to `tiles`, one seam."""
    s, t = np.meshgrid(np.arange(columns + 1) / columns, np.arange(rows + 1) / rows, indexing="ij")
    around = 2 * np.pi * s.ravel()
    positions = np.stack([np.cos(around), np.sin(around), 2 * t.ravel()], axis=1)[: columns * (rows + 1)]
    at = np.arange((columns + 1) * (rows + 1)).reshape(columns + 1, rows + 1)
    quad = [x.ravel() for x in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:])]
    wedges = np.concatenate([np.stack([quad[k] for k in t], 1) for t in ((0, 1, 2), (0, 2, 3))]).astype(np.int32)
    uv = np.stack([tiles * s.ravel(), t.ravel()], axis=1).astype(np.float32)
    return Textured(positions, wedges % len(positions), wedges, {"TEXCOORD_0": uv}, np.zeros(len(wedges), np.int32))


def islands(positions, faces) -> Textured:
    """Every face a UV island of its own: each corner has its own wedge."""
    uv = np.array([[0, 0], [1, 0], [0, 1]], np.float32)
    cell = np.stack(np.divmod(np.arange(len(faces)), 64), axis=1).astype(np.float32)
    values = (uv[None] + cell[:, None] * 2).reshape(-1, 2) / 128
    wedges = np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3)
    return Textured(positions, faces, wedges, {"TEXCOORD_0": values}, np.zeros(len(faces), np.int32))
