"""Decimation of meshes and whole assets: one budget over all parts, every level from one pass of the kernel.

The triangles go where the error is largest: all meshes of an asset enter the kernel together, each in the place and
at the size at which the scene shows it, so that a collapse in a button competes with one in the housing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, overload

import numpy as np

from lodpipe import kernel
from lodpipe.core.asset import Asset, Lod, Target
from lodpipe.core.errors import Cancelled, InvalidMesh
from lodpipe.core.mesh import F32, Mesh
from lodpipe.geometry.content import Content, small
from lodpipe.geometry.joined import AttributeWeights, Joined, Unseen, without_doubles
from lodpipe.geometry.pictures import Gallery, Setup
from lodpipe.geometry.shading import with_normals
from lodpipe.geometry.similarity import decimate_joined
from lodpipe.geometry.texture import U8, Textures
from lodpipe.geometry.trials import WAYS, Jury, Way
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
    beside = ("weights", "metric", "pixels", "unseen", "trials", "threads")
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
    trials: int = 1,
    threads: int = 0,
    progress: Callable[[float, float], None] = _no_progress,
    cancelled: Callable[[], bool] = lambda: False,
) -> tuple[Lod, ...]:
    """All levels of an asset: level 0, the source, and one for each target, in the targets' order.

    Meshes with a `keep_reason` pass as they are; their triangles count against the target. `pixels` holds the decoded
    images by their row, for the metric `visual` and for SimilarityOptions; factor colours stand in for the rest.
    `trials`: in how many ways (at most `len(WAYS)`) the metric `visual` makes each level, of which that is kept which
    looks best. `unseen` (`Sight.of`) judges targets in pixels, and has to be given for them if the asset has textures.
    Raises InvalidMesh for a target out of range, Cancelled when `cancelled` says so.
    """

    def check(levels: Sequence[kernel.Level] = ()) -> None:
        if any(level.stop == "cancelled" for level in levels) or cancelled():
            raise Cancelled("cancelled")

    options = options or QuadricOptions()
    source = Lod(meshes=asset.meshes)
    visual = metric == "visual" and isinstance(options, QuadricOptions)
    asset = replace(asset, meshes=tuple(m if m.keep_reason else without_doubles(m) for m in asset.meshes))
    if visual:
        asset = replace(asset, meshes=tuple(m if m.keep_reason else with_normals(m) for m in asset.meshes))
    joined = Joined.of(asset)
    if visual:
        joined = joined.seen(vertex_visibility(asset, threads))
    check()
    fixed = source.triangles - len(joined.faces)
    counts = [_count(goal, source.triangles) for goal in targets]
    wanted = sorted({max(c - fixed, 0) for c in counts if c is not None}, reverse=True)
    by_error = any(c is None for c in counts)
    # what prices are for: the coarsest level; of levels that are found by measuring, a guess
    coarsest = min((c for c in counts if c), default=max(source.triangles // 10, 1))
    goals = [*wanted, 0] if by_error and (not wanted or wanted[-1]) else wanted
    extreme = asset.importance is not None and len(asset.importance.reserved) > 0
    ways = WAYS[: max(trials, 1)] if visual and not extreme else WAYS[:1]

    def step(done: int, total: int, number: int = 0) -> bool:
        progress(number * total + done, len(ways) * total)
        return not cancelled()

    def refine(level: kernel.Level) -> kernel.Level:
        return level

    made: list[dict[int, kernel.Level]] = []
    if isinstance(options, SimilarityOptions):
        options = replace(options, record=options.record or by_error, keep_last=fixed == 0)
        result: kernel.Decimation = decimate_joined(asset, joined, goals, options, pixels or {}, threads, step)
        check(result.levels)
        made.append({level.target: level for level in result.levels})
    else:
        options = replace(options, record=options.record or by_error, keep_last=fixed == 0)
        content = Content.of(asset, pixels or {}, coarsest, threads) if visual else None
        check()
        for number, way in enumerate(ways):
            run = _Pass.of(asset, joined, options, weights, content, way, coarsest, threads)
            check()
            found = run.levels(goals, partial(step, number=number))
            check(found.levels)
            if number == 0:
                result, refine = found, partial(run.fitted, cancelled=cancelled)
            made.append({level.target: run.fitted(level, cancelled) for level in found.levels})
    if asset.importance is not None and extreme:
        made[0] |= joined.recognisable(asset.importance, list(made[0].values()), options, threads)
    jury = Jury(asset, small((pixels or {}).get), threads) if len(ways) > 1 else None
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
        candidates = []
        for levels in made:
            level = levels[max(count - fixed, 0)]
            reached = len(level.faces) + fixed <= count
            reason = "target" if reached else "kept meshes" if level.stop == "triangles" else level.stop
            candidates.append(joined.lod(asset, level, goal, reason))
        if jury is None:
            lods += candidates
            continue
        check()
        least = min(lod.triangles for lod in candidates)
        candidates = [lod for lod in candidates if lod.triangles <= max(least, count)]
        lods.append(candidates[jury.best([asset.at(lod) for lod in candidates])])
    return tuple(lods)


@dataclass(frozen=True, eq=False)
class _Pass:
    """One run of the kernel over the joined meshes, with what it takes."""

    asset: Asset
    joined: Joined
    fits: bool
    options: QuadricOptions
    values: F32
    column_weights: list[float]
    seam_scale: F32 | None
    held: F32 | None
    threads: int

    @staticmethod
    def of(
        asset: Asset,
        joined: Joined,
        options: QuadricOptions,
        weights: AttributeWeights | None,
        content: Content | None,
        way: Way,
        coarsest: int,
        threads: int,
    ) -> _Pass:
        """`content` is given for the metric `visual` alone; `way` multiplies its prices."""
        seam_scale, held = joined.real_seams, None
        if content is not None:
            seams = content.seams(way.seam) / max(options.seam_weight, 1e-6)
            priced = joined.from_soup(asset, content.soup, seams)
            seam_scale = priced if seam_scale is None else priced * seam_scale
            held = joined.at_vertices(joined.from_soup(asset, content.soup, way.seam * content.held))
            if not options.attribute_cost:
                plain = AttributeWeights()
                options = replace(options, attribute_cost=True)
                weights = AttributeWeights(
                    uv=way.slip * content.uv,
                    normal=way.normal * plain.normal,
                    color=way.slip * plain.color,
                    motion=(weights or plain).motion,
                )
        # half-edge collapses invent no values
        fits = content is not None and options.placement != "endpoint"
        values, column_weights = joined.columns(options, weights or AttributeWeights(), coarsest)
        options = replace(
            options,
            chart_column=joined.chart_column,
            attribute_cost=options.attribute_cost or joined.moves,
            follow=fits or joined.moves,
        )
        return _Pass(asset, joined, fits, options, values, column_weights, seam_scale, held, threads)

    def levels(self, goals: list[int], step: Callable[[int, int], bool]) -> kernel.Decimation:
        """The levels as the collapses leave them."""

        def run(factors: F32 | None, wanted: list[int]) -> kernel.Decimation:
            return kernel.decimate(
                self.joined.positions,
                self.joined.faces,
                wanted,
                self.options,
                wedges=self.joined.wedges,
                values=self.values,
                column_weights=self.column_weights,
                importance=factors,
                locked=self.joined.pinned,
                seam_scale=self.seam_scale,
                threads=self.threads,
                progress=step,
            )

        result = run(self.joined.importance, goals)
        if self.asset.importance is None or not self.asset.importance.shares:
            return result
        return replace(result, levels=self.joined.with_shares(self.asset.importance.shares, result.levels, run))

    def fitted(self, level: kernel.Level, cancelled: Callable[[], bool]) -> kernel.Level:
        """The level as it is emitted."""
        if not self.fits:
            return level
        fitted = self.joined.fit(level, self.held, self.threads, cancelled)
        if cancelled():  # what there is of it by then
            raise Cancelled("cancelled")
        return fitted


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
