"""What a texture shows: how much a slip of it costs, and how much the two sides of a seam differ."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.asset import Asset
from lodpipe.core.material import Material
from lodpipe.core.mesh import F32, F64, I32
from lodpipe.geometry.flatten import Soup
from lodpipe.geometry.surface import Model, Spots
from lodpipe.geometry.texture import U8, Textures

LIGHT = 0.19
"""A colour off by 1 (in all three channels) is priced like a surface that is off by so much of the level's edge."""
SLIP = 0.1
"""How far textures and seams are expected to slip, in edges of the level."""
PLAIN_SEAM = 0.01
"""Weight that holds a seam across which nothing changes: its chart has an end, and beyond it lies another."""
SAMPLES = 12_000
"""Points at which a slip is tried."""
TEXELS = 512
"""Textures are looked at in this size at most: a slip that counts is far longer than their texels."""


@dataclass(frozen=True, eq=False)
class Content:
    """What textures and colours are worth to a decimation.

    uv       price of a slip of the texture: 1 like a surface that is off by that length
    soup     the asset's faces
    held     (F, 3) float32, rows of the soup: how strongly the contrast across the edge k → k + 1 holds it, a length
    weights  (F, 3) float32: that over the edge's length, which times the length's square is what a collapse pays
    """

    uv: float
    soup: Soup
    held: F32
    weights: F32

    @staticmethod
    def of(asset: Asset, pixels: Mapping[int, U8], finest: int, threads: int = 0) -> Content:
        """Prices for levels of `finest` triangles and fewer; `pixels` holds the decoded images by their row.

        The unit is a surface's squared distance: a squared difference of colour is worth LIGHT² · edge², edge the
        level's mean. A seam that moves by d shows the wrong colour in a strip d wide, contrast² · |e| · d; for the d
        about which it is decided, SLIP · edge, that is (LIGHT² / SLIP · contrast² · edge / |e|) · |e|² · d².
        """
        bare = tuple(Material({k: v for k, v in m.gltf.items() if k != "normalTexture"}) for m in asset.materials)
        model = Model(replace(asset, materials=bare), textures=small(pixels.get), threads=threads)
        areas = _areas(model)
        edge = float(np.sqrt(areas.sum() / max(finest, 1)))
        held = (LIGHT**2 / SLIP * edge * seam_contrasts(model, model.soup.wedges)).astype(np.float32)
        face, slot = np.nonzero(held)
        ends = model.positions[model.faces[face, (slot + 1) % 3]] - model.positions[model.faces[face, slot]]
        length = np.linalg.norm(ends.astype(np.float64), axis=1)
        weights = np.zeros_like(held)
        weights[face, slot] = held[face, slot] / np.maximum(length, 1e-9 * edge + 1e-300)
        return Content(LIGHT * edge * float(np.sqrt(slip_price(model, SLIP * edge, areas))), model.soup, held, weights)

    def seams(self, times: float = 1.0) -> F32:
        """(F, 3) float32, rows of the soup: the weights that hold seams, what the contrast asks for taken `times`."""
        held: F32 = np.maximum(times * self.weights, PLAIN_SEAM).astype(np.float32)
        return held


