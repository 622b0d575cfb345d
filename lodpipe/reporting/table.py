"""Plain text tables and colours, for terminals and log files alike."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import TextIO

_CODES = {"bold": "1", "dim": "2", "red": "31", "green": "32", "yellow": "33"}


class Style:
    """Colours, where they are wanted: on a terminal, and neither NO_COLOR nor a dumb terminal forbids them."""

    def __init__(self, stream: TextIO) -> None:
        allowed = not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"
        self.colours = allowed and stream.isatty()

    def __call__(self, text: str, colour: str) -> str:
        return f"\x1b[{_CODES[colour]}m{text}\x1b[0m" if self.colours else text


def table(head: Sequence[str], rows: Iterable[Sequence[str]], indent: int = 2) -> list[str]:
    """Lines of a table. Columns whose heading begins with ``>`` stand to the right."""
    body = [list(row) for row in rows]
    right = [title.startswith(">") for title in head]
    cells = [[title.removeprefix(">") for title in head], *body]
    widths = [max(len(row[column]) for row in cells) for column in range(len(head))]
    lines = []
    for row in cells:
        parts = [
            cell.rjust(width) if is_right else cell.ljust(width)
            for cell, width, is_right in zip(row, widths, right, strict=True)
        ]
        lines.append((" " * indent + "  ".join(parts)).rstrip())
    return lines


def size(count: float | None) -> str:
    """A number of bytes: 812 B, 1.2 kB, 34.5 MB."""
    if count is None:
        return "–"
    for unit in ("B", "kB", "MB"):
        if count < 1000:
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000
    return f"{count:.1f} GB"


def number(value: float | int | None) -> str:
    """A count with separators, or a figure with three significant digits; a dash for None."""
    if value is None:
        return "–"
    if isinstance(value, int):
        return f"{value:,}"
    if value == 0:
        return "0"
    return f"{value:.3g}" if 1e-4 <= abs(value) < 1e6 else f"{value:.2e}"


def clean(text: str) -> str:
    """`text` on one line and without control characters, which a file's name may hold."""
    return "".join(char if char.isprintable() else "?" for char in text)
