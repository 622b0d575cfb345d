"""What a run says on the terminal: progress while it goes on, a summary for each asset, a last line for all."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Sequence
from typing import Any, Protocol, TextIO

from lodpipe.reporting.table import Style, clean, number, size, table

REDRAW_SECONDS = 0.1
_COLOURS = {"ok": "green", "unchanged": "green", "warnings": "yellow", "over_budget": "red"}
MOST_WARNINGS = 12
"""Warnings of one asset that are shown."""
_WORDS = {
    "ok": "ok",
    "unchanged": "unchanged",
    "warnings": "with warnings",
    "over_budget": "over budget",
    "failed": "failed",
    "bug": "failed by a bug",
}
_FAILED = ".failed"


class Result(Protocol):
    """What became of one asset."""

    input: str
    place: str
    outcome: str
    folder: str
    message: str
    seconds: float
    report: dict[str, Any] | None


class Display:
    """Shows a batch: progress and errors on one stream, results on the other."""

    def __init__(self, out: TextIO, err: TextIO, *, quiet: bool = False) -> None:
        self.out, self.err, self.quiet = out, err, quiet
        self.live = err.isatty() and not quiet
        self.total = self.steps = self.done = 0
        self.running: dict[str, tuple[str, float]] = {}
        self.results: list[Result] = []
        self._drawn = 0.0
        self._begin = time.monotonic()

    def begin(self, total: int, steps: int) -> None:
        """`total` assets are about to go through a chain of `steps` stages."""
        self.total, self.steps = total, steps

    def progress(self, place: str, index: int, name: str, share: float) -> None:
        """An asset is in its `index`-th stage."""
        new = self.running.get(place, ("", 0.0))[0] != name
        self.running[place] = (name, share)
        if self.live and (new or time.monotonic() - self._drawn >= REDRAW_SECONDS):
            self._draw()
        elif new and not self.live and not self.quiet:
            self._line(self.err, f"[{self.done + 1}/{self.total}] {place}: {name}")

    def finished(self, result: Result) -> None:
        """An asset is through, or has failed."""
        self.done += 1
        self.running.pop(result.place, None)
        self.results.append(result)
        self._erase()
        if result.message:
            self._line(self.err, f"{Style(self.err)('error', 'red')}: {result.message}")
        elif not self.quiet:
            for line in summary(result, Style(self.out)):
                self._line(self.out, line)
        if self.live and self.done < self.total:
            self._draw()

    def __enter__(self) -> Display:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is None:
            self.end()
        else:
            self._erase()

    def end(self) -> None:
        """The batch is over: say how it went, if that is not plain already."""
        self._erase()
        if self.total > 1 and not self.quiet:
            self._line(self.out, totals(self.results, time.monotonic() - self._begin, Style(self.out)))

    def _draw(self) -> None:
        self._drawn = time.monotonic()
        parts = [
            f"{place}: {name}{f' {share:.0%}' if 0 < share < 1 else ''}"
            for place, (name, share) in self.running.items()
        ]
        text = clean(f"[{self.done}/{self.total}] {' | '.join(parts)}")
        width = shutil.get_terminal_size().columns - 1
        self.err.write(f"\r\x1b[K{text if len(text) <= width else text[: width - 1] + '…'}")
        self.err.flush()

    def _erase(self) -> None:
        if self.live:
            self.err.write("\r\x1b[K")
            self.err.flush()

    def _line(self, stream: TextIO, text: str) -> None:
        stream.write(text + "\n")
        stream.flush()


class JsonDisplay(Display):
    """Says nothing but errors while it goes on, and one JSON document at the end."""

    def __init__(self, out: TextIO, err: TextIO) -> None:
        super().__init__(out, err, quiet=True)

    def end(self) -> None:
        names = ("input", "place", "outcome", "folder", "message", "seconds", "report")
        assets = [{name: getattr(result, name) for name in names} for result in self.results]
        self._line(self.out, json.dumps({"assets": assets}, indent=2, allow_nan=False))


def summary(result: Result, style: Style) -> list[str]:
    """The lines about one asset that was processed."""
    word = style(_WORDS[result.outcome], _COLOURS.get(result.outcome, "red"))
    report = result.report or {}
    if result.outcome == "unchanged":
        return [clean(f"{result.place}: ") + word + clean(f", {result.folder} is up to date")]
    lines = [style(clean(result.place), "bold") + f": {word}, {result.seconds:.1f} s, " + clean(f"in {result.folder}")]
    lines += [style("  again: ", "dim") + clean(text) for text in _reruns(report)]
    lines += _levels(report)
    failed = [entry for entry in report.get("budgets", ()) if not entry["ok"]]
    lines += [style(f"  over budget: {_budget(entry)}", "red") for entry in failed]
    warnings = warnings_of(report)
    lines += [style("  warning: ", "yellow") + clean(text) for text in warnings[:MOST_WARNINGS]]
    if len(warnings) > MOST_WARNINGS:
        lines.append(f"  and {len(warnings) - MOST_WARNINGS:,} more warnings, in {clean(result.folder)}/report.json")
    if report.get("images"):
        lines.append(clean(f"  look at {result.folder}/report.html"))
    return lines


def _reruns(report: dict[str, Any]) -> list[str]:
    """Of an asset that was processed before: which stages ran again and why, and which results were kept."""
    stages = report.get("stages", ())
    kept = [stage["name"] for stage in stages if stage.get("kept")]
    parts = [f"{stage['name']} ({stage['reason']})" for stage in stages if stage.get("reason")]
    if kept:
        parts.append(f"kept: {', '.join(kept)}")
    return ["; ".join(parts)] if parts else []


def warnings_of(report: dict[str, Any]) -> list[str]:
    """Every warning of a report, the stage's name before it."""
    found = list(report.get("warnings", ()))
    for stage in report.get("stages", ()):
        found += [f"{stage['name']}: {text}" for text in stage["warnings"]]
    return found


