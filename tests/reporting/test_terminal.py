"""What a person sees: tables, colours only where they are wanted, and one line for each error."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass, field
from typing import Any

import pytest

from lodpipe.reporting.table import Style, clean, number, size, table
from lodpipe.reporting.terminal import Display, JsonDisplay, summary


@dataclass
class Result:
    input: str = "duck.glb"
    place: str = "duck"
    outcome: str = "ok"
    folder: str = "out/duck"
    message: str = ""
    seconds: float = 1.23
    report: dict[str, Any] | None = field(default=None)


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture(autouse=True)
def plain(monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "60")


def report(**fields) -> dict[str, Any]:
    level = {"vertices": 8, "bytes": 1234, "files": ["a"], "error": None}
    return {
        "source": {"triangles": 12000},
        "lods": [
            {**level, "level": 0, "triangles": 12000, "stop_reason": "source"},
            {**level, "level": 1, "triangles": 600, "stop_reason": "target", "error": {"mean": 0.01234, "max": 0.5}},
        ],
        **fields,
    }


def test_table_columns_stand_where_their_heads_say():
    assert table((">n", "word"), [("1", "a"), ("100", "bcd")]) == ["    n  word", "    1  a", "  100  bcd"]


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "–"), (0.0, "0"), (12, "12"), (1234567, "1,234,567"), (0.012345, "0.0123"), (1e-7, "1.00e-07")],
)
def test_numbers(value, text):
    assert number(value) == text


@pytest.mark.parametrize(
    ("count", "text"), [(0, "0 B"), (999, "999 B"), (1500, "1.5 kB"), (2.5e6, "2.5 MB"), (3e9, "3.0 GB"), (None, "–")]
)
def test_sizes(count, text):
    assert size(count) == text


def test_control_characters_of_a_name_do_not_reach_the_terminal():
    assert clean("a\x1b[31mb\nc") == "a?[31mb?c"


def test_the_summary_is_a_table_of_levels():
    assert summary(Result(report=report()), Style(io.StringIO())) == [
        "duck: ok, 1.2 s, in out/duck",
        "  level  triangles      %  vertices    size  mean error %  max error %  stopped by",
        "      0     12,000  100.0         8  1.2 kB             –            –  source",
        "      1        600    5.0         8  1.2 kB        0.0123          0.5  target",
    ]


def test_what_was_seen_has_columns_and_the_page_a_line():
    seen = report(images=["images/levels.png"])
    seen["lods"][1]["visual"] = {"psnr": 31.25, "ssim": None, "silhouette_iou": 0.987}
    lines = summary(Result(report=seen), Style(io.StringIO()))
    assert lines[1].split()[-5:] == ["%", "PSNR", "silhouette", "stopped", "by"]
    assert lines[2].split()[-3:] == ["–", "–", "source"]
    assert lines[3].split()[-3:] == ["31.2", "0.987", "target"]
    assert lines[4] == "  look at out/duck/report.html"


def test_warnings_and_budgets_are_listed():
    budgets = [
        {"level": 1, "figure": "max_error", "limit": 0.1, "value": 0.5, "ok": False},
        {"level": None, "figure": "bytes", "limit": 9, "value": 5, "ok": True},
        {"level": 4, "figure": "bytes", "limit": 9, "value": None, "value_reason": "there is no level 4", "ok": False},
    ]
    stages = [{"name": "thin", "warnings": ["beware"]}]
    result = Result(outcome="over_budget", report=report(budgets=budgets, stages=stages, warnings=["a hole"]))
    assert summary(result, Style(io.StringIO()))[4:] == [
        "  over budget: level 1: max_error 0.5, at most 0.1",
        "  over budget: level 4: bytes there is no level 4, at most 9",
        "  warning: a hole",
        "  warning: thin: beware",
    ]


def run(out, err, **options):
    display = Display(out, err, **options)
    with display:
        display.begin(2, 3)
        display.progress("duck", 0, "load", 0.0)
        display.progress("duck", 1, "decimate", 0.5)
        display.finished(Result(report=report()))
        failed = Result(place="cow", outcome="failed", folder="out/.failed/cow", message="cow.obj: load: no triangles")
        display.finished(failed)


def test_without_a_terminal_there_are_plain_lines():
    out, err = io.StringIO(), io.StringIO()
    run(out, err)
    assert err.getvalue() == "[1/2] duck: load\n[1/2] duck: decimate\nerror: cow.obj: load: no triangles\n"
    assert out.getvalue().splitlines()[0] == "duck: ok, 1.2 s, in out/duck"
    last = out.getvalue().splitlines()[-1]
    assert last.startswith("2 assets: 1 ok, 1 failed (")
    assert last.endswith(" s); why: out/.failed")
    assert "\x1b" not in out.getvalue() + err.getvalue()


def test_on_a_terminal_there_is_one_line_that_changes():
    out, err = Terminal(), Terminal()
    run(out, err)
    lines = err.getvalue().split("\r\x1b[K")
    assert "[0/2] duck: load" in lines
    assert "[0/2] duck: decimate 50%" in lines
    assert "\x1b[32mok\x1b[0m" in out.getvalue()
    assert "\x1b[31merror\x1b[0m: cow.obj" in err.getvalue()


def test_the_changing_line_never_wraps():
    err = Terminal()
    display = Display(Terminal(), err)
    display.begin(1, 1)
    display.progress("a" * 200, 0, "load", 0.0)
    assert max(len(line) for line in err.getvalue().split("\r\x1b[K")) < 60


@pytest.mark.parametrize(("name", "value"), [("NO_COLOR", "1"), ("TERM", "dumb")])
def test_colours_can_be_forbidden(monkeypatch, name, value):
    monkeypatch.setenv(name, value)
    assert Style(Terminal())("x", "red") == "x"


def test_quiet_leaves_the_errors():
    out, err = io.StringIO(), io.StringIO()
    run(out, err, quiet=True)
    assert (out.getvalue(), err.getvalue()) == ("", "error: cow.obj: load: no triangles\n")


def test_json_is_one_document():
    out, err = io.StringIO(), io.StringIO()
    with JsonDisplay(out, err) as display:
        display.begin(1, 1)
        display.progress("duck", 0, "load", 0.0)
        display.finished(Result(report=report()))
    assert json.loads(out.getvalue())["assets"][0]["report"] == report()
    assert err.getvalue() == ""


def test_an_interruption_ends_without_a_last_line():
    out = io.StringIO()
    with pytest.raises(KeyboardInterrupt), Display(out, io.StringIO()) as display:
        display.begin(2, 1)
        raise KeyboardInterrupt
    assert out.getvalue() == ""
