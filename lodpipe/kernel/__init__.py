"""Native code behind pure functions on arrays: checked wrappers over the compiled module."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.errors import InvalidMesh
from lodpipe.core.mesh import F32, F64, I32
from lodpipe.kernel import _native
from lodpipe.kernel.similarity import (
    SIMILARITY_RANGES,
    Appearance,
    SimilarityOptions,
    native_appearance,
    native_options,
)

Placement = Literal["optimal", "endpoint", "midpoint"]
Weighting = Literal["uniform", "area", "area-angle"]

PLACEMENTS: tuple[Placement, ...] = ("optimal", "endpoint", "midpoint")
WEIGHTINGS: tuple[Weighting, ...] = ("uniform", "area", "area-angle")
#: Why a level stopped, by the kernel's number.
STOP_REASONS = ("triangles", "error", "topology", "flip", "seams", "locked", "last", "cancelled")


@dataclass(frozen=True)
class QuadricOptions:
    """How the quadric decimator weighs, places and guards; see docs/decimation.md for when to change what."""

    placement: Placement = "optimal"
    """Where the merged vertex goes: the quadric's minimum (falling back to the best point of the edge), one of the
    two ends (a half-edge collapse: only vertices of the input remain), or the middle."""
    weighting: Weighting = "area"
    """Weight of a face's plane: 1, its area / 3, or its area × its angle at the vertex / π."""
    boundary_weight: float = 0.15
    """Weight of the planes that hold open boundaries, × squared edge length; ≥ 0."""
    seam_weight: float = 0.03
    """The same at seams (one position, several wedges), material borders and edges of more than two faces."""
    crease_weight: float = 0.0
    """The same at edges sharper than `crease_degrees`."""
    crease_degrees: float = 60.0
    """Dihedral turn from which an edge is a crease, 0…180."""
    pair_distance: float = 0.0
    """Vertices closer than this (object units) may merge without an edge between them (aggregation); 0: edges only."""
    attribute_cost: bool = False
    """Whether attributes steer (Hoppe 1999); if not they are carried all the same."""
    keep_topology: bool = False
    """Refuse collapses that would change the topology (link condition): holes, handles and manifolds stay."""
    may_relax: bool = True
    """Give the link condition up when the target cannot be reached otherwise."""
    flip_degrees: float = 78.0
    """Largest turn of a face's normal in one collapse, 0…90."""
    round_share: float = 0.1
    """Share of the live vertices that a round considers, 0…1: smaller is nearer to the best order, larger is faster."""
    max_error: float | None = None
    """Stop where the estimated deviation would pass this, object units."""
    keep_last: bool = False
    """Leave the last triangles, whatever the target."""
    chart_column: int | None = None
    """Column of `values` that holds u, with v after it: at seams new UVs stay within their chart."""
    record: bool = False
    """Keep the sequence of collapses, from which `rebuild` makes any level between."""
    follow: bool = False
    """Levels say what became of the input's vertices and wedges (`Level.vertex_to`, `wedge_to`), which `fit` needs."""


@dataclass(frozen=True, eq=False)
class Level:
    """One level as arrays; `*_source` are rows of the input, −1 where the values are new.

    positions (V, 3) float64, faces and wedges (F, 3) int32, values (W, K) float32, vertex_source (V,), face_source
    (F,) and wedge_source (W,) int32. `error` is the estimated deviation in object units. With `follow`, vertex_to and
    wedge_to hold for each row of the input the level's row that it was merged into, −1 where nothing is left of it.
    """

    target: int
    stop: str
    error: float
    relaxed: bool
    positions: F64
    faces: I32
    wedges: I32
    values: F32
    vertex_source: I32
    face_source: I32
    wedge_source: I32
    vertex_to: I32 = field(default_factory=lambda: np.empty(0, np.int32))
    wedge_to: I32 = field(default_factory=lambda: np.empty(0, np.int32))


@dataclass(frozen=True, eq=False)
class Record:
    """The sequence of N collapses, and M events in which wedges merged or changed their values.

    removed, kept (N,) int32 input vertices; positions (N, 3) float64 of `kept` afterwards; triangles (N,) int32 removed
    with it; error (N,) float32 object units; wedge_event (M,) int32 ascending row of the collapse; wedge_from, wedge_to
    (M,) int32 input wedges; wedge_values (M, K) float32 of `wedge_to` afterwards.
    """

    removed: I32
    kept: I32
    positions: F64
    triangles: I32
    error: F32
    wedge_event: I32
    wedge_from: I32
    wedge_to: I32
    wedge_values: F32


