"""The other samples: a mug, a starfish, a grid of cubes, terrain, a buoy of two materials, a tiled ring."""

from __future__ import annotations

import numpy as np

from build import MIRROR, Ints, Part, asset, board
from implicit import F64
from lodpipe.core.asset import Asset


def sheet(rows: int, columns: int, close_rows: bool = False, close_columns: bool = False) -> tuple[Ints, F64]:
    """Faces (F, 3) and UV (F, 3, 2) of a grid of vertices, numbered row by row; its ends may be joined.

    u grows with the columns, v with the rows. Seen with the rows upwards and the columns to the right, faces are
    counter-clockwise.
    """
    down, across = rows - (not close_rows), columns - (not close_columns)
    i, j = (index.ravel() for index in np.indices((down, across)))
    corners = [(i, j), (i, j + 1), (i + 1, j + 1), (i + 1, j)]
    number = np.stack([(r % rows) * columns + c % columns for r, c in corners], axis=1)
    uv = np.stack([np.stack([c / across, r / down], axis=1) for r, c in corners], axis=1)
    faces = np.concatenate([number[:, [0, 1, 2]], number[:, [0, 2, 3]]])
    return faces, np.concatenate([uv[:, [0, 1, 2]], uv[:, [0, 2, 3]]])


def lathe(profile: F64, around: int) -> tuple[F64, Ints, F64]:
    """A closed solid: `profile` (N, 2) of (radius, height) turned about the y axis, its two ends on the axis.

    Positions, faces, and UV one to one, but for the two triangle fans at the ends, which use half of their squares.
    The profile runs with the inside on its left (an outer wall: upwards).
    """
    angle = np.arange(around) / around * 2 * np.pi
    rings = profile[1:-1]
    points = np.stack(
        [
            np.outer(rings[:, 0], np.sin(angle)),
            np.repeat(rings[:, 1:], around, 1),
            np.outer(rings[:, 0], np.cos(angle)),
        ],
        axis=2,
    ).reshape(-1, 3)
    ends = np.array([[0, profile[0, 1], 0], [0, profile[-1, 1], 0]])
    faces, uv = sheet(len(rings), around, close_columns=True)
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=1))])
    v = length / length[-1]
    uv[..., 1] = np.interp(uv[..., 1] * (len(rings) - 1), np.arange(len(rings)), v[1:-1])
    return _capped(points, ends, faces, uv, around, v[1], v[-2])


def _capped(
    points: F64, ends: F64, faces: Ints, uv: F64, around: int, first_v: float, last_v: float
) -> tuple[F64, Ints, F64]:
    """A tube of rings with a fan of triangles at either end, and v turned to point down."""
    j = np.arange(around)
    after, last, pole = (j + 1) % around, len(points) - around, len(points)
    low = np.stack([np.full(around, pole), after, j], axis=1)
    high = np.stack([np.full(around, pole + 1), last + j, last + after], axis=1)
    left, right, middle = j / around, (j + 1) / around, (j + 0.5) / around
    uv = np.concatenate([uv, _fan(middle, 0, right, left, first_v), _fan(middle, 1, left, right, last_v)])
    uv[..., 1] = 1 - uv[..., 1]
    return np.concatenate([points, ends]), np.concatenate([faces, low, high]), uv


def _fan(middle: F64, end: float, first: F64, second: F64, v: float) -> F64:
    tip, a, b = (np.stack([u, np.full(len(u), at)], axis=1) for u, at in ((middle, end), (first, v), (second, v)))
    return np.stack([tip, a, b], axis=1)


def tube(line: F64, radius: float, around: int, side: F64) -> tuple[F64, Ints, F64]:
    """A closed tube about `line` (N, 3), which lies in a plane with the normal `side`; UV one to one as for `lathe`."""
    along = np.gradient(line, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    out = np.cross(along, side)
    angle = np.arange(around) / around * 2 * np.pi
    ring = np.cos(angle)[None, :, None] * out[:, None] - np.sin(angle)[None, :, None] * side
    points = (line[:, None] + radius * ring).reshape(-1, 3)
    faces, uv = sheet(len(line), around, close_columns=True)
    uv[..., 1] = 0.04 + 0.92 * uv[..., 1]
    return _capped(points, line[[0, -1]], faces, uv, around, 0.04, 0.96)


def mug() -> Asset:
    """A mug with a hollow inside and a handle whose ends sit in the wall: two closed surfaces, 5,024 triangles."""
    wall = np.linspace(0.08, 0.95, 18)
    rim = [(0.49, 0.985), (0.465, 1.0), (0.44, 0.985)]
    profile = np.array(
        [(0, 0), (0.25, 0), (0.46, 0), (0.49, 0.03)]
        + [(0.5, y) for y in wall]
        + rim
        + [(0.43, y) for y in wall[::-1]]
        + [(0.4, 0.06), (0.2, 0.06), (0, 0.06)]
    )
    cup = lathe(profile, 48)
    t = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 25)
    line = np.stack([0.465 + 0.33 * np.cos(t), 0.5 + 0.3 * np.sin(t), 0 * t], axis=1)
    grip = tube(line, 0.055, 16, np.array([0.0, 0.0, 1.0]))
    uv = [cup[2] * (0.86, 1), grip[2] * (0.12, 1) + (0.88, 0)]  # the two side by side in one texture
    faces = np.concatenate([cup[1], grip[1] + len(cup[0])])
    texture = board(16, 16)
    return asset("mug", np.concatenate([cup[0], grip[0]]), [Part(faces, np.concatenate(uv), texture, "glaze")])


