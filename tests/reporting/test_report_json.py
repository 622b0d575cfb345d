"""report.json: readable by every JSON parser, whatever is in it."""

from __future__ import annotations

import json
import math

from lodpipe.core.report import LevelReport, Measurement, Report, StageReport
from lodpipe.reporting.report_json import NOT_MEASURED, dump_report, report_data


def report() -> Report:
    level = LevelReport(1, 6, 5, "target", error={"mean": math.nan, "rms": 0.1, "max": -math.inf})
    stage = StageReport("report", measurements=[Measurement("speed", math.inf, "1/s"), Measurement("n", 3)])
    return Report("duck", lods=[LevelReport(0, 12, 8, "source"), level], stages=[stage])


def test_the_fields_that_readers_rely_on():
    data = report_data(report())
    assert data["schema_version"] == 1
    assert {"asset", "outcome", "source", "stages", "lods"} <= set(data)
    assert {"name", "seconds", "params", "measurements", "warnings"} <= set(data["stages"][0])
    assert {
        "level",
        "triangles",
        "vertices",
        "files",
        "bytes",
        "stop_reason",
        "error",
        "visual",
        "switch",
    } <= set(data["lods"][0])


def test_what_is_no_finite_number_is_null_with_its_reason():
    data = report_data(report())
    assert data["lods"][1]["error"] == {
        "mean": None,
        "mean_reason": "not a finite number (nan)",
        "rms": 0.1,
        "max": None,
        "max_reason": "not a finite number (-inf)",
    }
    assert data["stages"][0]["measurements"][0]["value_reason"] == "not a finite number (inf)"
    assert data["lods"][0]["error"] is None
    assert data["lods"][0]["error_reason"] == NOT_MEASURED
    assert "error_reason" not in data["lods"][1]


def test_the_file_is_strict_json_in_any_encoding_of_names(tmp_path):
    one = report()
    one.asset = "ö 名前 \udcff"
    path = tmp_path / "report.json"
    dump_report(one, path)
    assert "ö 名前" in path.read_text(encoding="utf-8")
    data = json.loads(path.read_bytes(), parse_constant=lambda word: f"not JSON: {word}")
    assert data["asset"] == one.asset
    assert data == report_data(one)