@dataclass(frozen=True, eq=False)
class EdgeCosts:
    """edges (E, 2) int32, rows of the positions; cost (E,) float32 ≥ 0, of the mesh scaled to a bounding box of unit
    diagonal, infinite where the collapse is not possible; positions (E, 3) float64 of the merged vertex."""

    edges: I32
    cost: F32
    positions: F64


@dataclass(frozen=True, eq=False)
class Decimation:
    """Levels in the order of the targets, and the record if it was asked for."""

    levels: list[Level] = field(default_factory=list)
    record: Record | None = None


def decimate(
    positions: F64,
    faces: I32,
    targets: Sequence[int],
    options: QuadricOptions | None = None,
    *,
    wedges: I32 | None = None,
    values: F32 | None = None,
    column_weights: Sequence[float] = (),
    importance: F32 | None = None,
    locked: NDArray[np.bool_] | None = None,
    seam_scale: F32 | None = None,
    threads: int = 0,
    progress: Callable[[int, int], bool] | None = None,
) -> Decimation:
    """Quadric error decimation of a triangle mesh with wedges, all targets in one pass.

    positions       (V, 3) float64
    faces           (F, 3) int32, rows of `positions`
    targets         triangles, each ≥ 0, descending
    wedges          (F, 3) int32, rows of `values`; left out: the faces. Faces on the two sides of a material border
                    must have different wedges
    values          (W, K) float32 attributes
    column_weights  K numbers ≥ 0: object units that a unit of the attribute is worth; 0: carried, does not steer
    importance      (V,) float32 > 0, multiplies the vertex's quadric
    locked          (V,) bool: neither moved nor removed
    seam_scale      (F, 3) float32 ≥ 0, multiplies `seam_weight` at the edge from corner k to k + 1
    threads         0: all cores; the result does not depend on it
    progress        called with (triangles removed, triangles to remove); False stops

    Planes: Garland & Heckbert 1997. Attributes: Hoppe 1999, each a linear function over the face. Degenerate faces
    of the input are left out. Raises InvalidMesh for arrays that do not fit together.
    """
    options = options or QuadricOptions()
    goals = _goals(targets)
    arrays = _checked(positions, faces, wedges, values, column_weights, importance, locked)
    if options.chart_column is not None and not 0 <= options.chart_column < arrays[3].shape[1] - 1:
        raise InvalidMesh(f"chart_column {options.chart_column} needs two columns from there on")
    scale = _seam_scale(seam_scale, len(arrays[1]))
    run = progress or (lambda done, total: True)
    try:
        given = _native.decimate(*arrays, scale, goals, run, _options(options, threads))
    except ValueError as error:  # more pairs than there are numbers for
        raise InvalidMesh(str(error)) from None
    levels = [_level(data) for data in given["levels"]]
    record = _record(given["record"], arrays[3].shape[1]) if options.record else None
    return Decimation(levels, record)


def fit(
    positions: F64,
    faces: I32,
    wedges: I32,
    values: F32,
    level: Level,
    samples: int,
    *,
    moves: int = 2,
    fit_values: bool = True,
    chart_column: int | None = None,
    importance: F32 | None = None,
    held: F32 | None = None,
    threads: int = 0,
    go_on: Callable[[], bool] | None = None,
) -> Level:
    """A level of `decimate` (made with `follow`) whose vertices and values fit the input best, in the least squares.

    positions, faces, wedges, values   the input of `decimate`, as `decimate` takes it
    samples       points spread over the input by area, about, from which the fit is made; if there are more than faces,
                  every face has some
    moves         rounds in which positions move; 0: they stay
    fit_values    whether values are fitted, too; if not they stay
    chart_column  column of `values` that holds u, with v after it: at the border of a chart they stay near it
    importance    (V,) float32 > 0, multiplies the area round the vertex
    held          (V,) float32 ≥ 0, a length: an edge e of the level at which a chart ends, between two vertices that
                  stand for such as hold h, pays h · |e| · d² for a step d of an end across it, in each of its faces
    go_on         asked between the steps; False stops, with what there is by then

    Positions minimise the squared distance of the samples across the surface (and, with a small weight, along it),
    values the squared difference at the samples; see docs/decimation.md. No face turns by more than 78°. The result
    does not depend on `threads` (0: all cores).
    """
    if samples < 1 or moves < 0 or threads < 0:
        raise InvalidMesh("a fit needs at least one sample, and numbers that are not negative")
    carried = values.shape[1] > 0  # without values the kernel does not follow wedges
    native = _native.FitOptions()
    native.samples, native.moves, native.fit_values = samples, moves, fit_values
    native.chart_column = -1 if chart_column is None else chart_column
    native.threads = threads or os.cpu_count() or 1
    made = _native.fit(
        positions,
        faces,
        wedges if carried else faces,
        values,
        level.positions,
        level.faces,
        level.wedges if carried else level.faces,
        level.values,
        _column(importance, np.float32, len(positions), "importance"),
        _column(held, np.float32, len(positions), "held"),
        level.wedge_to if carried else level.vertex_to,
        go_on or (lambda: True),
        native,
    )
    moved = made["moved"].astype(bool)
    return replace(
        level,
        positions=made["positions"],
        values=made.get("values", level.values),
        vertex_source=np.where(moved, -1, level.vertex_source).astype(np.int32),
        wedge_source=np.full_like(level.wedge_source, -1) if fit_values else level.wedge_source,
    )


