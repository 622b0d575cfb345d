"""Line charts as SVG, coloured by the page's style sheet; every number in them is also in the page's tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from lodpipe.reporting.table import number

WIDTH, HEIGHT = 520, 300
LEFT, RIGHT, TOP, BOTTOM = 62, 14, 16, 44
"""Room for the axes' words."""
POWERS = 4
"""More powers of ten than that are not all marked."""


@dataclass(frozen=True)
class Series:
    """A line: its name, and (x, y) for each point that has both; x and y > 0."""

    name: str
    points: Sequence[tuple[float, float]]


def chart(title: str, x_label: str, y_label: str, series: Sequence[Series], *, log_y: bool = True) -> Markup:
    """The lines of `series` over a logarithmic x axis; empty where no series has two points."""
    lines = [Series(s.name, sorted(p for p in s.points if p[0] > 0 and (p[1] > 0 or not log_y))) for s in series]
    lines = [s for s in lines if len(s.points) > 1]
    if not lines:
        return Markup("")
    across = _axis([x for s in lines for x, _ in s.points], True)
    up = _axis([y for s in lines for _, y in s.points], log_y)
    parts = [
        Markup('<svg class="chart" viewBox="0 0 {} {}" role="img" aria-label="{}">').format(WIDTH, HEIGHT, title),
        _grid(across, up),
        Markup('<text class="name" x="{}" y="{}">{}</text>').format(LEFT + _inner()[0] / 2, HEIGHT - 6, x_label),
        Markup('<text class="name" transform="translate(13 {}) rotate(-90)">{}</text>').format(
            TOP + _inner()[1] / 2, y_label
        ),
    ]
    for index, one in enumerate(lines):
        at = [(_x(across, x), _y(up, y)) for x, y in one.points]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in at)
        parts.append(Markup('<g class="series s{}"><polyline points="{}"/>').format(index, path))
        for (x, y), (value, height) in zip(at, one.points, strict=True):
            text = f"{one.name}: {number(height)} at {number(int(value))}"
            parts.append(Markup('<circle cx="{:.1f}" cy="{:.1f}" r="4"><title>{}</title></circle>').format(x, y, text))
        parts.append(Markup("</g>"))
    parts.append(Markup("</svg>"))
    keys = (Markup('<li class="s{}">{}</li>').format(index, one.name) for index, one in enumerate(lines))
    return Markup('<figure class="plot"><figcaption>{}</figcaption>{}<ul class="key">{}</ul></figure>').format(
        title, Markup("").join(parts), Markup("").join(keys)
    )


@dataclass(frozen=True)
class _Axis:
    place: Callable[[float], float]
    """Value to 0…1."""
    ticks: tuple[float, ...]


def _axis(values: Sequence[float], log: bool) -> _Axis:
    low, high = min(values), max(values)
    if log:
        a, b = math.log10(low), math.log10(high)
        spare = max(0.04 * (b - a), (0.7 - (b - a)) / 2)  # wide enough for a round number to lie in it
        a, b = a - spare, b + spare
        return _Axis(lambda value: (math.log10(value) - a) / (b - a), _powers(a, b))
    step = 10 ** math.floor(math.log10(max(high - low, 1e-12)))
    step *= next((m for m in (0.5, 1, 2, 5) if (high - low) / (step * m) <= 5), 5)
    first, last = math.floor(low / step), max(math.ceil(high / step), math.floor(low / step) + 1)
    ticks = tuple(step * n for n in range(first, last + 1))
    return _Axis(lambda value: (value / step - first) / (last - first), ticks)


def _powers(a: float, b: float) -> tuple[float, ...]:
    """Round numbers between 10**a and 10**b: 1, 2, 5 of each power where there is room, else 1."""
    powers = range(math.floor(a), math.ceil(b) + 1)
    marks = (1, 2, 5) if b - a < 2.5 else (1,)
    skip = max(1, math.ceil((b - a) / POWERS)) if len(marks) == 1 else 1
    found = tuple(m * 10.0**p for p in powers if p % skip == 0 for m in marks)
    return tuple(v for v in found if a <= math.log10(v) <= b)


def _grid(across: _Axis, up: _Axis) -> Markup:
    width, height = _inner()
    parts = []
    for value in across.ticks:
        x = _x(across, value)
        parts.append(Markup('<line x1="{0:.1f}" y1="{1}" x2="{0:.1f}" y2="{2}"/>').format(x, TOP, TOP + height))
        label = _short(value)
        parts.append(Markup('<text class="x" x="{:.1f}" y="{}">{}</text>').format(x, TOP + height + 16, label))
    for value in up.ticks:
        y = _y(up, value)
        parts.append(Markup('<line x1="{0}" y1="{1:.1f}" x2="{2}" y2="{1:.1f}"/>').format(LEFT, y, LEFT + width))
        parts.append(Markup('<text class="y" x="{}" y="{:.1f}">{}</text>').format(LEFT - 7, y + 4, number(value)))
    return Markup('<g class="grid">{}</g>').format(Markup("").join(parts))


def _short(value: float) -> str:
    """A count in few letters: 500, 20 k, 1.5 M."""
    for size, unit in ((1e6, " M"), (1e3, " k")):
        if value >= size:
            return f"{value / size:g}{unit}"
    return f"{value:g}"


def _inner() -> tuple[int, int]:
    return WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM


def _x(axis: _Axis, value: float) -> float:
    return LEFT + axis.place(value) * _inner()[0]


def _y(axis: _Axis, value: float) -> float:
    return TOP + (1 - axis.place(value)) * _inner()[1]
