"""Repair of UV layouts: what is wrong gets a new place, what is right keeps its shape, size and texels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lodpipe.core.asset import Asset
from lodpipe.core.errors import InvalidMesh
from lodpipe.core.material import texture_ref
from lodpipe.core.mesh import F64, I32, Mesh
from lodpipe.geometry.atlas import chart_boxes, pack, unfold
from lodpipe.geometry.bake import Group
from lodpipe.geometry.charts import Charts, charts_of
from lodpipe.geometry.flatten import Bool
from lodpipe.geometry.slots import slots
from lodpipe.geometry.topology import flat_faces, without_area
from lodpipe.geometry.uv_defects import NO_TEXTURE, UvFigures, min_gutter, stretch_of, texels_of, texture_sizes
from lodpipe.kernel import layout

SMALLEST, LARGEST = 64, 8192
"""Sides of new textures, in texels."""
FEW = 0.05
"""Folded faces of up to that share of a chart's area are cut out of it; with more it is unfolded anew."""
THIN, THICK = 2.0, 8.0
"""Where most charts are thinner than so many texels they are enlarged until most have so many."""
MIPS = (8, 4, 2)
"""Charts move by multiples of so many texels where there is room for it: mip levels then mix what they mixed before."""
WIDE = 16.0
"""Gutters do not become narrower than they were, up to so many texels."""


@dataclass(frozen=True)
class RepairOptions:
    """What counts as broken; see the parameters of the stage."""

    one_to_one: bool = False
    padding: float = 4.0
    size: int | None = None
    largest: int = 4096
    always: bool = False
    seconds: float = 60.0


@dataclass(frozen=True, eq=False)
class Plan:
    """What one material's faces need: `reasons` (empty: nothing), and of them the faces to be unfolded anew."""

    group: Group
    reasons: tuple[str, ...]
    charts: tuple[Charts, ...]
    anew: tuple[Bool, ...]
    """For each part, (F,) over its rows: faces whose old UVs are of no use."""
    gutter: float = 0.0
    """The least there was, in texels."""


def plan(asset: Asset, groups: Sequence[Group], options: RepairOptions) -> list[Plan]:
    """What each group of faces needs, by the figures of its layout."""
    sizes = texture_sizes(asset)
    return [_plan(asset, group, sizes, options) for group in groups]


def _plan(asset: Asset, group: Group, sizes: dict[int, tuple[float, float]], options: RepairOptions) -> Plan:
    reasons: dict[str, None] = {}
    charts, anew, joined = [], [], []
    textured = any(slots(asset.materials[row]) for row in group.materials if row >= 0)
    for number, rows in group.parts:
        mesh = asset.meshes[number]
        own = _rows_of(charts_of(mesh, uv_set(asset, group)), rows)
        if options.one_to_one:
            own = _cut_at_folds(own)
        wrong = np.ones(len(rows), bool)
        wrong[np.searchsorted(rows, own.rows)] = False
        solid = ~without_area(mesh)
        flat = flat_faces(own.uv) & solid[own.rows]
        if (wrong & solid[rows]).any() and (textured or options.one_to_one):
            reasons[f"{int(wrong.sum()):,} faces without UVs"] = None
        if flat.any() and options.one_to_one:
            reasons[f"{int(flat.sum()):,} faces without area in the texture"] = None
            wrong[np.searchsorted(rows, own.rows[flat])] = True
        charts.append(own)
        anew.append(wrong)
        joined.append(own)
    whole = _joined(joined)
    texels = np.broadcast_to(np.array(sizes.get(group.materials[0], NO_TEXTURE)), (len(whole.uv), 2))
    gutter = min_gutter(whole, texels)
    if options.one_to_one:
        found = layout.uv_overlaps(whole.uv, whole.label, np.zeros(len(whole.uv), np.int32))
        if len(found.charts) or not found.complete:
            reasons["overlaps"] = None
            _folds(whole, found, charts, anew, [rows for _, rows in group.parts])
        if len(whole.uv) and (whole.uv.min() < 0 or whole.uv.max() > 1):
            reasons["UVs outside the texture"] = None
        if textured and gutter < min(options.padding, 1.0):
            reasons[f"charts {gutter:.2g} texels apart"] = None
    if options.always:
        reasons.setdefault("asked for", None)
    return Plan(group, tuple(reasons), tuple(charts), tuple(anew), gutter)