def vertex_visibility(
    positions: F32, faces: I32, hides: NDArray[np.bool_], views: F64, side: int, threads: int = 0
) -> F32:
    """(V,) float32 0…1: the share of each vertex's faces that is seen from outside.

    positions  (V, 3) float32, those of the faces within the unit sphere
    faces      (F, 3) int32
    hides      (F,) bool: False for what covers nothing, and counts as seen
    views      (N, 3) float64 unit vectors; each stands for its opposite, too
    side       pixels of a picture of the sphere, each way

    From every view the nearest face is drawn into pictures, by parallel projection. The share is that of the pixels
    which the faces round a vertex would take up if they were alone, one side of them taken alone; four pixels more
    stand for the views in which it lies no farther than two pixels behind what is seen there, so that faces smaller
    than pixels are not lost. A vertex has the largest share among its neighbours. The result does not depend on
    `threads` (0: all cores). Raises InvalidMesh for arrays that do not fit together.
    """
    positions = _table(positions, np.float32, 3, "positions")
    faces = _table(faces, np.int32, 3, "faces")
    views = _table(views, np.float64, 3, "views")
    _indices(faces, len(positions), "faces")
    used = positions[faces]
    if not (np.abs(used) <= 1.001).all():
        raise InvalidMesh("positions must lie within the unit sphere")
    if not 0 < side <= 16384 or threads < 0:
        raise InvalidMesh("pictures are 1 to 16384 pixels wide, and threads not negative")
    mask = _column(hides, np.uint8, len(faces), "hides")
    seen = _native.vertex_visibility(positions, faces, mask, views, side, threads or os.cpu_count() or 1)
    return np.asarray(seen, np.float32)


def edge_costs(
    positions: F64,
    faces: I32,
    options: QuadricOptions | None = None,
    *,
    wedges: I32 | None = None,
    values: F32 | None = None,
    column_weights: Sequence[float] = (),
    importance: F32 | None = None,
    locked: NDArray[np.bool_] | None = None,
    seam_scale: F32 | None = None,
) -> EdgeCosts:
    """What collapsing each edge of the mesh as it is would cost, and where the merged vertex would lie.

    Parameters as for `decimate`. Raises InvalidMesh for arrays that do not fit together.
    """
    arrays = _checked(positions, faces, wedges, values, column_weights, importance, locked)
    scale = _seam_scale(seam_scale, len(arrays[1]))
    return EdgeCosts(**_native.edge_costs(*arrays, scale, _options(options or QuadricOptions(), 1)))


@dataclass(frozen=True, eq=False)
class Similarity(Decimation):
    """costs (N,) float64 of the collapses in their order, and how many costs were evaluated for them."""

    costs: F64 = field(default_factory=lambda: np.empty(0))
    evaluations: int = 0


