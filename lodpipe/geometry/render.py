"""Pictures of a model: what the ray through each pixel meets.

For looking at results and for measuring what is seen: base colour, normal maps and emission under fixed lights, no
shadows, no reflections. Colours are worked on in linear light and stored as sRGB.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.mesh import F32, F64, I32
from lodpipe.geometry.camera import Camera
from lodpipe.geometry.surface import Model, Spots
from lodpipe.geometry.texture import U8, to_linear, to_srgb
from lodpipe.kernel import pictures

LIGHT = (0.93, 0.93, 0.93)
DARK = (0.08, 0.08, 0.09)
"""Backgrounds, sRGB 0…1."""

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

Mode = Literal["shaded", "clay", "normals", "uv"]


@dataclass(frozen=True)
class Lighting:
    """The lights of a picture: shade = ambient + head · cos + soft · (wrapped cosine with KEY)², at most 1 in all.

    ambient, head, soft  from everywhere, from the camera, from above left (`KEY`)
    clay                 grey of untextured pictures, in the space that `linear` says
    linear               whether colours are multiplied in linear light and then encoded as sRGB, or as they are stored
    maps                 whether normal maps and emission count, or base colour alone
    turned               whether a normal that looks away (a coarse mesh's, at its outline) is turned to the camera, or
                         gets no light from there
    """

    ambient: float
    head: float
    soft: float
    clay: float
    linear: bool = True
    maps: bool = True
    turned: bool = False


STUDIO = Lighting(0.08, 0.52, 0.4, clay=0.45)
"""What pictures are made with."""
HEADLIGHT = Lighting(0.15, 0.85, 0.0, clay=0.9, linear=False, maps=False, turned=True)
"""One light at the camera, sRGB values multiplied as they are: the usual set-up of papers on simplification. The
model's textures have to be made with ``Textures(pixels, srgb=False)`` for it."""


@dataclass(frozen=True)
class Style:
    """What is drawn at a surface.

    mode            shaded: colours and textures as the materials say; clay: grey, with normals made from the triangles;
                    normals: shading normals in the camera's axes as colours; uv: a chequer laid out by TEXCOORD_0
    face_colours    (F, 3) sRGB 0…1 in place of the materials' colours, for rows of the model's faces; alpha stays
    vertex_colours  (V, 3) the same for rows of the model's positions, blended over each face
    lit             whether these two and the chequer are shaded
    wireframe       width of the triangles' edges over the picture, in pixels of the final picture; 0: none
    cull            do not draw the backs of single-sided materials; otherwise every face has two sides
    """

    mode: Mode = "shaded"
    lighting: Lighting = STUDIO
    face_colours: F32 | None = None
    vertex_colours: F32 | None = None
    lit: bool = True
    wireframe: float = 0.0
    cull: bool = False


@dataclass(frozen=True)
class Buffers:
    """What lies under each pixel's centre; masked holes are looked through, glass is not.

    hit      (H, W) bool: the silhouette
    depth    (H, W) float32 distance from the camera along the ray, in world units; infinity if none
    normals  (H, W, 3) float32 unit shading normals in world space, on the seen side; zero if none
    facing   (H, W, 3) float32 unit normals of the triangles, on the seen side; zero if none
    faces    (H, W) int32 rows of the model's faces, −1 if none
    """

    hit: NDArray[np.bool_]
    depth: F32
    normals: F32
    facing: F32
    faces: I32


def render(
    model: Model,
    camera: Camera,
    width: int = 512,
    height: int = 512,
    style: Style | None = None,
    *,
    background: tuple[float, float, float] | None = LIGHT,
    supersample: int = 2,
) -> U8:
    """A picture (height, width, 3) uint8 of sRGB values, or (height, width, 4) with alpha if `background` is None.

    `supersample` is the number of rays along each side of a pixel.
    """
    style = style or Style()
    columns, lines = width * supersample, height * supersample
    picture = np.empty((height, width, 3 if background is not None else 4), np.uint8)
    step = max(BATCH // (columns * supersample), 1)
    for top in range(0, height, step):
        rows = slice(top, min(top + step, height))
        fine = slice(rows.start * supersample, rows.stop * supersample)
        band = _Band(columns * (fine.stop - fine.start))
        for layer in _layers(model, camera, columns, lines, fine, style):
            band.colour(model, camera, layer, style, supersample)
        shape = (rows.stop - rows.start, supersample, width, supersample, 4)
        premultiplied = band.colours.reshape(shape).mean(axis=(1, 3), dtype=np.float32)
        picture[rows] = as_bytes(finished(premultiplied, background, style.lighting.linear))
    return picture


def shoot(
    model: Model, camera: Camera, width: int = 512, height: int = 512, style: Style | None = None
) -> tuple[F32, Buffers]:
    """A picture for measuring, one ray a pixel: premultiplied RGBA (H, W, 4) float32 as `finished` takes it, and what
    lies under the pixels."""
    return _shot(model, camera, width, height, style or Style(), colours=True)


def buffers(model: Model, camera: Camera, width: int = 512, height: int = 512, cull: bool = False) -> Buffers:
    """Silhouette, depth, normals and face numbers as data."""
    return _shot(model, camera, width, height, Style(cull=cull), colours=False)[1]


def finished(premultiplied: F32, background: tuple[float, float, float] | None, linear: bool = True) -> F32:
    """sRGB values (…, 3) of premultiplied RGBA (…, 4) on a background, or straight RGBA (…, 4) if it is None.

    `linear` says whether the values are linear light that has to be encoded, or sRGB already.
    """
    if background is None:
        alpha = np.minimum(premultiplied[..., 3:], 1.0)
        colour = premultiplied[..., :3] / np.maximum(premultiplied[..., 3:], np.float32(1e-6))
        return np.concatenate([to_srgb(colour) if linear else np.clip(colour, 0, 1), alpha], axis=-1)
    return pictures.finished(premultiplied, ground(background, linear), linear)


def ground(background: tuple[float, float, float], linear: bool) -> Sequence[float] | F64:
    """A background's sRGB values as what a picture is laid over: linear light, or as they are."""
    return to_linear(np.array(background)) if linear else background


def normal_picture(seen: Buffers, camera: Camera) -> U8:
    """Normals as colours (H, W, 3) uint8: x, y, z to the camera's right, up and back as red, green, blue."""
    turned = seen.normals @ np.stack(camera.axes).astype(np.float32).T
    colours = np.where(seen.hit[..., None], turned * 0.5 + 0.5, 0.5)
    return as_bytes(np.clip(colours, 0.0, 1.0).astype(np.float32))


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
    model: Model, camera: Camera, width: int, height: int, rows: slice, style: Style, only_alpha: bool | None = None
) -> Iterator[_Layer]:
    """The surfaces that the rays through the pixels of `rows` meet, front to back, until nothing shines through."""
    if only_alpha is None:
        only_alpha = style.mode != "shaded" or style.face_colours is not None or style.vertex_colours is not None
    _, directions = camera.rays(width, height, rows, model.centre, model.radius)
    constant, growing = camera.pixel_size(height, model.radius)
    light = np.ones(len(directions), np.float32)
    behind = None
    for _ in range(MAX_LAYERS):
        hits = model.first_hits(camera, width, height, rows, behind)
        rays = np.flatnonzero(hits.faces >= 0)
        if not len(rays):
            return
        distance, uv = hits.distance[rays], hits.uv[rays]
        faces = hits.faces[rays]
        spots = Spots(
            faces=faces,
            weights=np.column_stack([1 - uv[:, 0] - uv[:, 1], uv]),
            directions=directions[rays],
            pixel=np.float32(constant) + np.float32(growing) * distance,
            flat=model.geometric_normals(faces),
        )
        layer = _Layer(rays, spots, distance, model.colours(spots, only_alpha, style.cull))
        yield layer
        light[rays] *= 1 - layer.rgba[:, 3]
        through = light[rays] > 1 / 512
        if not through.any():
            return
        behind = np.full(len(directions), np.inf, np.float32)
        behind[rays[through]] = distance[through] + np.float32(STEP)


class _Band:
    """What the rays of a band have gathered so far, and what the first surfaces are."""

    def __init__(self, count: int) -> None:
        self.colours: F32 = np.zeros((count, 4), np.float32)
        self.hit = np.zeros(count, bool)
        self.depth: F32 = np.full(count, np.inf, np.float32)
        self.normals: F32 = np.zeros((count, 3), np.float32)
        self.facing: F32 = np.zeros((count, 3), np.float32)
        self.faces: I32 = np.full(count, -1, np.int32)

    def colour(self, model: Model, camera: Camera, layer: _Layer, style: Style, pixel: int = 1) -> F32:
        """Lay a surface behind what is there already; returns its shading normals. A pixel is `pixel` rays wide."""
        normals = model.shading_normals(layer.spots, own=style.mode != "clay", mapped=style.lighting.maps)
        lit = _shaded(model, camera, layer, normals, style)
        if style.wireframe:
            lit += (WIRE - lit) * _wires(model, layer.spots, style.wireframe * pixel)[:, None]
        alpha = layer.rgba[:, 3] * (1 - self.colours[layer.rays, 3])
        self.colours[layer.rays, :3] += lit * alpha[:, None]
        self.colours[layer.rays, 3] += alpha
        return normals

    def note(self, model: Model, layer: _Layer, normals: F32 | None) -> None:
        """Keep what lies at the surface where it is the first that covers anything."""
        first = np.flatnonzero((layer.rgba[:, 3] > 0) & ~self.hit[layer.rays])
        at, spots = layer.rays[first], layer.spots.take(first)
        self.hit[at] = True
        self.depth[at] = layer.distance[first] * np.float32(model.radius)
        self.normals[at] = model.shading_normals(spots) if normals is None else normals[first]
        self.facing[at] = model.facing_normals(spots)
        self.faces[at] = spots.faces


def _shot(model: Model, camera: Camera, width: int, height: int, style: Style, *, colours: bool) -> tuple[F32, Buffers]:
    step = max(BATCH // width, 1)
    bands = []
    for top in range(0, height, step):
        rows = slice(top, min(top + step, height))
        band = _Band(width * (rows.stop - rows.start))
        for layer in _layers(model, camera, width, height, rows, style, None if colours else True):
            band.note(model, layer, band.colour(model, camera, layer, style) if colours else None)
        bands.append(band)

    def whole(name: str) -> Any:
        values = np.concatenate([getattr(band, name) for band in bands])
        return values.reshape(height, width, *values.shape[1:])

    seen = Buffers(*(whole(name) for name in ("hit", "depth", "normals", "facing", "faces")))
    return whole("colours"), seen


def _shaded(model: Model, camera: Camera, layer: _Layer, normals: F32, style: Style) -> F32:
    """(N, 3) float32: the light that comes from a surface."""
    spots, lighting = layer.spots, style.lighting
    replaced = _replaced(model, camera, layer.spots, normals, style)
    if replaced is not None:
        colour, lit = replaced
        if lighting.linear:
            colour = to_linear(colour).astype(np.float32)
        return colour * _light(normals, spots.directions, camera, lighting)[:, None] if lit else colour
    if style.mode == "clay":
        return np.float32(lighting.clay) * np.repeat(
            _light(normals, spots.directions, camera, lighting)[:, None], 3, axis=1
        )
    shade = _light(normals, spots.directions, camera, lighting)
    shade[model.unlit(spots)] = 1.0
    light: F32 = layer.rgba[:, :3] * shade[:, None]
    if lighting.maps:
        model.add_emission(spots, light)
    return light


def _replaced(model: Model, camera: Camera, spots: Spots, normals: F32, style: Style) -> tuple[F32, bool] | None:
    """Colours (N, 3), sRGB, that stand in for the materials', and whether they are lit; None: there are none."""
    if style.face_colours is not None:
        return np.asarray(style.face_colours, np.float32)[spots.faces], style.lit
    if style.vertex_colours is not None:
        corners = np.asarray(style.vertex_colours, np.float32)[model.faces[spots.faces]]
        return np.einsum("nkd,nk->nd", corners, spots.weights), style.lit
    if style.mode == "normals":
        turned = normals @ np.stack(camera.axes).astype(np.float32).T
        return np.clip(turned * np.float32(0.5) + np.float32(0.5), 0, 1), False
    if style.mode == "uv":
        return model.chequer(spots), style.lit
    return None


def _light(normals: F32, directions: F32, camera: Camera, lighting: Lighting) -> F32:
    """(N,) float32 in 0…1: how much light a surface sends back."""
    facing = -np.einsum("nd,nd->n", normals, directions)
    head = np.abs(facing) if lighting.turned else np.maximum(facing, 0.0)
    shade: F32 = np.float32(lighting.ambient) + np.float32(lighting.head) * head
    if lighting.soft:
        key = np.array(KEY) @ np.stack(camera.axes)
        soft = 0.5 + 0.5 * (normals @ (key / np.linalg.norm(key)).astype(np.float32))
        shade += np.float32(lighting.soft) * soft * soft
    return shade


def _wires(model: Model, spots: Spots, width: float) -> F32:
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


def as_bytes(values: F32) -> U8:
    """uint8 from 0…1."""
    result: U8 = np.rint(values * 255).astype(np.uint8)
    return result
