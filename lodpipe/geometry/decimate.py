"""Decimation of meshes and whole assets: one budget over all parts, every level from one pass of the kernel.

The triangles go where the error is largest: all meshes of an asset enter the kernel together, each in the place and
at the size at which the scene shows it, so that a collapse in a button competes with one in the housing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, overload

import numpy as np

from lodpipe import kernel
from lodpipe.core.asset import Asset, Lod, Target
from lodpipe.core.errors import Cancelled, InvalidMesh
from lodpipe.core.mesh import F32, Mesh
from lodpipe.geometry.content import Content
from lodpipe.geometry.joined import AttributeWeights, Joined, Unseen, without_doubles
from lodpipe.geometry.pictures import Gallery, Setup
from lodpipe.geometry.shading import with_normals
from lodpipe.geometry.similarity import decimate_joined
from lodpipe.geometry.texture import U8, Textures
from lodpipe.geometry.visibility import vertex_visibility
from lodpipe.geometry.visible import Sight
from lodpipe.kernel import QuadricOptions
from lodpipe.kernel.similarity import SimilarityOptions

Metric = Literal["quadric", "visual"]


def _no_progress(done: float, total: float) -> None:
    pass


@overload
def decimate(source: Mesh, target: int | float | Target, **settings: Any) -> Mesh: ...
@overload
def decimate(source: Asset, target: int | float | Target, **settings: Any) -> Asset: ...
def decimate(source: Mesh | Asset, target: int | float | Target, **settings: Any) -> Mesh | Asset:
    """Simplify a mesh, or all meshes of an asset, to one target.

    target    a number of triangles (int), a ratio (float, 0 < ratio ≤ 1), or a `Target`
    settings  fields of `QuadricOptions`, and `weights` (AttributeWeights), `threads` (0: all cores)

    The result has at most so many triangles; fewer collapses than asked for are possible where guards forbid them.
    Raises InvalidMesh for a target outside its range.
    """
    goal = _as_target(target)
    beside = ("weights", "metric", "pixels", "unseen", "threads")
    outside = {name: settings.pop(name) for name in beside if name in settings}
    options = QuadricOptions(**settings)
    if isinstance(source, Mesh):
        asset = Asset(name=source.name, meshes=(source,))
        return decimate_asset(asset, [goal], options, **outside)[1].meshes[0]
    levels = decimate_asset(source, [goal], options, **outside)
    return replace(source, meshes=levels[1].meshes, lods=())


def decimate_asset(
    asset: Asset,
    targets: Sequence[Target],
    options: QuadricOptions | SimilarityOptions | None = None,
    *,
    weights: AttributeWeights | None = None,
    metric: Metric = "quadric",
    pixels: Mapping[int, U8] | None = None,
    unseen: Unseen | None = None,
    threads: int = 0,
    progress: Callable[[float, float], None] = _no_progress,
    cancelled: Callable[[], bool] = lambda: False,
) -> tuple[Lod, ...]:
    """All levels of an asset: level 0, the source, and one for each target, in the targets' order.

    Meshes with a `keep_reason` pass as they are; their triangles count against the target. `pixels` holds the decoded
    images by their row, for the metric `visual` and for SimilarityOptions; factor colours stand in for the rest.
    `unseen` (`Sight.of`) judges targets in pixels, and has to be given for them if the asset has textures. Raises
    InvalidMesh for a target out of range, Cancelled when `cancelled` says so.
    """
    options = options or QuadricOptions()
    source = Lod(meshes=asset.meshes)
    visual = metric == "visual" and isinstance(options, QuadricOptions)
    asset = replace(asset, meshes=tuple(m if m.keep_reason else without_doubles(m) for m in asset.meshes))
    if visual:
        asset = replace(asset, meshes=tuple(m if m.keep_reason else with_normals(m) for m in asset.meshes))
    joined = Joined.of(asset)
    if visual:
        joined = joined.seen(vertex_visibility(asset, threads))
        if cancelled():
            raise Cancelled("cancelled")
    fixed = source.triangles - len(joined.faces)
    counts = [_count(goal, source.triangles) for goal in targets]
    wanted = sorted({max(c - fixed, 0) for c in counts if c is not None}, reverse=True)
    by_error = any(c is None for c in counts)
    fits = visual and getattr(options, "placement", "") != "endpoint"  # half-edge collapses invent no values
    # what prices are for: the coarsest level; of levels that are found by measuring, a guess
    coarsest = min((c for c in counts if c), default=max(source.triangles // 10, 1))
    goals = [*wanted, 0] if by_error and (not wanted or wanted[-1]) else wanted
    seam_scale = None
    if metric == "visual" and isinstance(options, QuadricOptions):
        content = Content.of(asset, pixels or {}, coarsest, threads)
        seam_scale = joined.from_soup(asset, content.soup, content.seams / max(options.seam_weight, 1e-6))
        if not options.attribute_cost:
            options = replace(options, attribute_cost=True)
            weights = AttributeWeights(uv=content.uv, motion=(weights or AttributeWeights()).motion)

    def step(done: int, total: int) -> bool:
        progress(done, total)
        return not cancelled()

    result: kernel.Decimation
    if isinstance(options, SimilarityOptions):
        options = replace(options, record=options.record or by_error, keep_last=fixed == 0)
        result = decimate_joined(asset, joined, goals, options, pixels or {}, threads, step)
    else:
        values, column_weights = joined.columns(options, weights or AttributeWeights(), coarsest)
        own = replace(
            options,
            record=options.record or by_error,
            keep_last=fixed == 0,
            chart_column=joined.chart_column,
            attribute_cost=options.attribute_cost or joined.moves,
            follow=fits or joined.moves,
        )

        def run(factors: F32 | None, wanted: list[int]) -> kernel.Decimation:
            return kernel.decimate(
                joined.positions,
                joined.faces,
                wanted,
                own,
                wedges=joined.wedges,
                values=values,
                column_weights=column_weights,
                importance=factors,
                locked=joined.pinned,
                seam_scale=seam_scale,
                threads=threads,
                progress=step,
            )

        result = run(joined.importance, goals)
        if asset.importance is not None and asset.importance.shares:
            result = replace(result, levels=joined.with_shares(asset.importance.shares, result.levels, run))
    if any(level.stop == "cancelled" for level in result.levels) or cancelled():
        raise Cancelled("cancelled")

    def refine(level: kernel.Level) -> kernel.Level:
        fitted = joined.fit(level, threads, cancelled) if fits else level
        if fits and cancelled():  # what there is of it by then
            raise Cancelled("cancelled")
        return fitted

    made = {level.target: refine(level) for level in result.levels}
    if asset.importance is not None and len(asset.importance.reserved):
        made |= joined.recognisable(asset.importance, list(made.values()), options, threads)
    lods = [source]
    seen: dict[Target, Lod] = {}
    if looks := [goal for goal in targets if goal.pixels is not None]:
        seen = joined.search_pixels(
            asset, looks, result, unseen or _untextured_sight(asset, threads), refine, cancelled
        )
    for goal, count in zip(targets, counts, strict=True):
        if count is None:
            lods.append(seen[goal] if goal in seen else joined.search_error(asset, goal, result, refine, cancelled))
            continue
        level = made[max(count - fixed, 0)]
        reached = len(level.faces) + fixed <= count
        reason = "target" if reached else "kept meshes" if level.stop == "triangles" else level.stop
        lods.append(joined.lod(asset, level, goal, reason))
    return tuple(lods)


def _as_target(target: int | float | Target) -> Target:
    if isinstance(target, Target):
        return target
    if isinstance(target, bool) or not isinstance(target, (int, float, np.integer, np.floating)):
        raise InvalidMesh(f"a target is a number of triangles, a ratio or a Target (got {target!r})")
    return Target(triangles=int(target)) if isinstance(target, (int, np.integer)) else Target(ratio=float(target))


def _count(goal: Target, triangles: int) -> int | None:
    """The goal as a number of triangles; None for a goal that is an error."""
    if goal.triangles is not None:
        if goal.triangles < 1:
            raise InvalidMesh(f"a level needs at least 1 triangle (asked for {goal.triangles})")
        return goal.triangles
    if goal.ratio is not None:
        if not 0 < goal.ratio <= 1:
            raise InvalidMesh(f"a ratio lies above 0 and up to 1 (got {goal.ratio:g})")
        return max(1, round(goal.ratio * triangles))
    if goal.error is not None and goal.error >= 0:
        return None
    if goal.pixels is not None and goal.screen is not None and goal.pixels > 0 and 0 < goal.screen <= 1:
        return None
    raise InvalidMesh(
        "a target needs a ratio, a number of triangles, an error of 0 % or more, or pixels above 0 at a screen share "
        "above 0 and up to 1"
    )


def _untextured_sight(asset: Asset, threads: int) -> Unseen:
    if asset.images:
        raise InvalidMesh(
            "a target in pixels has to see the textures",
            advice="use the stage `decimate` (lodpipe run), or give `unseen`: see lodpipe.geometry.visible.Sight",
        )
    return Sight(Gallery(asset, Setup(), Textures(), threads=threads)).of
