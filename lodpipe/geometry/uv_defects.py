"""What is wrong with a UV layout, in figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lodpipe.core.asset import Asset
from lodpipe.core.material import texture_ref
from lodpipe.core.mesh import F64, I32, Mesh
from lodpipe.geometry.charts import Charts, charts_of, seam_edges
from lodpipe.geometry.flatten import Bool
from lodpipe.geometry.surface import image_index
from lodpipe.geometry.topology import flat_faces, without_area
from lodpipe.kernel import layout

NO_TEXTURE = (1024, 1024)
"""Texels by which layouts without a texture are measured."""
REACH = 64.0
"""Gutters are measured up to so many texels."""
SLIVER = 1.0
"""A chart is a sliver where it is thinner than so many texels."""

Sizes = Mapping[int, tuple[float, float]]
"""Material (−1: the default one) -> width and height of its texture in texels."""


@dataclass(frozen=True)
class UvFigures:
    """One UV set of one mesh. Texels are those of the material's texture, 1024² without one."""

    set: str
    """TEXCOORD_0, …"""
    charts: int
    """Pieces that hang together."""
    overlap_percent: float
    """Share of the occupied UV area that two or more faces cover; 0 only if no two faces overlap (exact)."""
    overlap_kind: str
    """What most of it is: none, stack (charts on their likes), mirror (on mirrored ones), fold (on itself), or
    accident."""
    flipped_percent: float
    """Share of the UV area on which the texture is seen mirrored."""
    mixed_charts: int
    """Charts with faces of both orientations."""
    out_of_range_percent: float
    """Share of the faces that leave [0, 1]: tiling, UDIM, or a mistake."""
    tiles: int
    """Unit squares that faces touch."""
    zero_area_faces: int
    """Faces with an area in space but none in the texture."""
    missing_faces: int
    """Faces that have no such UVs, or not finite ones."""
    min_gutter_texels: float
    """Least distance between two charts, up to 64."""
    bleeding_mip: int
    """First mip level at which two charts touch the same texels; 0: the full texture."""
    sliver_charts: int
    """Charts thinner than a texel."""
    stretch_l2: float
    """Root mean square of the texture's stretch, 1 for none (Sander et al. 2001)."""
    stretch_max: float
    """Largest stretch of a face against the mean (L∞ of the same)."""
    density_cv: float
    """Coefficient of variation of the texels for each unit of length, by area."""
    density_p5_p95: float
    """The 95th percentile of the density over the 5th."""
    seam_length: float
    """Length of the seams over the bounding box's diagonal."""


def uv_defects(mesh: Mesh, sizes: Sizes | None = None) -> list[UvFigures]:
    """The figures of each of `mesh`'s UV sets; TEXCOORD_0 is always among them."""
    solid = ~without_area(mesh)
    names = sorted({"TEXCOORD_0", *(name for name in mesh.attributes if name.startswith("TEXCOORD_"))})
    return [uv_figures(mesh, charts_of(mesh, name), name, sizes, solid) for name in names]


def uv_figures(
    mesh: Mesh, charts: Charts, name: str = "TEXCOORD_0", sizes: Sizes | None = None, solid: Bool | None = None
) -> UvFigures:
    """The figures of one UV set whose charts are known; `solid` (F,): which faces have an area in space."""
    solid = ~without_area(mesh) if solid is None else solid
    zero = flat_faces(charts.uv) & solid[charts.rows]
    size = texels_of(mesh, charts, sizes)
    overlap, kind = _overlap(charts)
    area = np.abs(charts.doubled_area)
    total = float(area.sum())
    gutter = min_gutter(charts, size)
    stretch, largest, spread, ratio = _distortion(mesh, charts, size)
    outside: Bool = np.logical_or.reduce((charts.uv < 0) | (charts.uv > 1), axis=(1, 2))
    return UvFigures(
        set=name,
        charts=charts.count,
        overlap_percent=overlap,
        overlap_kind=kind,
        flipped_percent=100 * float(area[charts.doubled_area > 0].sum()) / total if total > 0 else 0.0,
        mixed_charts=len(mixed_charts(charts)),
        out_of_range_percent=100 * float(outside.mean()) if len(outside) else 0.0,
        tiles=_tiles(charts),
        zero_area_faces=int(zero.sum()),
        missing_faces=len(mesh.faces) - len(charts.rows),
        min_gutter_texels=gutter,
        bleeding_mip=bleeding_mip(gutter),
        sliver_charts=int((chart_thickness(charts, size) < SLIVER).sum()),
        stretch_l2=stretch,
        stretch_max=largest,
        density_cv=spread,
        density_p5_p95=ratio,
        seam_length=_seam_length(mesh, charts),
    )