def totals(results: Sequence[Result], seconds: float, style: Style) -> str:
    """The last line of a batch."""
    counts: dict[str, int] = {}
    for result in results:
        counts[result.outcome] = counts.get(result.outcome, 0) + 1
    parts = [style(f"{count} {_WORDS[outcome]}", _COLOURS.get(outcome, "red")) for outcome, count in counts.items()]
    records = {result.folder.partition(_FAILED)[0] + _FAILED for result in results if _FAILED in result.folder}
    where = f"; why: {', '.join(map(clean, sorted(records)))}" if records else ""
    return f"{len(results)} assets: {', '.join(parts)} ({seconds:.1f} s){where}"


def _levels(report: dict[str, Any]) -> list[str]:
    levels = report.get("lods", [])
    if not levels:
        return []
    base = max(1, report.get("source", {}).get("triangles", 0) or levels[0]["triangles"])
    seen = [level.get("visual") or {} for level in levels]
    measured = [(heading, key) for heading, key in _SEEN if any(figures.get(key) is not None for figures in seen)]
    head = [">level", ">triangles", ">%", ">vertices", ">size", ">mean error %", ">max error %"]
    head += [*(f">{heading}" for heading, _ in measured), "stopped by"]
    rows = []
    for level, figures in zip(levels, seen, strict=True):
        error = level["error"] or {}
        rows.append(
            [
                str(level["level"]),
                number(level["triangles"]),
                f"{100 * level['triangles'] / base:.1f}",
                number(level["vertices"]),
                size(level["bytes"]) if level["files"] else "–",
                number(error.get("mean")),
                number(error.get("max")),
                *(number(figures.get(key)) for _, key in measured),
                clean(level["stop_reason"]),
            ]
        )
    return table(head, rows)


_SEEN = (("PSNR", "psnr"), ("SSIM", "ssim"), ("silhouette", "silhouette_iou"))
"""Figures of pictures, as far as they were measured."""


def _budget(entry: dict[str, Any]) -> str:
    where = "asset" if entry["level"] is None else f"level {entry['level']}"
    value = entry["value"]
    got = number(value) if value is not None else entry.get("value_reason", "no figure")
    return f"{where}: {entry['figure']} {got}, at most {number(entry['limit'])}"