def new_layout(
    asset: Asset, planned: Plan, options: RepairOptions, cancelled: Callable[[], bool] = lambda: False
) -> tuple[F64, int, float, str]:
    """UVs (F, 3, 2) in texels for the group's faces, the side of the square they lie in, the scale against the old
    texels (1: they are copied), and what xatlas did not do.

    Kept charts keep their shape and move by whole texels, turned by quarters at most, wherever all of it fits at the
    old size. Faces that are unfolded anew get the density that half of the old surface had.
    """
    group = planned.group
    uv, label, problem = [], [], ""
    next_label = 0
    densities: list[tuple[F64, F64]] = []
    fresh: list[tuple[int, Bool]] = []
    for part, ((number, rows), own, wrong) in enumerate(zip(group.parts, planned.charts, planned.anew, strict=True)):
        mesh = asset.meshes[number]
        placed = np.zeros((len(rows), 3, 2))
        labels = np.full(len(rows), -1, np.int32)
        at = np.searchsorted(rows, own.rows)
        placed[at] = own.uv * texels_of(mesh, own, texture_sizes(asset))[:, None]
        densities.append((_areas(mesh.positions[mesh.faces[own.rows]]), _flat_areas(placed[at])))
        # without the faces that are unfolded anew a chart may fall apart
        stays = ~wrong[at]
        if stays.any():
            labels[at[stays]] = layout.chart_labels(np.ascontiguousarray(own.corners[stays])) + next_label
            next_label = int(labels.max()) + 1
        fresh.append((part, labels < 0))
        uv.append(placed)
        label.append(labels)
    density = _middle_density(densities)
    for part, missing in fresh:
        if not missing.any():
            continue
        number, rows = group.parts[part]
        mesh = asset.meshes[number]
        found = unfold(mesh.positions, mesh.faces[rows[missing]], seconds=options.seconds, cancelled=cancelled)
        problem = problem or found.problem
        scale = density or _new_density(mesh, rows, options)
        uv[part][missing] = found.uv * scale
        label[part][missing] = found.label + next_label
        next_label += int(found.label.max()) + 1
    _, numbers = np.unique(np.concatenate(label), return_inverse=True)
    padding = max(options.padding, min(planned.gutter, WIDE))
    return (*_packed(np.concatenate(uv), numbers.astype(np.int32), options, padding), problem)


#: Figures of a layout, and by what factor and how much each may be worse after a repair. `charts`, `sliver_charts` and
#: `seam_length` are not among them: what lies on itself has to be cut. Nor are mirrored charts, whose share grows where
#: they lay on others.
HELD = {
    "overlap_percent": (1.0, 1e-3),
    "out_of_range_percent": (1.0, 1e-3),
    "zero_area_faces": (1.0, 0.0),
    "missing_faces": (1.0, 0.0),
    "stretch_l2": (1.02, 1e-3),
    "density_cv": (1.05, 5e-3),
}


def worsened(before: UvFigures, after: UvFigures, padding: float) -> list[str]:
    """Which figures of a layout a repair has made worse, in words; `padding` is the gutter that was asked for.

    Where faces have got UVs, or an area in the texture, stretch and density are those of other faces than before.
    """
    told = []
    mended = after.missing_faces + after.zero_area_faces < before.missing_faces + before.zero_area_faces
    for name, (factor, slack) in HELD.items():
        if mended and factor > 1:
            continue
        a, b = getattr(before, name), getattr(after, name)
        if b > a * factor + slack:
            told.append(f"{name} {a:.3g} → {b:.3g}")
    a, b = before.min_gutter_texels, after.min_gutter_texels
    if b < min(a, padding) - 0.01:
        told.append(f"min_gutter_texels {a:.3g} → {b:.3g}")
    return told


