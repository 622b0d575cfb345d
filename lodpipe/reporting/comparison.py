"""What `lodpipe compare` says: two models side by side, for people and as JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from lodpipe.reporting.report_json import finite
from lodpipe.reporting.table import Style, clean, number, table

SCREEN = 1080
"""Pixels of the screen's height that `unseen_height` is set against."""
_GRADES = ((0.02, "the same to the eye", "green"), (0.05, "hardly different", "green"), (0.1, "different", "yellow"))
"""Mean FLIP up to which pictures are called so."""


def comparison_data(
    models: Sequence[tuple[str, int, int]], figures: dict[str, Any], warnings: Sequence[str]
) -> dict[str, Any]:
    """The comparison as plain data: `models` are (file, triangles, vertices) of A and B."""
    named = {
        key: {"file": file, "triangles": triangles, "vertices": vertices}
        for key, (file, triangles, vertices) in zip("ab", models, strict=True)
    }
    data: dict[str, Any] = finite({**named, **figures, "warnings": list(dict.fromkeys(warnings))})
    return data


def dump_json(data: dict[str, Any]) -> str:
    """`data` as a JSON document."""
    return json.dumps(data, indent=2, allow_nan=False)


def comparison_text(data: dict[str, Any], style: Style) -> list[str]:
    """The lines that `lodpipe compare` prints."""
    a, b, visual, error = data["a"], data["b"], data["visual"], data["error"]
    share = f" ({100 * b['triangles'] / a['triangles']:.3g} %)" if a["triangles"] else ""
    lines = [
        style("A", "bold") + f"  {clean(a['file'])}: {number(a['triangles'])} triangles",
        style("B", "bold") + f"  {clean(b['file'])}: {number(b['triangles'])} triangles{share}",
        "",
        _verdict(visual, style),
        "",
    ]
    rows = [
        ("unseen up to", *_unseen(visual)),
        ("luminance RMS", number(visual["luminance_rms"]), "of 255; 0 is the same"),
        ("PSNR", _with(visual, "psnr", " dB"), "higher is better; above 40 hardly to be seen"),
        ("SSIM", _with(visual, "ssim"), "1 is the same"),
        ("MS-SSIM", _with(visual, "ms_ssim"), "1 is the same"),
        ("FLIP", _with(visual, "flip"), "0 is the same; what is seen when one replaces the other"),
        ("silhouette overlap", _with(visual, "silhouette_iou"), "1 is the same"),
        ("normals", _with(visual, "normal_degrees", "°"), "mean angle between the surfaces seen"),
    ]
    if error is not None:
        unit = "of the diagonal of A's bounding box"
        rows += [
            ("mean distance", f"{number(error['mean'])} %", unit),
            ("RMS distance", f"{number(error['rms'])} %", unit),
            ("largest distance", f"{number(error['max'])} %", unit),
        ]
    else:
        rows.append(("distance", "–", data["error_reason"]))
    slip = data["texture"]
    if slip is not None:
        kept = f"mean, where UVs correspond ({100 * slip['corresponding']:.0f} % of the surface)"
        rows.append(("texture slips by", f"{number(slip['mean'])} %", kept))
    else:
        rows.append(("texture slips by", "–", clean(data["texture_reason"])))
    lines += table(("figure", ">B against A", f"over {visual['views']} views of {visual['size']} pixels"), rows)
    head = (">size on screen", ">luminance RMS", ">PSNR", ">SSIM")
    lines += ["", *table(head, [_row(entry) for entry in data["by_size"]]), ""]
    lines += [style("  note: ", "dim") + f"{name}: {clean(reason)}" for name, reason in _reasons(visual)]
    if data.get("files"):
        lines.append(f"  {len(data['files'])} pictures: {clean(data['files'][-1])} shows them all")
    lines += [style("  warning: ", "yellow") + clean(text) for text in data["warnings"]]
    return lines


def _verdict(visual: dict[str, Any], style: Style) -> str:
    flip = visual["flip"]
    if flip is None:
        return "  nothing can be said of how they look"
    if visual.get("psnr_reason") and visual["luminance_rms"] == 0:
        return "  " + style("identical in every picture", "green")
    for limit, words, colour in _GRADES:
        if flip <= limit:
            return "  " + style(words, colour)
    return "  " + style("very different", "red")


def _row(entry: dict[str, Any]) -> tuple[str, str, str, str]:
    """One line of the table of sizes."""
    psnr = "the same" if entry["psnr"] is None else f"{entry['psnr']:.1f} dB"
    return f"{entry['size']} px", number(entry["luminance_rms"]), psnr, _with(entry, "ssim")


def _unseen(visual: dict[str, Any]) -> tuple[str, str]:
    height = visual["unseen_height"]
    if height is None:
        return "–", clean(visual.get("unseen_height_reason", ""))
    if height == 0:
        return "0 px", "a difference is seen at every size"
    share = f"{'more than ' if 'unseen_height_reason' in visual else ''}{100 * min(height / SCREEN, 1):.3g} %"
    return f"{height:.0f} px", f"{share} of the height of a screen of {SCREEN}: smaller, nobody can tell"


def _with(figures: dict[str, Any], name: str, unit: str = "") -> str:
    value = figures[name]
    if value is None:
        return "–"
    return (f"{value:.4f}" if unit == "" and 0.1 < value <= 1 else number(value)) + unit


def _reasons(figures: dict[str, Any]) -> list[tuple[str, str]]:
    return [
        (key.removesuffix("_reason"), text)
        for key, text in figures.items()
        if key.endswith("_reason") and key != "unseen_height_reason"  # it stands in the table
    ]