def similarity_decimate(
    positions: F64,
    faces: I32,
    targets: Sequence[int],
    appearance: Appearance,
    options: SimilarityOptions | None = None,
    *,
    wedges: I32 | None = None,
    values: F32 | None = None,
    column_weights: Sequence[float] = (),
    importance: F32 | None = None,
    locked: NDArray[np.bool_] | None = None,
    threads: int = 0,
    progress: Callable[[int, int], bool] | None = None,
) -> Similarity:
    """Decimation by what is seen, one queue of lazily evaluated collapses, all targets in one pass.

    Parameters as for `decimate`, but for `appearance` and: column_weights weigh the UV columns in the placement of
    full-edge collapses; importance (V,) multiplies costs. Raises InvalidMesh for arrays that do not fit together, and
    for `texture_deviation` or the correspondence `uv` without UVs.
    """
    options = options or SimilarityOptions()
    goals = _goals(targets)
    arrays = _checked(positions, faces, wedges, values, column_weights, importance, locked)
    seen = native_appearance(appearance, options, len(arrays[1]), arrays[3].shape[1])
    native = _similarity_options(options, threads)
    given = _native.similarity_decimate(*arrays, *seen, goals, progress or (lambda done, total: True), native)
    levels = [_level(data) for data in given["levels"]]
    record = _record(given["record"], arrays[3].shape[1]) if options.record else None
    return Similarity(levels, record, given["costs"], given["evaluations"])


def similarity_costs(
    positions: F64,
    faces: I32,
    appearance: Appearance,
    options: SimilarityOptions | None = None,
    *,
    wedges: I32 | None = None,
    values: F32 | None = None,
    column_weights: Sequence[float] = (),
    importance: F32 | None = None,
    locked: NDArray[np.bool_] | None = None,
) -> tuple[I32, F64, F64]:
    """What each collapse of the mesh as it is would cost.

    (N, 2) int32: the vertex that goes and the one that stays; (N,) float64 cost, infinite where it is refused;
    (N, 3) float64 place of the latter afterwards. Parameters as for `similarity_decimate`.
    """
    options = options or SimilarityOptions()
    arrays = _checked(positions, faces, wedges, values, column_weights, importance, locked)
    seen = native_appearance(appearance, options, len(arrays[1]), arrays[3].shape[1])
    given = _native.similarity_costs(*arrays, *seen, _similarity_options(options, 1))
    return given["pairs"], given["cost"], given["places"]


def _similarity_options(options: SimilarityOptions, threads: int) -> _native.SimilarityOptions:
    _check_ranges(options, SIMILARITY_RANGES, threads)
    native = _native.SimilarityOptions()
    for name, value in native_options(options).items():
        setattr(native, name, value)
    native.threads = threads or os.cpu_count() or 1
    return native


def _goals(targets: Sequence[int]) -> list[int]:
    goals = [int(t) for t in targets]
    if any(t < 0 for t in goals) or goals != sorted(goals, reverse=True):
        raise InvalidMesh(f"targets must be descending and not negative (got {goals})")
    return goals


def _checked(
    positions: F64,
    faces: I32,
    wedges: I32 | None,
    values: F32 | None,
    column_weights: Sequence[float],
    importance: F32 | None,
    locked: NDArray[np.bool_] | None,
) -> tuple[Any, Any, Any, Any, Any, Any, Any]:
    """The arrays as the native functions take them."""
    positions = _table(positions, np.float64, 3, "positions")
    faces = _table(faces, np.int32, 3, "faces")
    wedges = faces if wedges is None else _table(wedges, np.int32, 3, "wedges")
    if wedges.shape != faces.shape:
        raise InvalidMesh(f"there are {len(faces)} faces and {len(wedges)} rows of wedges")
    if values is None:
        values = np.empty((int(wedges.max(initial=-1)) + 1, 0), np.float32)
    values = _table(values, np.float32, None, "values")
    weights = np.asarray(column_weights, np.float32)
    if weights.shape != (values.shape[1],):
        raise InvalidMesh(f"there are {values.shape[1]} attribute columns and {weights.size} weights")
    if not (np.isfinite(weights).all() and (weights >= 0).all()):
        raise InvalidMesh("attribute weights must be finite and not negative")
    if not np.isfinite(positions).all():
        raise InvalidMesh("positions are not finite")
    if not np.isfinite(values).all():
        raise InvalidMesh("attribute values are not finite")
    if len(faces) >= 2**29:
        raise InvalidMesh("more than 2^29 triangles in one mesh")
    _indices(faces, len(positions), "faces")
    _indices(wedges, len(values), "wedges")
    if wedges is not faces:
        owner = np.empty(len(values), np.int32)
        owner[wedges] = faces
        if not np.array_equal(owner[wedges], faces):
            shared = int(wedges[owner[wedges] != faces][0])
            raise InvalidMesh(f"wedge {shared} is used at more than one position")
    return (
        positions,
        faces,
        wedges,
        values,
        weights,
        _column(importance, np.float32, len(positions), "importance"),
        _column(locked, np.uint8, len(positions), "locked"),
    )