def small(pixels: Callable[[int], U8 | None]) -> Textures:
    """Textures of stored values (not of linear light), reduced to `TEXELS` along their longer side."""

    def reduced(index: int) -> U8 | None:
        image = pixels(index)
        step = 1 if image is None else max(image.shape[:2]) // TEXELS
        if image is None or step < 2:
            return image
        height, width = (max(size // step, 1) for size in image.shape[:2])
        high, wide = image.shape[0] // height, image.shape[1] // width
        rows = image[: height * high, : width * wide].reshape(height, high, -1).sum(axis=1, dtype=np.uint32)
        sums = rows.reshape(height, width, wide, -1).sum(axis=2, dtype=np.uint32)
        result: U8 = np.rint(sums / np.float32(high * wide)).astype(np.uint8)
        return result

    return Textures(reduced, srgb=False)


def slip_price(model: Model, slip: float, areas: F64 | None = None) -> float:
    """Mean squared difference of colour, per squared length, when the textures slip by about `slip` (in radii).

    `areas` (F,) are those of the model's faces, where they are known already.
    The mean over points spread by area, over two directions in the surface, and over red, green and blue (0…1). Seen
    through a filter as wide as the slip, so that grain finer than it does not count. In a face smaller than the slip,
    the slip is as long as half of the face.
    """
    areas = _areas(model) if areas is None else areas
    total = np.cumsum(areas)
    if not len(total) or not total[-1] > 0:
        return 0.0
    i = np.arange(SAMPLES)
    faces = (
        np.searchsorted(total, (i + 0.5) * total[-1] / SAMPLES, side="right").clip(max=len(areas) - 1).astype(np.int32)
    )
    start = _places(SAMPLES)
    a, b, c = model.corners(faces).astype(np.float64).transpose(1, 0, 2)
    e1, e2 = b - a, c - a
    step = np.maximum(np.minimum(slip, 0.5 * np.sqrt(areas[faces])), 1e-12)
    along = e1 / np.maximum(np.linalg.norm(e1, axis=1, keepdims=True), 1e-300)
    across = np.cross(np.cross(e1, e2), along)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    here = _colours(model, faces, start, step)
    price = np.zeros(SAMPLES)
    for direction in (along, across):
        shift = _barycentric(e1, e2, direction * step[:, None])
        # backwards where forwards leads out of the face
        shift = np.where(((start + shift).min(axis=1) < 0)[:, None], -shift, shift)
        price += ((_colours(model, faces, start + shift, step) - here) ** 2).mean(axis=1) / step**2 / 2
    return float(price.mean())


def seam_contrasts(model: Model, wedges: I32) -> F32:
    """(F, 3) float32: mean squared difference of colour between the two sides of each edge (k → k + 1), 0…1.

    0 along edges that are no seams (whose two faces have the same `wedges` (F, 3) at both ends), borders and edges of
    more than two faces.
    """
    faces = model.faces
    contrast = np.zeros(faces.shape, np.float32)
    split = _split(faces, wedges, len(model.positions))[faces]
    rows = np.flatnonzero((split | np.roll(split, -1, axis=1)).ravel())  # a seam has an end of several wedges
    following = np.where(rows % 3 == 2, rows - 2, rows + 1)
    start, end = faces.ravel()[rows], faces.ravel()[following]
    from_wedge, to_wedge = wedges.ravel()[rows], wedges.ravel()[following]
    key = np.minimum(start, end).astype(np.int64) * len(model.positions) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    _, first, counts = np.unique(key[order], return_index=True, return_counts=True)
    two = first[counts == 2]
    a, b = order[two], order[two + 1]
    flipped = start[a] != start[b]  # as in a consistent mesh
    low_b, high_b = np.where(flipped, to_wedge[b], from_wedge[b]), np.where(flipped, from_wedge[b], to_wedge[b])
    seam = (from_wedge[a] != low_b) | (to_wedge[a] != high_b)
    a, b, flipped = rows[a[seam]], rows[b[seam]], flipped[seam]
    if not len(a):
        return contrast
    total = np.zeros(len(a))
    for part in (0.15, 0.5, 0.85):
        one = _colours(model, (a // 3).astype(np.int32), _on_edge(a % 3, np.full(len(a), part)))
        other = _colours(model, (b // 3).astype(np.int32), _on_edge(b % 3, np.where(flipped, 1 - part, part)))
        total += ((one - other) ** 2).mean(axis=1) / 3
    contrast.ravel()[a] = contrast.ravel()[b] = total
    return contrast


def _areas(model: Model) -> F64:
    """(F,) float64: the areas of the model's faces, in squared radii."""
    a, b, c = (model.positions[model.faces[:, k]] for k in range(3))
    (x, y, z), (u, v, w) = (b - a).T, (c - a).T
    areas: F64 = np.sqrt((y * w - z * v) ** 2 + (z * u - x * w) ** 2 + (x * v - y * u) ** 2).astype(np.float64) / 2
    return areas


def _split(faces: I32, wedges: I32, count: int) -> NDArray[np.bool_]:
    """(count,) bool: which positions have several wedges."""
    one = np.zeros(count, np.int32)
    one[faces] = wedges
    split = np.zeros(count, bool)
    split[faces[one[faces] != wedges]] = True
    return split


def _places(count: int) -> F64:
    """(count, 3) barycentric weights, spread evenly, off the edges."""
    i = np.arange(count)
    r, s = (0.5 + 0.7548776662466927 * i) % 1, (0.5 + 0.5698402909980532 * i) % 1
    over = r + s > 1
    r, s = np.where(over, 1 - r, r), np.where(over, 1 - s, s)
    return 0.9 * np.column_stack([1 - r - s, r, s]) + 0.1 / 3


def _on_edge(slot: I32, part: F64) -> F64:
    """(N, 3) weights of a point at `part` of the edge slot → slot + 1, a little within the face."""
    weights = np.full((len(slot), 3), 0.03)
    rows = np.arange(len(slot))
    weights[rows, slot] += 0.91 * (1 - part)
    weights[rows, (slot + 1) % 3] += 0.91 * part
    return weights


def _barycentric(e1: F64, e2: F64, step: F64) -> F64:
    """The change of barycentric weights (N, 3) that goes with a step (N, 3) in the plane of e1 and e2."""
    aa, ab, bb = (np.einsum("nd,nd->n", p, q) for p, q in ((e1, e1), (e1, e2), (e2, e2)))
    sa, sb = np.einsum("nd,nd->n", step, e1), np.einsum("nd,nd->n", step, e2)
    over = 1 / np.maximum(aa * bb - ab * ab, 1e-300)
    v, w = (bb * sa - ab * sb) * over, (aa * sb - ab * sa) * over
    return np.column_stack([-v - w, v, w])


def _colours(model: Model, faces: I32, weights: F64, width: F64 | float = 0.0) -> F64:
    """RGB (N, 3) at places of faces, through a filter `width` radii wide; looked at from straight above."""
    pixel = np.broadcast_to(np.asarray(width, np.float32), (len(faces),))
    normals = model.geometric_normals(faces)
    spots = Spots(faces.astype(np.int32), weights.astype(np.float32), -normals, pixel, normals)
    return model.colours(spots)[:, :3].astype(np.float64)
