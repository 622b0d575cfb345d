"""When a level may take over from the finer one before it: as soon as nobody can see its error."""

from __future__ import annotations

import dataclasses
import math

from lodpipe.core.asset import Asset, Lod, Switch
from lodpipe.geometry.flatten import flatten

SCREEN_HEIGHT = 1080
"""Pixels of the screen that switches are settled for."""
VISIBLE = 1.0
"""Pixels of deviation that are not seen yet."""
SMALLEST = 4.0
"""Pixels of height below which no level is told from another."""
FIELD_OF_VIEW = math.radians(60)
STEP = 0.9
"""A level's coverage is at most this share of the finer one's: MSFT_lod asks for descending values."""


def settle_switches(asset: Asset) -> Asset:
    """`asset` with `Lod.switch` set on each level that has none.

    Where pictures were taken the coverage is the share of SCREEN_HEIGHT up to which no difference is seen in them. Else
    a deviation of e % of the bounding-box diagonal covers e/100 · s · SCREEN_HEIGHT pixels when the diagonal takes
    the share s of the screen's height, so s = 100 · VISIBLE / (e · SCREEN_HEIGHT), at most 1. e is the measured
    Hausdorff distance, or the decimator's estimate where nothing was measured. The distance is where a camera sees
    the diagonal under that share of its vertical field of view.
    """
    if not asset.lods or all(level.switch for level in asset.lods):
        return asset
    diagonal = flatten(asset).diagonal
    levels: list[Lod] = []
    for level in asset.lods:
        if level.switch is None:
            coverage = 1.0 if not levels else min(_unseen(level), STEP * _coverage(levels[-1]))
            level = dataclasses.replace(level, switch=Switch(coverage, _distance(diagonal, coverage, bool(levels))))
        levels.append(level)
    return dataclasses.replace(asset, lods=tuple(levels))


def coverages(levels: tuple[Lod, ...]) -> list[float]:
    """MSFT_screencoverage for settled levels: where each one gives way to the next; the last is never hidden (0)."""
    return [*(_coverage(level) for level in levels[1:]), 0.0]


def _coverage(level: Lod) -> float:
    return level.switch.screen_coverage if level.switch else 1.0


def _unseen(level: Lod) -> float:
    if level.visual and level.visual.unseen_height is not None:
        return min(max(level.visual.unseen_height, SMALLEST) / SCREEN_HEIGHT, 1.0)
    deviation = level.error.max if level.error else level.estimate
    if not deviation > 0:
        return 1.0
    return 100.0 * VISIBLE / (deviation * SCREEN_HEIGHT)


def _distance(diagonal: float, coverage: float, coarser: bool) -> float:
    return diagonal / (2.0 * coverage * math.tan(FIELD_OF_VIEW / 2.0)) if coarser and coverage > 0 else 0.0