def _options(options: QuadricOptions, threads: int) -> _native.Options:
    _check_options(options, threads)
    native = _native.Options()
    native.placement = PLACEMENTS.index(options.placement)
    native.weighting = WEIGHTINGS.index(options.weighting)
    native.crease_cos = float(np.cos(np.radians(options.crease_degrees)))
    native.flip_cos = float(np.cos(np.radians(options.flip_degrees)))
    native.max_error = -1.0 if options.max_error is None else options.max_error
    native.chart_column = -1 if options.chart_column is None else options.chart_column
    native.threads = threads or os.cpu_count() or 1
    for name in (
        "boundary_weight",
        "seam_weight",
        "crease_weight",
        "pair_distance",
        "attribute_cost",
        "keep_topology",
        "may_relax",
        "keep_last",
        "round_share",
        "record",
        "follow",
    ):
        setattr(native, name, getattr(options, name))
    return native


def _check_options(options: QuadricOptions, threads: int) -> None:
    if options.placement not in PLACEMENTS or options.weighting not in WEIGHTINGS:
        raise InvalidMesh(f"placement is one of {PLACEMENTS}, weighting one of {WEIGHTINGS}")
    ranges = {
        "boundary_weight": (0, 1e9),
        "seam_weight": (0, 1e9),
        "crease_weight": (0, 1e9),
        "crease_degrees": (0, 180),
        "pair_distance": (0, np.finfo(np.float64).max),
        "flip_degrees": (0, 90),
        "round_share": (0, 1),
        "max_error": (0, np.inf),
    }
    _check_ranges(options, ranges, threads)


def _check_ranges(options: Any, ranges: Mapping[str, tuple[float, float]], threads: int) -> None:
    for name, (low, high) in ranges.items():
        value = getattr(options, name)
        if value is not None and not low <= value <= high:
            raise InvalidMesh(f"{name} lies from {low:g} to {high:g} (got {value:g})")
    if threads < 0:
        raise InvalidMesh(f"threads must not be negative (got {threads})")


def _level(data: dict[str, Any]) -> Level:
    values = data.pop("values", None)
    if values is None:
        values = np.empty((len(data["wedge_source"]), 0), np.float32)
    return Level(**{**data, "stop": STOP_REASONS[data["stop"]]}, values=values)


def _record(data: dict[str, Any], columns: int) -> Record:
    if not columns:
        data["wedge_values"] = np.empty((len(data["wedge_event"]), 0), np.float32)
    return Record(**data)


def _table(array: Any, dtype: Any, columns: int | None, name: str) -> Any:
    given = np.ascontiguousarray(array)
    if given.ndim != 2 or (columns is not None and given.shape[1] != columns):
        raise InvalidMesh(f"{name} must be a table of {columns or 'K'} columns (got the shape {given.shape})")
    if np.issubdtype(dtype, np.integer) and given.dtype.kind not in "iu":
        raise InvalidMesh(f"{name} must be integers (got {given.dtype})")
    return np.ascontiguousarray(given, dtype)


def _column(array: Any, dtype: Any, rows: int, name: str) -> Any:
    if array is None:
        return None
    given = np.ascontiguousarray(array, dtype)
    if given.shape != (rows,):
        raise InvalidMesh(f"{name} must have {rows} values (got the shape {given.shape})")
    if name == "importance" and not (np.isfinite(given).all() and (given > 0).all()):
        raise InvalidMesh("importance must be finite and positive")
    return given


def _seam_scale(array: Any, faces: int) -> Any:
    if array is None:
        return None
    given = _table(array, np.float32, 3, "seam_scale")
    if len(given) != faces or not (np.isfinite(given).all() and (given >= 0).all()):
        raise InvalidMesh(f"seam_scale must have {faces} rows of finite numbers that are not negative")
    return given


def _indices(indices: I32, rows: int, name: str) -> None:
    if indices.size and (int(indices.min()) < 0 or int(indices.max()) >= rows):
        raise InvalidMesh(f"{name} point outside their {rows} rows")