def starfish() -> Asset:
    """A starfish with five thin arms: closed, seen from above and below in two charts, 12,480 triangles."""
    around, rings = 160, 20
    angle = np.arange(around) / around * 2 * np.pi
    reach = 0.22 + 0.78 * np.abs(np.cos(2.5 * angle)) ** 2.2
    t = np.linspace(0, 1, rings + 1)[1:]
    top = [_star_ring(angle, reach, s, 0.16 * (1 - s**2) + 0.03 * np.sqrt(max(1 - s**2, 0))) for s in t]
    bottom = [_star_ring(angle, reach, s, -0.02 * np.sqrt(1 - s**2)) for s in t[-2::-1]]
    points = np.concatenate([[[0, 0.19, 0]], *top, *bottom, [[0, -0.02, 0]]])
    faces, _ = sheet(2 * rings - 1, around, close_columns=True)
    faces = faces[:, ::-1] + 1
    j = np.arange(around)
    after, last = (j + 1) % around, len(points) - 1
    upper = np.stack([np.zeros(around, int), 1 + j, 1 + after], axis=1)
    lower = np.stack([np.full(around, last), last - around + after, last - around + j], axis=1)
    above = np.concatenate([upper, faces[faces.max(axis=1) <= rings * around]])
    below = np.concatenate([faces[faces.max(axis=1) > rings * around], lower])
    flat = points[:, [0, 2]] * 0.24
    uv = np.concatenate([flat[above] + (0.25, 0.5), flat[below] * (-1, 1) + (0.75, 0.5)])
    return asset("starfish", points, [Part(np.concatenate([above, below]), uv, board(16, 16, tint=2), "skin")])


def _star_ring(angle: F64, reach: F64, share: float, height: float) -> F64:
    far = share * reach
    # the ridge of an arm is high, the web between two arms low
    lift = height * (0.35 + 0.65 * reach) if height > 0 else np.full(len(angle), height)
    return np.stack([far * np.sin(angle), np.broadcast_to(lift, angle.shape), far * np.cos(angle)], axis=1)


def cubes() -> Asset:
    """10 × 10 cubes with gaps of a tenth of their size, each with its own number: 1,200 triangles."""
    corner = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)]) * 0.1
    quads = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]])
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    square = np.array([[0, 1], [1, 1], [1, 0], [0, 0]])
    uv = np.concatenate([np.tile(square[[0, 1, 2]], (6, 1, 1)), np.tile(square[[0, 2, 3]], (6, 1, 1))])
    row, column = np.divmod(np.arange(100), 10)
    offset = np.stack([column, np.zeros(100), row], axis=1) * 0.11
    points = (corner[None] + offset[:, None]).reshape(-1, 3)
    every_face = (faces[None] + 8 * np.arange(100)[:, None, None]).reshape(-1, 3)
    cells = (uv[None] * 0.96 + 0.02 + np.stack([column, row], axis=1)[:, None, None]).reshape(-1, 3, 2) / 10
    return asset("cubes", points, [Part(every_face, cells, board(10, 10, 96), "numbers")])


def terrain() -> Asset:
    """A patch of hills with an open border: 8,192 triangles."""
    side = 65
    z, x = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side), indexing="ij")
    height = (
        0.16 * np.sin(2.3 * x + 0.5) * np.cos(1.9 * z)
        + 0.07 * np.sin(5.1 * x - 3.7 * z)
        + 0.03 * np.sin(11 * z + 7 * x)
    )
    faces, uv = sheet(side, side)
    return asset(
        "terrain",
        np.stack([x, height, z], axis=2).reshape(-1, 3),
        [Part(faces[:, ::-1], uv[:, ::-1], board(16, 16), "map")],
    )


def buoy() -> Asset:
    """A closed solid of two materials that meet along a ring, each with a seam in its UV: 3,648 triangles."""
    t = np.linspace(0, np.pi, 28)
    lower = [(0.5 * np.sin(a), -0.5 * np.cos(a)) for a in t[:20]]
    neck = [(0.18 - 0.1 * s, 0.52 + 0.6 * s) for s in np.linspace(0, 1, 18)]
    profile = np.array([*lower, (0.3, 0.42), *neck, (0.0, 1.16)])
    profile[0] = 0, -0.5
    points, faces, uv = lathe(profile, 48)
    upper = points[faces, 1].mean(axis=1) > 0.15
    parts = [
        Part(faces[~upper], uv[~upper] * (3, 2), board(4, 4, 64), "hull"),
        Part(faces[upper], uv[upper] * (2, 2), board(4, 4, 64, first=50, tint=3), "mast"),
    ]
    return asset("buoy", points, parts)


def ring() -> Asset:
    """A ring whose texture is tiled (UV far outside 0…1), and mirrored on its second half: 4,608 triangles."""
    around, across = 96, 24
    u, v = np.meshgrid(np.arange(around) / around * 2 * np.pi, np.arange(across) / across * 2 * np.pi, indexing="ij")
    far = 0.7 + 0.28 * np.cos(v)
    points = np.stack([far * np.sin(u), 0.28 * np.sin(v), far * np.cos(u)], axis=2).reshape(-1, 3)
    faces, uv = sheet(around, across, close_rows=True, close_columns=True)
    faces, uv = faces[:, ::-1], uv[:, ::-1, ::-1] * (8, -3) + (-4, 2)  # −4…4 around, 2…−1 across
    half = uv[..., 0].mean(axis=1) < 0
    uv[half] *= (-1, 1)
    parts = [
        Part(faces[~half], uv[~half], board(4, 4, 64), "tiles"),
        Part(faces[half], uv[half], board(4, 4, 64, tint=1), "mirrored tiles", MIRROR),
    ]
    return asset("ring", points, parts)
