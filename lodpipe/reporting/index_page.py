"""`index.html` of an output folder: a row for each asset, with its picture, verdict and figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from lodpipe.reporting.page import VERDICTS, environment

NAME = "index.html"
MARK = '<meta name="generator" content="lodpipe index">'
"""Says that the page is ours, and may be written anew."""


@dataclass(frozen=True)
class Entry:
    """An asset's row. Paths are relative to the output folder; a figure that was not measured is None."""

    place: str
    outcome: str
    page: str
    """report.html, or what there is instead."""
    thumbnail: str = ""
    message: str = ""
    """Why it failed, or the first of its warnings."""
    levels: int = 0
    triangles: int | None = None
    """Of the source; `coarsest`: of the last level, whose mean error (% of the diagonal) and SSIM follow."""
    coarsest: int | None = None
    mean_error: float | None = None
    ssim: float | None = None
    bytes: int = 0
    """Of all levels' files."""
    seconds: float = 0.0


def entry_of(place: str, folder: str, report: dict[str, Any], files: Iterable[str]) -> Entry:
    """The row of a report: `place` names the asset, `folder` is where it lies, `files` are names inside."""
    there = set(files)
    lods = report.get("lods") or []
    last = lods[-1] if lods else {}
    warnings = [*report.get("warnings", ()), *(text for s in report.get("stages", ()) for text in s["warnings"])]
    failure = report.get("error") or {}
    name = next((name for name in ("report.html", "error.json", "report.json") if name in there), "")
    outcome = report.get("outcome", "failed")
    return Entry(
        place=place,
        outcome=outcome if outcome in VERDICTS else "warnings",
        page=f"{folder}/{name}" if name else f"{folder}/",
        thumbnail=f"{folder}/images/thumbnail.webp" if "images/thumbnail.webp" in there else "",
        message=failure.get("cause") or (warnings[0] if warnings else ""),
        levels=len(lods),
        triangles=(report.get("source") or {}).get("triangles"),
        coarsest=last.get("triangles"),
        mean_error=(last.get("error") or {}).get("mean"),
        ssim=(last.get("visual") or {}).get("ssim"),
        bytes=sum(lod["bytes"] for lod in lods),
        seconds=report.get("seconds") or 0.0,
    )


def index_html(entries: Iterable[Entry], title: str) -> str:
    """The text of index.html, sorted by place."""
    rows = sorted(entries, key=lambda entry: entry.place.casefold())
    counts = Counter(entry.outcome for entry in rows)
    return (
        environment()
        .get_template("index.html")
        .render(entries=rows, title=title, verdicts=VERDICTS, counts={outcome: counts[outcome] for outcome in VERDICTS})
    )