def texture_sizes(asset: Asset) -> dict[int, tuple[float, float]]:
    """Width and height in texels of each material's first texture, scaled by its transform.

    The base colour's if there is one; a material without textures has no entry.
    """
    sizes = {}
    for row, material in enumerate(asset.materials):
        pbr = material.gltf.get("pbrMetallicRoughness", {})
        infos = [pbr.get("baseColorTexture"), material.gltf.get("normalTexture"), pbr.get("metallicRoughnessTexture")]
        infos += [material.gltf.get("occlusionTexture"), material.gltf.get("emissiveTexture")]
        for ref in map(texture_ref, infos):
            index = None if ref is None else image_index(asset.document["textures"][ref.texture])
            if ref is not None and index is not None and asset.images[index].width:
                image = asset.images[index]
                sizes[row] = (image.width * abs(ref.scale[0]), image.height * abs(ref.scale[1]))
                break
    return sizes


def texels_of(mesh: Mesh, charts: Charts, sizes: Sizes | None) -> F64:
    """(N, 2) float64: texels to a UV unit, for each of the charts' faces."""
    found = mesh.face_material[charts.rows]
    scale = np.empty((len(found), 2))
    for material in np.unique(found):
        scale[found == material] = (sizes or {}).get(int(material), NO_TEXTURE)
    return scale


def mixed_charts(charts: Charts) -> I32:
    """Labels of the charts in which some faces are mirrored and others are not."""
    turned = np.zeros((2, charts.count), bool)
    turned[0, charts.label[charts.doubled_area > 0]] = True
    turned[1, charts.label[charts.doubled_area < 0]] = True
    return np.flatnonzero(turned.all(axis=0)).astype(np.int32)


def min_gutter(charts: Charts, texels: F64, reach: float = REACH) -> float:
    """The least distance in texels between the borders of two charts of one texture, at most `reach`."""
    rows, sides = charts.borders[:, 0], charts.borders[:, 1]
    ends = np.stack([charts.uv[rows, sides], charts.uv[rows, (sides + 1) % 3]], axis=1) * texels[rows][:, None]
    groups = int(charts.group.max(initial=-1)) + 1
    gaps = layout.uv_gaps(ends, charts.label[rows], charts.group[rows], groups, reach)
    return float(gaps.min(initial=reach))


def bleeding_mip(gutter: float) -> int:
    """The first mip level at which filters mix two charts that are `gutter` texels apart.

    At a chart's border a bilinear filter reaches a texel's centre one texel away, which stands for half a texel more.
    """
    level = 0
    while 3 * 2**level <= gutter * (1 + 1e-5):  # UVs are rounded
        level += 1
    return level


def chart_thickness(charts: Charts, texels: F64) -> F64:
    """(count,) float64: area over half the length of the border, in texels: the width of a long chart."""
    scale = np.ones((charts.count, 2))
    scale[charts.label] = texels
    area = np.bincount(charts.label, np.abs(charts.doubled_area) / 2, charts.count) * scale[:, 0] * scale[:, 1]
    rows, sides = charts.borders[:, 0], charts.borders[:, 1]
    steps = (charts.uv[rows, (sides + 1) % 3] - charts.uv[rows, sides]) * texels[rows]
    around = np.bincount(charts.label[rows], np.linalg.norm(steps, axis=1), charts.count)
    return np.where(around > 0, 2 * area / np.where(around > 0, around, 1.0), 0.0)


def _overlap(charts: Charts) -> tuple[float, str]:
    if not len(charts.rows):
        return 0.0, "none"
    found = layout.uv_overlaps(charts.uv, charts.label, charts.group)
    if not len(found.charts) and found.complete:
        return 0.0, "none"
    covered, doubled = layout.uv_coverage(charts.uv, charts.group).sum(axis=0)
    # what lies between two scan lines is an overlap all the same
    doubled = min(max(doubled, float(found.area.sum(axis=1).max(initial=0.0))), covered)
    return 100 * float(doubled / covered) if covered > 0 else 100.0, _kind(charts, found)


def _kind(charts: Charts, found: layout.UvOverlaps) -> str:
    """What most of the overlapping area is."""
    if not len(found.charts):
        return "accident"  # too many pairs to look at
    own = np.bincount(charts.label, np.abs(charts.doubled_area) / 2, charts.count)
    a, b = found.charts.T
    alike, opposite = found.area.T
    same = (a != b) & (alike >= 0.98 * np.maximum(own[a], own[b])) & (alike <= 1.02 * np.minimum(own[a], own[b]))
    shares = {
        "fold": float((alike + opposite)[a == b].sum()),
        "mirror": float(opposite[a != b].sum()),
        "stack": float(alike[same].sum()),
        "accident": float(alike[(a != b) & ~same].sum()),
    }
    return max(shares, key=lambda kind: shares[kind])


