"""The daemon's status for people (terminal) and for Prometheus."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lodpipe.reporting.table import Style, clean, size, table

Status = Mapping[str, Any]

_COLOURS = {"failed": "red", "waiting": "yellow", "running": "bold", "done": "green", "same": "green"}
_SHOWN = ("failed", "running", "queued", "settling", "waiting")
"""States whose assets are always listed; of the others only the latest."""
LATEST = 10


def status_lines(status: Status, style: Style, *, every: bool = False) -> list[str]:
    """What `lodpipe status` prints."""
    lines = [_headline(status, style)]
    if status["problem"]:
        lines.append(style(f"  {clean(status['problem'])}", "red"))
    for text in str(status["config_problem"]).splitlines():
        lines.append(
            style(f"  the configuration was changed and is not valid, the old one stays: {clean(text)}", "red")
        )
    if status["requests"] and not status["running"]:
        lines.append("  what was asked for is done when the daemon is started")
    for folder, why in list(status["left_out"].items())[:LATEST]:
        lines.append(style(f"  {clean(folder)}: {clean(why)}", "yellow"))
    counts = ", ".join(f"{count} {state}" for state, count in status["counts"].items() if count)
    lines.append(f"  {counts or 'no assets yet'}")
    shown = [asset for asset in status["assets"] if asset["state"] in _SHOWN]
    others = [asset for asset in status["assets"] if asset["state"] not in _SHOWN]
    latest = sorted(others, key=lambda asset: -asset["since"])
    rows = [_row(asset, status["time"], style) for asset in [*shown, *(latest if every else latest[:LATEST])]]
    if rows:
        lines += table(("asset", "state", ">size", ">for", ""), rows)
    hidden = len(status["assets"]) - len(rows) + status["assets_left_out"]
    if hidden:
        lines.append(f"  … and {hidden} more; --all lists them")
    return lines


def metrics_text(status: Status, memory_bytes: int) -> str:
    """The same in Prometheus' text format, version 0.0.4."""
    totals = status["totals"]
    families: list[tuple[str, str, str, list[tuple[str, float]]]] = [
        ("lodpipe_assets", "gauge", "Assets by state.", [(f'{{state="{s}"}}', n) for s, n in status["counts"].items()]),
        ("lodpipe_results_total", "counter", "Results published.", [("", totals["done"])]),
        ("lodpipe_failures_total", "counter", "Assets that failed for good.", [("", totals["failed"])]),
        ("lodpipe_retries_total", "counter", "Attempts that failed and were repeated.", [("", totals["retries"])]),
        ("lodpipe_work_seconds_total", "counter", "Time spent on published results.", [("", totals["seconds"])]),
        ("lodpipe_paused", "gauge", "1 while paused.", [("", int(status["paused"]))]),
        ("lodpipe_trouble", "gauge", "1 while the watched folder is gone.", [("", int(bool(status["problem"])))]),
        ("lodpipe_folders_left_out", "gauge", "Folders that are not looked into.", [("", len(status["left_out"]))]),
        (
            "lodpipe_config_invalid",
            "gauge",
            "1 while a new configuration is refused.",
            [("", int(bool(status["config_problem"])))],
        ),
        ("lodpipe_start_time_seconds", "gauge", "When the daemon started, since 1970.", [("", status["started"])]),
        ("lodpipe_resident_memory_bytes", "gauge", "Memory of the daemon itself.", [("", memory_bytes)]),
    ]
    lines = []
    for name, kind, text, samples in families:
        lines += [f"# HELP {name} {text}", f"# TYPE {name} {kind}"]
        lines += [f"{name}{labels} {value:.17g}" for labels, value in samples]
    return "\n".join(lines) + "\n"


def _headline(status: Status, style: Style) -> str:
    word = "watching" if status["running"] else "not running; watches"
    if status["paused"]:
        word = f"paused; {word}"
    colour = "green" if status["running"] and not status["paused"] else "yellow"
    process = f" (process {status['pid']})" if status["running"] else ""
    page = f", page on {status['address']}" if status["running"] and status["address"] else ""
    return style(word, colour) + clean(f" {status['drop']} with {status['config']}{process}{page}")


def _row(asset: Mapping[str, Any], now: float, style: Style) -> tuple[str, ...]:
    state = asset["state"]
    if "stage" in asset:
        text = f"{asset['stage']} {asset['share']:.0%}"
    elif asset["message"]:
        text = asset["message"].partition(f"{asset['input']}: ")[2] or asset["message"]  # its name stands before it
    elif "same_as" in asset:
        text = f"the same content as {asset['same_as']}"
    else:
        text = f"{_outcome(asset)} in {asset['seconds']:.1f} s" if asset["outcome"] else asset["reason"]
    return (
        clean(asset["asset"]),
        style(state, _COLOURS.get(state, "dim")),
        size(asset["bytes"]) if asset["bytes"] else "–",  # not known before it has come to rest
        _age(now - asset["since"]),
        clean(text),
    )


def _outcome(asset: Mapping[str, Any]) -> str:
    count = asset["warnings"]
    warned = f"{count} warning{'s' if count > 1 else ''}" if count else ""
    said = "" if asset["outcome"] == "warnings" and warned else asset["outcome"].replace("_", " ")
    return ", ".join(filter(None, (said, warned)))


def _age(seconds: float) -> str:
    for unit, length in (("d", 86400), ("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{max(0.0, seconds):.0f} s"
