"""Pictures of a model, by casting a ray through each pixel.

For looking at results and for measuring what is seen: base colour under two fixed lights, no shadows, no reflections.
Colours are worked on in linear light and stored as sRGB.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.mesh import F32, I32
from lodpipe.geometry.camera import Camera
from lodpipe.geometry.surface import Model, Spots
from lodpipe.geometry.texture import U8, to_linear, to_srgb

LIGHT = (0.93, 0.93, 0.93)
DARK = (0.08, 0.08, 0.09)
"""Backgrounds, sRGB 0…1."""

CLAY = 0.45
"""Linear grey of untextured pictures."""
WIRE = np.array([0.004, 0.004, 0.012], np.float32)
"""Linear colour of wires."""
KEY = (-0.5, 0.65, 0.57)
"""Where the second light comes from: right, up and back of the camera."""

MAX_LAYERS = 24
"""Surfaces that a ray is followed through."""
STEP = 2e-5
"""How far behind a surface a ray goes on, in radii."""
BATCH = 1 << 18
"""Rays followed at once, which bounds the memory of a picture of any size to about 200 MB."""

Mode = Literal["shaded", "clay"]


@dataclass(frozen=True)
class Buffers:
    """What lies under each pixel's centre; masked holes are looked through, glass is not.

    hit      (H, W) bool: the silhouette
    depth    (H, W) float32 distance from the camera along the ray, in world units; infinity if none
    normals  (H, W, 3) float32 unit shading normals in world space, on the seen side; zero if none
    faces    (H, W) int32 rows of the model's faces, −1 if none
    """

    hit: NDArray[np.bool_]
    depth: F32
    normals: F32
    faces: I32


def render(
    model: Model,
    camera: Camera,
    width: int = 512,
    height: int = 512,
    *,
    mode: Mode = "shaded",
    background: tuple[float, float, float] | None = LIGHT,
    supersample: int = 2,
    wireframe: bool = False,
    cull: bool = False,
) -> U8:
    """A picture (height, width, 3) uint8 of sRGB values, or (height, width, 4) with alpha if `background` is None.

    mode         shaded: colours and textures as the materials say; clay: grey, with normals made from the triangles
    supersample  rays along each side of a pixel
    wireframe    draw the triangles' edges over the picture
    cull         do not draw the backs of single-sided materials; otherwise every face has two sides
    """
    columns, lines = width * supersample, height * supersample
    picture = np.empty((height, width, 3 if background is not None else 4), np.uint8)
    step = max(BATCH // (columns * supersample), 1)
    for top in range(0, height, step):
        rows = slice(top, min(top + step, height))
        fine = slice(rows.start * supersample, rows.stop * supersample)
        premultiplied = _band(model, camera, columns, lines, fine, mode, supersample if wireframe else 0, cull)
        shape = (rows.stop - rows.start, supersample, width, supersample, 4)
        picture[rows] = _finished(premultiplied.reshape(shape).mean(axis=(1, 3), dtype=np.float32), background)
    return picture


def buffers(model: Model, camera: Camera, width: int = 512, height: int = 512, cull: bool = False) -> Buffers:
    """Silhouette, depth, normals and face numbers as data."""
    hit = np.zeros(width * height, bool)
    depth = np.full(width * height, np.inf, np.float32)
    normals = np.zeros((width * height, 3), np.float32)
    faces = np.full(width * height, -1, np.int32)
    step = max(BATCH // width, 1)
    for top in range(0, height, step):
        rows = slice(top, min(top + step, height))
        for layer in _layers(model, camera, width, height, rows, only_alpha=True, cull=cull):
            first = np.flatnonzero((layer.rgba[:, 3] > 0) & ~hit[layer.rays + rows.start * width])
            at = layer.rays[first] + rows.start * width
            spots = layer.spots.take(first)
            hit[at] = True
            depth[at] = layer.distance[first] * np.float32(model.radius)
            normals[at] = model.shading_normals(spots)
            faces[at] = spots.faces
    shape = (height, width)
    return Buffers(hit.reshape(shape), depth.reshape(shape), normals.reshape(*shape, 3), faces.reshape(shape))


def normal_picture(seen: Buffers, camera: Camera) -> U8:
    """Normals as colours (H, W, 3) uint8: x, y, z to the camera's right, up and back as red, green, blue."""
    turned = seen.normals @ np.stack(camera.axes).astype(np.float32).T
    colours = np.where(seen.hit[..., None], turned * 0.5 + 0.5, 0.5)
    return _bytes(np.clip(colours, 0.0, 1.0).astype(np.float32))


def depth_picture(seen: Buffers) -> U8:
    """Depth as grey (H, W, 3) uint8: the nearest point white, the farthest dark, nothing black."""
    near = np.where(seen.hit, seen.depth, np.nan)
    low, high = (np.nanmin(near), np.nanmax(near)) if seen.hit.any() else (0.0, 1.0)
    grey = np.where(seen.hit, 1 - 0.85 * (seen.depth - low) / max(high - low, 1e-30), 0.0)
    return np.repeat(np.rint(np.nan_to_num(grey) * 255).astype(np.uint8)[..., None], 3, axis=2)


