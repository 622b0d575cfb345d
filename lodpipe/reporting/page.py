"""`report.html`: one file that opens from disk without a network, and the pictures in `images/`."""

from __future__ import annotations

import base64
import functools
import gzip
import importlib.util
import os
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from lodpipe.core.page import Page, Picture
from lodpipe.core.report import Report
from lodpipe.reporting.report_json import report_data
from lodpipe.reporting.table import number, size
from lodpipe.reporting.terminal import warnings_of

if TYPE_CHECKING:
    import jinja2

NAME = "report.html"
IMAGES = "images"
VIEWER = ("dash_model_viewer", "vendor/model-viewer-umd.min.js")
"""The package that brings model-viewer, and the classic script in it."""
TYPES = {".gltf": "model/gltf+json", ".jpg": "image/jpeg", ".png": "image/png", ".webp": "image/webp"}

VERDICTS = {
    "ok": ("ok", "OK"),
    "warnings": ("warn", "With warnings"),
    "over_budget": ("bad", "Over budget"),
    "failed": ("bad", "Failed"),
}


def write_page(report: Report, folder: Path) -> list[Path]:
    """Write the pictures and report.html into `folder`, and note the pictures in `report.images`.

    Nothing is written for a report without `page`. Returns the files.
    """
    if report.page is None:
        return []
    written = []
    for picture in report.page.pictures:
        path = folder / IMAGES / picture.name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(picture.data)
        written.append(path)
    report.images = [path.relative_to(folder).as_posix() for path in written]
    target = folder / NAME
    target.write_text(page_html(report, report.page), encoding="utf-8", errors="backslashreplace")
    return [*written, target]


def page_html(report: Report, page: Page) -> str:
    """The text of report.html."""
    data = report_data(report)
    viewer = viewer_script() if page.models else None
    blobs = [(name, _type(name), _packed(content)) for name, content in page.files.items()] if viewer else []
    notes = list(page.notes)
    if page.models and viewer is None:
        notes.append("No 3-D view: the package dash-model-viewer is not installed.")
    verdict = VERDICTS.get(report.outcome, ("warn", report.outcome))
    return (
        environment()
        .get_template("report.html")
        .render(
            r=data,
            page=page,
            verdict=verdict,
            notes=notes,
            warnings=warnings_of(data),
            columns=level_columns(data),
            charts=charts(data),
            viewer=_packed(viewer.encode()) if viewer else "",
            viewer_version=viewer_version(),
            blobs=blobs,
            shown=_shown(page) if viewer else {"models": {}, "layers": [], "standIns": {}},
            pictures=[(p, _data_url(p)) for p in page.pictures if p.kind in ("shaded", "difference")],
            config=_yaml(report.config),
            gpu_top=max((sum((lod["gpu"] or {}).values()) for lod in data["lods"]), default=0),
            disk_top=max((lod["bytes"] for lod in data["lods"]), default=0),
        )
    )


