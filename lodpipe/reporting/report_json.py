"""`report.json`: a report as data that any JSON reader takes (numbers are finite, or null with the reason beside)."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

from lodpipe.core.report import SCHEMA_VERSION, Report

NOT_MEASURED = "not measured: the chain has no stage that does"


def report_data(report: Report) -> dict[str, Any]:
    """The report as plain data; docs/output.md lists the fields."""
    data = dataclasses.asdict(dataclasses.replace(report, page=None))
    del data["page"]
    for level in data["lods"]:
        for name in ("error", "visual", "switch", "gpu"):
            if level[name] is None:
                level[f"{name}_reason"] = NOT_MEASURED
    checked: dict[str, Any] = finite({"schema_version": SCHEMA_VERSION, **data})
    return checked


def dump_report(report: Report, path: Path) -> None:
    """Write the report to `path`."""
    text = json.dumps(report_data(report), indent=2, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8", errors="backslashreplace")  # names that are not Unicode: \\udcxx


def finite(value: Any) -> Any:
    """`value` with null for every number that JSON does not have, and its reason in the key beside it."""
    if isinstance(value, dict):
        result = {}
        for key, item in value.items():
            result[key] = finite(item)
            if isinstance(item, float) and not math.isfinite(item):
                result[f"{key}_reason"] = f"not a finite number ({item})"
        return result
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