def with_worst_anew(asset: Asset, planned: Plan, layout_: F64) -> Plan | None:
    """The plan with the most stretched kept faces to be unfolded anew, where a layout (F, 3, 2) in texels stretches
    more than the old one did; None where none is stretched more."""
    sizes = texture_sizes(asset)
    start, marked, any_ = 0, [], False
    for (number, rows), own, wrong in zip(planned.group.parts, planned.charts, planned.anew, strict=True):
        mesh = asset.meshes[number]
        at = np.searchsorted(rows, own.rows)
        corners = mesh.positions[mesh.faces[own.rows]]
        new = layout_[start : start + len(rows)][at]
        start += len(rows)
        old = own.uv * texels_of(mesh, own, sizes)[:, None]
        a, b = stretch_of(corners, old), stretch_of(corners, new)
        total = float(np.sqrt(np.square(a).sum()))
        more = wrong.copy()
        if float(np.sqrt(np.square(b).sum())) > total * 1.01:
            # the largest shares first, until what is left is no more than the whole was
            order = np.argsort(-b)
            left = np.square(b).sum() - np.cumsum(np.square(b[order]))
            count = int(np.searchsorted(-left, -0.9 * total**2)) + 1
            fresh = at[order[:count]]
            any_ |= not more[fresh].all()
            more[fresh] = True
        marked.append(more)
    return replace(planned, anew=tuple(marked)) if any_ else None


def _packed(uv: F64, label: I32, options: RepairOptions, padding: float) -> tuple[F64, int, float]:
    uv = uv * _enlargement(uv, label)
    area = float(_flat_areas(uv).sum())
    side = options.size or SMALLEST
    if not options.size:
        while side < options.largest and side * side * 0.75 < area:
            side *= 2
    while True:
        try:
            placed = pack(uv, label, (side, side), padding + 2, largest=1.0, straighten=False)
        except InvalidMesh:
            if options.size or side >= LARGEST:
                raise
            side *= 2
            continue
        scale = np.sqrt(float(_flat_areas(placed).sum()) / area) if area > 0 else 1.0
        if scale > 0.999 or options.size or side >= options.largest:
            break
        side *= 2
    if scale <= 0.999:
        return placed, side, float(scale)
    step = 1
    for coarser in MIPS:
        try:
            roomier = pack(uv, label, (side, side), padding + 2 * coarser, largest=1.0, straighten=False)
        except InvalidMesh:
            continue
        if float(_flat_areas(roomier).sum()) > 0.998 * area:
            placed, step = roomier, coarser
            break
    return _aligned(uv, placed, label, step), side, 1.0


def _enlargement(uv: F64, label: I32) -> float:
    """1, or the power of two by which charts of less than a few texels must grow to hold their colours apart."""
    low, high = chart_boxes(uv, label)
    middle = float(np.median((high - low).min(axis=1)))
    return 1.0 if middle >= THIN or middle <= 0 else float(2 ** np.ceil(np.log2(THICK / middle)))


def _aligned(old: F64, new: F64, label: I32, step: int) -> F64:
    """Charts moved by less than `step` texels, to where old squares of `step`² texels fall onto new ones."""
    first = np.zeros(int(label.max(initial=-1)) + 1, np.int64)
    first[label[::-1]] = np.arange(len(label))[::-1]
    # the old texel grid passes through old + n; a quarter turn takes it to a grid again
    a, b = old[first], new[first]
    turned = np.abs((b[:, 1] - b[:, 0]) - (a[:, 1] - a[:, 0])).max(axis=1) > 1e-6 * (1 + np.abs(a).max(axis=(1, 2)))
    shift = np.zeros((len(first), 2))
    shift[~turned] = (a[~turned, 0] - b[~turned, 0]) % step
    for chart in np.flatnonzero(turned):
        edge, image = (x[chart, 1:] - x[chart, :1] for x in (a, b))
        if abs(np.linalg.det(edge)) > 1e-12:
            turn = np.rint(np.linalg.solve(edge, image))
            shift[chart] = (a[chart, 0] @ turn - b[chart, 0]) % step
    return new + shift[label][:, None]


def uv_set(asset: Asset, group: Group) -> str:
    """The UV set of the group's first texture."""
    for row in group.materials:
        if row >= 0:
            for info in slots(asset.materials[row]).values():
                ref = texture_ref(info)
                if ref is not None:
                    return f"TEXCOORD_{ref.texcoord}"
    return "TEXCOORD_0"