@functools.cache
def environment() -> jinja2.Environment:
    """The templates, with everything escaped that goes into them."""
    import jinja2

    made = jinja2.Environment(
        loader=jinja2.PackageLoader("lodpipe.reporting", "assets"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters.update(number=number, size=size, href=href)
    return made


def href(path: str) -> str:
    """A relative link to a file, whatever is in its name."""
    return "/".join(quote(os.fsencode(part)) for part in path.split("/"))


def viewer_script() -> str | None:
    """model-viewer's classic script, from the package that brings it; None where that is not installed."""
    spec = importlib.util.find_spec(VIEWER[0])
    for place in (spec.submodule_search_locations or ()) if spec else ():
        path = Path(place, VIEWER[1])
        if path.is_file():
            return path.read_text(encoding="utf-8")
    return None


def viewer_version() -> str:
    """Of the package that brings model-viewer."""
    try:
        return version("dash-model-viewer")
    except PackageNotFoundError:
        return ""


def level_columns(data: dict[str, Any]) -> list[tuple[str, str, list[str]]]:
    """Heading, explanation and a cell for each level, of the figures that at least one level has."""
    lods = data["lods"]
    base = max(1, data["source"].get("triangles") or (lods[0]["triangles"] if lods else 1))
    every = [
        ("Triangles", "stored in the file", [number(lod["triangles"]) for lod in lods]),
        ("Share", "of the source's triangles", [f"{100 * lod['triangles'] / base:.3g} %" for lod in lods]),
        ("On disk", "all files of the level", [_download(lod) for lod in lods]),
    ]
    for heading, about, part, key, form, factor in _FIGURES:
        values = [(lod[part] or {}).get(key) if part else lod[key] for lod in lods]
        if any(value is not None for value in values):
            every.append((heading, about, [form.format(number(v * factor)) if v is not None else "–" for v in values]))
    if any(lod["stop_reason"] not in ("source", "target") for lod in lods):
        every.append(("Stopped by", "what ended the level's making", [lod["stop_reason"] for lod in lods]))
    return every


def _download(lod: dict[str, Any]) -> str:
    """The size of a level's files; a link where it is one file."""
    from markupsafe import Markup

    if not lod["files"]:
        return "–"
    if len(lod["files"]) > 1:
        return size(lod["bytes"])
    return Markup('<a href="{}" download>{}</a>').format(href(lod["files"][0]), size(lod["bytes"]))


_FIGURES: tuple[tuple[str, str, str, str, str, float], ...] = (
    ("Mean error", "mean distance, % of the bounding box's diagonal", "error", "mean", "{} %", 1),
    ("Max error", "Hausdorff distance, % of the diagonal", "error", "max", "{} %", 1),
    ("PSNR", "of renders beside the source's, in dB: more is better", "visual", "psnr", "{} dB", 1),
    ("SSIM", "structural similarity of the renders, 1 is the same", "visual", "ssim", "{}", 1),
    ("FLIP", "perceived difference of the renders, 0 is the same", "visual", "flip", "{}", 1),
    ("Silhouette", "overlap of the silhouettes, 1 is the same", "visual", "silhouette_iou", "{}", 1),
    ("Normals", "mean deviation of the normals", "error", "normal_degrees", "{}°", 1),
    ("Vertices", "as a GPU sees them", "", "vertices", "{}", 1),
    ("Screen", "share of the screen's height below which it may be used", "switch", "screen_coverage", "{} %", 100),
)
"""Heading, explanation, part of the level and name in it, how it is written, and what it is multiplied by."""


def charts(data: dict[str, Any]) -> list[Any]:
    """Errors over the number of triangles."""
    from lodpipe.reporting.charts import Series, chart

    def series(name: str, part: str, key: str) -> Series:
        found = [(lod["triangles"], (lod[part] or {}).get(key)) for lod in data["lods"]]
        return Series(name, [(float(x), float(y)) for x, y in found if y is not None])

    distance = [series("largest", "error", "max"), series("RMS", "error", "rms"), series("mean", "error", "mean")]
    likeness = [series("SSIM", "visual", "ssim"), series("silhouette IoU", "visual", "silhouette_iou")]
    drawn = [
        chart("Distance to the source over triangles", "triangles", "% of the diagonal", distance),
        chart("PSNR of renders over triangles", "triangles", "dB", [series("PSNR", "visual", "psnr")], log_y=False),
        chart("Likeness of renders over triangles", "triangles", "1 = the same", likeness, log_y=False),
    ]
    return [one for one in drawn if one]


def _shown(page: Page) -> dict[str, Any]:
    """What the page's script needs to know of the models."""
    return {
        "models": page.models,
        "standIns": page.stand_ins,
        "layers": [{"name": one.name, "models": one.models, "beside": 0 not in one.models} for one in page.layers],
    }


def _packed(content: bytes) -> str:
    """`content` compressed and in letters; the same for the same content."""
    return base64.b64encode(gzip.compress(content, 2, mtime=0)).decode()  # more makes rounded numbers no smaller


def _data_url(picture: Picture) -> str:
    kind = _type(picture.name)
    return f"data:{kind};base64,{base64.b64encode(picture.data).decode()}"


def _type(name: str) -> str:
    return TYPES.get(Path(name).suffix, "application/octet-stream")


def _yaml(config: dict[str, Any]) -> str:
    import yaml

    return yaml.safe_dump(config, sort_keys=False, allow_unicode=True, width=100) if config else ""