def silhouette_picture(seen: Buffers) -> U8:
    """The silhouette (H, W, 3) uint8, black on white."""
    return np.repeat(np.where(seen.hit, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


@dataclass(frozen=True)
class _Layer:
    """The next surface that some of a band's rays meet: (N,) rows of the band's rays, and what is there."""

    rays: NDArray[np.int64]
    spots: Spots
    distance: F32
    rgba: F32
    """Linear base colour, and how much of it covers what lies behind."""


def _layers(
    model: Model, camera: Camera, width: int, height: int, rows: slice, *, only_alpha: bool = False, cull: bool = False
) -> Iterator[_Layer]:
    """The surfaces that the rays through the pixels of `rows` meet, front to back, until nothing shines through."""
    origins, directions = camera.rays(width, height, rows, model.centre, model.radius)
    constant, growing = camera.pixel_size(height, model.radius)
    rays = np.arange(len(origins))
    gone = np.zeros(len(rays), np.float32)
    light = np.ones(len(rays), np.float32)
    for _ in range(MAX_LAYERS):
        hits = model.rays.cast(origins[rays] + directions[rays] * gone[rays, None], directions[rays])
        met = np.flatnonzero(hits.faces >= 0)
        if not len(met):
            return
        rays = rays[met]
        distance = gone[rays] + hits.distance[met]
        uv = hits.uv[met]
        spots = Spots(
            faces=hits.faces[met],
            weights=np.column_stack([1 - uv[:, 0] - uv[:, 1], uv]),
            directions=directions[rays],
            pixel=np.float32(constant) + np.float32(growing) * distance,
        )
        layer = _Layer(rays, spots, distance, model.colours(spots, only_alpha, cull))
        yield layer
        light[rays] *= 1 - layer.rgba[:, 3]
        gone[rays] = distance + np.float32(STEP)
        rays = rays[light[rays] > 1 / 512]
        if not len(rays):
            return


def _band(model: Model, camera: Camera, width: int, height: int, rows: slice, mode: Mode, wire: int, cull: bool) -> F32:
    """(N, 4) float32 linear RGB times alpha, and alpha, of the pixels of `rows`; wires `wire` pixels wide."""
    result = np.zeros((width * (rows.stop - rows.start), 4), np.float32)
    clay = mode == "clay"
    for layer in _layers(model, camera, width, height, rows, only_alpha=clay, cull=cull):
        colour = np.full((len(layer.rays), 3), CLAY, np.float32) if clay else layer.rgba[:, :3]
        shade = _light(model.shading_normals(layer.spots, own=not clay), layer.spots.directions, camera)
        if not clay:
            shade[model.unlit(layer.spots)] = 1.0
        lit = colour * shade[:, None]
        if wire:
            lit += (WIRE - lit) * _wires(model, layer.spots, wire)[:, None]
        alpha = layer.rgba[:, 3] * (1 - result[layer.rays, 3])
        result[layer.rays, :3] += lit * alpha[:, None]
        result[layer.rays, 3] += alpha
    return result


def _light(normals: F32, directions: F32, camera: Camera) -> F32:
    """(N,) float32 in 0…1: a headlight, a soft light from above left, and a little from everywhere."""
    head = np.maximum(-np.einsum("nd,nd->n", normals, directions), 0.0)
    key = np.array(KEY) @ np.stack(camera.axes)
    soft = 0.5 + 0.5 * (normals @ (key / np.linalg.norm(key)).astype(np.float32))
    shade: F32 = np.float32(0.08) + np.float32(0.52) * head + np.float32(0.4) * soft * soft
    return shade


def _wires(model: Model, spots: Spots, width: int) -> F32:
    """(N,) float32: how much of a pixel the nearest edge of its triangle covers, drawn `width` pixels wide."""
    corners = model.corners(spots.faces)
    along = spots.directions[:, None]
    flat = corners - np.einsum("nkd,nxd->nk", corners, along)[:, :, None] * along  # as the ray sees the triangle
    opposite = np.roll(flat, -1, axis=1) - np.roll(flat, 1, axis=1)
    lengths = np.sqrt(np.einsum("nkd,nkd->nk", opposite, opposite))
    normal = np.cross(opposite[:, 0], opposite[:, 1])
    doubled = np.sqrt(np.einsum("nd,nd->n", normal, normal))
    distance = (spots.weights * doubled[:, None] / np.maximum(lengths, 1e-30)).min(axis=1) / spots.pixel
    covered: F32 = np.clip(np.float32(0.5 + 0.55 * width) - distance, 0.0, 1.0) * np.float32(0.85)
    return covered


def _finished(premultiplied: F32, background: tuple[float, float, float] | None) -> U8:
    alpha = np.minimum(premultiplied[..., 3:], 1.0)
    if background is None:
        colour = premultiplied[..., :3] / np.maximum(premultiplied[..., 3:], np.float32(1e-6))
        values = np.concatenate([to_srgb(colour), alpha], axis=-1)
    else:
        behind = to_linear(np.array(background)).astype(np.float32)
        values = to_srgb(premultiplied[..., :3] + (1 - alpha) * behind)
    return _bytes(values)


def _bytes(values: F32) -> U8:
    """uint8 from 0…1."""
    result: U8 = np.rint(values * 255).astype(np.uint8)
    return result