def _rows_of(charts: Charts, rows: I32) -> Charts:
    """The charts of the faces `rows` alone."""
    keep = np.isin(charts.rows, rows)
    _, label = np.unique(charts.label[keep], return_inverse=True)
    return Charts(charts.rows[keep], charts.uv[keep], charts.corners[keep], charts.group[keep], label.astype(np.int32))


def _cut_at_folds(charts: Charts) -> Charts:
    """Charts that lie on themselves cut where they turn over: mirrored halves become charts of their own.

    Pieces of up to `FEW` of a chart's area stay: they are flips of single faces, which `_folds` deals with.
    """
    found = layout.uv_overlaps(charts.uv, charts.label, charts.label)
    folded = np.unique(found.charts[found.charts[:, 0] == found.charts[:, 1], 0])
    if not len(folded):
        return charts
    lies_on_itself, mirrored = np.isin(charts.label, folded), charts.doubled_area > 0
    area = np.abs(charts.doubled_area)
    piece = layout.chart_labels(charts.corners * 2 + mirrored[:, None].astype(np.int32))
    large = np.bincount(piece, area)[piece] > FEW * np.bincount(charts.label, area)[charts.label]
    most = np.bincount(charts.label, charts.doubled_area)[charts.label] > 0
    turned = lies_on_itself & np.where(large, mirrored, most)
    corners = charts.corners * 2 + turned[:, None].astype(np.int32)
    return replace(charts, corners=corners, label=layout.chart_labels(corners))


def _joined(parts: Sequence[Charts]) -> Charts:
    """Charts of several meshes in one texture."""
    corner = label = 0
    corners, labels = [np.zeros((0, 3), np.int32)], [np.zeros(0, np.int32)]
    for part in parts:
        corners.append(part.corners + np.int32(corner))
        labels.append(part.label + np.int32(label))
        corner += int(part.corners.max(initial=-1)) + 1
        label += part.count
    uv = np.concatenate([np.zeros((0, 3, 2)), *(part.uv for part in parts)])
    rows = np.arange(len(uv), dtype=np.int32)
    return Charts(rows, uv, np.concatenate(corners), np.zeros(len(uv), np.int32), np.concatenate(labels))


def _folds(
    whole: Charts, found: layout.UvOverlaps, charts: list[Charts], anew: list[Bool], rows: Sequence[I32]
) -> None:
    """Mark in `anew` what must leave its chart because the chart lies on itself; moving charts apart is enough else."""
    folded = np.unique(found.charts[found.charts[:, 0] == found.charts[:, 1], 0])
    if not len(folded):
        return
    own = layout.uv_overlaps(whole.uv, whole.label, whole.label).faces
    area = np.abs(whole.doubled_area)
    total = np.bincount(whole.label, area, whole.count)
    share = np.bincount(whole.label, area * own, whole.count) / np.where(total > 0, total, 1.0)
    many = np.zeros(whole.count, bool)
    many[folded] = share[folded] > FEW
    marked = own | many[whole.label]
    start = 0
    for part, part_rows, wrong in zip(charts, rows, anew, strict=True):
        mine = marked[start : start + len(part.rows)]
        wrong[np.searchsorted(part_rows, part.rows[mine])] = True
        start += len(part.rows)


def _middle_density(parts: Sequence[tuple[F64, F64]]) -> float | None:
    """Texels to a unit of length: the median by area of surfaces and their texels, None where there are none."""
    surface, texels = (np.concatenate([np.zeros(0), *column]) for column in zip(*parts, strict=True))
    good = (surface > 0) & (texels > 0)
    if not good.any():
        return None
    density = np.sqrt(texels[good] / surface[good])
    order = np.argsort(density)
    share = np.cumsum(surface[good][order])
    return float(density[order[np.searchsorted(share, share[-1] / 2)]])


def _new_density(mesh: Mesh, rows: I32, options: RepairOptions) -> float:
    """Texels to a unit for a mesh whose faces all are new."""
    side = options.size or NO_TEXTURE[0]
    area = float(_areas(mesh.positions[mesh.faces[rows]]).sum())
    return float(np.sqrt(0.55 * side * side / area)) if area > 0 else 1.0


def _areas(corners: F64) -> F64:
    areas: F64 = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    return areas


def _flat_areas(uv: F64) -> F64:
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    areas: F64 = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    return areas
