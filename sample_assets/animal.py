"""A pig-like animal: one closed surface with a thin curly tail, hooves, ears and two nostrils, in a striped atlas."""

from __future__ import annotations

import numpy as np

from implicit import F64, Field, capsule, cylinder, ellipsoid, polygonise, turned, union, without

TURNS, COIL, TAIL = 1.4, 0.085, 0.030
"""The tail: turns of its curl, the curl's radius, its thickness (radius)."""


def tail_line(count: int = 40) -> F64:
    """(count, 3): the middle of the tail, from inside the body to its tip."""
    t = np.linspace(0, 1, count)
    angle = 2 * np.pi * TURNS * np.clip((t - 0.2) / 0.8, 0, 1)
    grown = COIL * np.clip(t / 0.3, 0, 1)
    return np.stack([grown * np.sin(angle), 0.76 - grown * np.cos(angle), -0.52 - 0.4 * t], axis=1)


def tail(p: F64) -> F64:
    """The distance to the tail, which grows thinner towards its tip."""
    line = tail_line()
    result = np.full(len(p), np.inf)
    near = np.flatnonzero(p[:, 2] < -0.4)
    thickness = np.linspace(TAIL, 0.8 * TAIL, len(line))
    best = np.full(len(near), np.inf)
    for a, b, radius in zip(line[:-1], line[1:], thickness[:-1], strict=True):
        best = np.minimum(best, capsule(a, b, radius)(p[near]))
    result[near] = best
    result[p[:, 2] >= -0.4] = p[p[:, 2] >= -0.4, 2] + 0.5
    return result


def body() -> Field:
    """The whole animal: nose towards +z, feet on y = 0, about 2 long and 1.1 high."""
    legs = [capsule((x, 0.55, z), (x, 0.1, z), 0.12, 0.085) for x in (-0.19, 0.19) for z in (-0.34, 0.32)]
    ears = [
        turned(ellipsoid((x, 1.04, 0.5), (0.11, 0.16, 0.06)), (x, 1.0, 0.5), (25, 0, -150 * x)) for x in (-0.17, 0.17)
    ]
    torso = [ellipsoid((0, 0.64, 0), (0.34, 0.34, 0.62)), ellipsoid((0, 0.8, 0.56), (0.25, 0.25, 0.27)), *legs]
    snout = cylinder((0, 0.75, 0.86), 2, 0.16, 0.125, 0.035)
    hooves = [cylinder((x, 0.065, z), 1, 0.065, 0.112, 0.02) for x in (-0.19, 0.19) for z in (-0.34, 0.32)]
    soft = union([union(torso, 0.14), *ears, snout], 0.06)
    whole = union([soft, *hooves, tail], 0.02)
    nostrils = [capsule((x, 0.755, 0.95), (x, 0.755, 1.1), 0.034) for x in (-0.055, 0.055)]
    return without(whole, union(nostrils, 0.005), 0.012)


def spaced(start: float, *stretches: tuple[float, float]) -> F64:
    """Grid planes from `start` on: for each stretch (end, spacing) evenly up to its end."""
    planes = [np.array([start])]
    for end, spacing in stretches:
        begin = planes[-1][-1]
        count = max(round((end - begin) / spacing), 1)
        planes.append(np.linspace(begin, end, count + 1)[1:])
    return np.concatenate(planes)


def planes() -> list[F64]:
    """A grid that is fine where the tail curls, at the snout and at the hooves."""
    x = spaced(0, (0.13, 0.0265), (0.42, 0.042))
    y = spaced(-0.06, (0.2, 0.034), (0.61, 0.053), (0.9, 0.0295), (1.3, 0.039))
    z = spaced(-1.06, (-0.56, 0.025), (0.92, 0.064), (1.1, 0.029))
    return [np.concatenate([-x[:0:-1], x]), y, z]


def animal_mesh() -> tuple[F64, np.ndarray[tuple[int, int], np.dtype[np.int32]]]:
    """Positions (V, 3) and faces (F, 3)."""
    return polygonise(body(), planes())


def colour(p: F64) -> F64:
    """sRGB (N, 3) at points on the animal: stripes with a row of checks, hooves, eyes, snout."""
    x, y, z = p.T
    stripe = np.floor(z * 11).astype(int) % 2
    check = (np.floor(z * 33).astype(int) + np.floor(y * 33).astype(int)) % 2
    skin, dark, pale = np.array([0.95, 0.72, 0.66]), np.array([0.55, 0.24, 0.28]), np.array([0.99, 0.94, 0.86])
    result = np.where(stripe[:, None] == 1, dark, skin)
    band = (np.abs(y - 0.66) < 0.075) & (z < 0.42)
    result[band] = np.where(check[band, None] == 1, dark, pale)
    result[z > 0.74] = skin
    result[y < 0.13] = (0.16, 0.13, 0.12)
    result[(z < -0.62)] = np.where((np.floor(z[z < -0.62] * 40).astype(int) % 2)[:, None] == 1, dark, pale)
    result[z > 0.985] = (0.93, 0.55, 0.55)
    result[(np.hypot(np.abs(x) - 0.055, y - 0.755) < 0.034) & (z > 0.93)] = (0.25, 0.08, 0.1)
    eye = np.linalg.norm(np.stack([np.abs(x) - 0.125, y - 0.9, z - 0.765], axis=1), axis=1)
    result[eye < 0.055] = (1, 1, 1)
    result[eye < 0.03] = (0.05, 0.05, 0.08)
    return result