def _tiles(charts: Charts) -> int:
    if not len(charts.rows):
        return 0
    # a border that lies on the edge of a tile does not enter the next one
    low = np.floor(np.clip(charts.uv.min(axis=1), -1e6, 1e6) + 1e-6).astype(np.int64)
    high = np.ceil(np.clip(charts.uv.max(axis=1), -1e6, 1e6) - 1e-6).astype(np.int64) - 1
    boxes = np.unique(np.concatenate([low, np.maximum(high, low)], axis=1), axis=0)
    origin = boxes[:, :2].min(axis=0)
    across = boxes[:, 2:].max(axis=0) - origin + 1
    if int(across[0]) * int(across[1]) > 1 << 22:
        return int(across[0]) * int(across[1])
    steps = np.zeros(across + 1, np.int64)
    a, b, c, d = (boxes - np.tile(origin, 2)).T
    for rows, columns, sign in ((a, b, 1), (c + 1, b, -1), (a, d + 1, -1), (c + 1, d + 1, 1)):
        np.add.at(steps, (rows, columns), sign)
    return int((steps.cumsum(axis=0).cumsum(axis=1) > 0).sum())


def stretch_of(points: F64, texels: F64) -> F64:
    """(N,) each face's part in the L2 stretch (its square root is what they add up to in squares): `points` (N, 3, 3),
    UVs in `texels` (N, 3, 2), against the mean density; 0 for faces without area."""
    p, q = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    s, t = texels[:, 1] - texels[:, 0], texels[:, 2] - texels[:, 0]
    doubled = s[:, 0] * t[:, 1] - s[:, 1] * t[:, 0]
    area = np.linalg.norm(np.cross(p, q), axis=1)
    good = (area > 0) & ~flat_faces(texels)
    safe = np.where(good, doubled, 1.0)[:, None]
    by_u, by_v = (p * t[:, 1:] - q * s[:, 1:]) / safe, (q * s[:, :1] - p * t[:, :1]) / safe
    squared = (np.einsum("nd,nd->n", by_u, by_u) + np.einsum("nd,nd->n", by_v, by_v)) / 2
    total = float(area[good].sum()) or 1.0
    mean = np.abs(doubled[good]).sum() / total
    result: F64 = np.where(good, np.sqrt(squared * area / total * mean), 0.0)
    return result


def _distortion(mesh: Mesh, charts: Charts, texels: F64) -> tuple[float, float, float, float]:
    """L2 and largest stretch (Sander, Snyder, Gortler & Hoppe 2001, section 3), spread and range of the density."""
    points = mesh.positions[mesh.faces[charts.rows]]
    extent = float(np.ptp(points, axis=(0, 1)).max()) if len(points) else 0.0
    if not extent > 0:
        return 1.0, 1.0, 0.0, 1.0
    p, q = (points[:, 1] - points[:, 0]) / extent, (points[:, 2] - points[:, 0]) / extent
    s, t = (charts.uv[:, 1] - charts.uv[:, 0]) * texels, (charts.uv[:, 2] - charts.uv[:, 0]) * texels
    doubled = s[:, 0] * t[:, 1] - s[:, 1] * t[:, 0]
    area = np.linalg.norm(np.cross(p, q), axis=1)
    good = (area > 0) & ~flat_faces(charts.uv)
    if not good.any():
        return 1.0, 1.0, 0.0, 1.0
    p, q, s, t, area, doubled = (values[good] for values in (p, q, s, t, area, doubled))
    by_u = (p * t[:, 1:] - q * s[:, 1:]) / doubled[:, None]
    by_v = (q * s[:, :1] - p * t[:, :1]) / doubled[:, None]
    a, b, c = (np.einsum("nd,nd->n", *pair) for pair in ((by_u, by_u), (by_u, by_v), (by_v, by_v)))
    largest = np.sqrt((a + c + np.sqrt((a - c) ** 2 + 4 * b**2)) / 2)
    texture = np.abs(doubled)
    mean = np.sqrt(texture.sum() / area.sum())  # texels to a unit of length
    stretch = np.sqrt(((a + c) / 2 * area).sum() / area.sum()) * mean
    density = np.sqrt(texture / area)
    average = (density * area).sum() / area.sum()
    spread = np.sqrt(((density - average) ** 2 * area).sum() / area.sum()) / average
    order = np.argsort(density)
    low, high = np.searchsorted(np.cumsum(area[order]), [0.05 * area.sum(), 0.95 * area.sum()])
    ratio = density[order[min(high, len(order) - 1)]] / density[order[low]]
    return float(stretch), float(largest.max() * mean), float(spread), float(ratio)


def _seam_length(mesh: Mesh, charts: Charts) -> float:
    seams = seam_edges(mesh, charts)
    used = mesh.positions[np.unique(mesh.faces)] if len(mesh.faces) else np.zeros((1, 3))
    extent = np.ptp(used, axis=0)
    scale = float(extent.max())
    if not len(seams) or not scale > 0:
        return 0.0
    steps = (mesh.positions[seams[:, 1]] - mesh.positions[seams[:, 0]]) / scale
    return float(np.linalg.norm(steps, axis=1).sum() / np.linalg.norm(extent / scale))
