"""`status`, `retry`, `pause`, `resume`: what a user asks of a daemon, through its state folder, running or not."""

from __future__ import annotations

import fnmatch
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lodpipe.core.errors import AssetError
from lodpipe.service.discover import STATE
from lodpipe.service.lock import is_running
from lodpipe.service.publish import FAILED as QUARANTINE
from lodpipe.service.table import AT_REST, FAILED, GONE, QUEUED, STATES, JobTable, Row

LISTED = 200
"""Assets in a status, unless all are asked for; those where something happens come first."""


def state_folder(output: Path, state: Path | None = None) -> Path:
    """Where the job table of an output folder is."""
    return state or output / STATE


def status(state: Path, *, every: bool = False) -> dict[str, Any]:
    """What a daemon does, as plain data. Raises OutputError where there has never been one."""
    table = JobTable(state)
    try:
        facts = table.facts()
        rows = table.rows()
        requests = len(table.requests())
        calls = len(table.calls())
    finally:
        table.close()
    counts = dict.fromkeys(STATES, 0)
    for row in rows:
        counts[row.state] += 1
    rows.sort(key=lambda row: (STATES.index(row.state) if row.state != FAILED else -1, -row.changed_at, row.key))
    return {
        "running": is_running(state),
        "pid": facts.get("pid", 0),
        "paused": bool(facts.get("paused", False)),
        "drop": facts.get("drop", ""),
        "config": facts.get("config", ""),
        "config_problem": facts.get("config_problem", ""),
        "problem": facts.get("problem", ""),
        "left_out": facts.get("left_out", {}),
        "started": facts.get("started", 0.0),
        "address": facts.get("address", ""),
        "counts": counts,
        "totals": {name: facts.get(name, 0) for name in ("done", "failed", "retries", "seconds")},
        "requests": requests,
        "hooks_waiting": calls,
        "assets": [_asset(row) for row in (rows if every else rows[:LISTED])],
        "assets_left_out": 0 if every else max(0, len(rows) - LISTED),
        "time": time.time(),
    }


def _asset(row: Row) -> dict[str, Any]:
    data = {
        "asset": row.place,
        "input": row.key,
        "state": row.state,
        "since": row.changed_at,
        "bytes": row.size,
        "reason": row.reason,
        "message": row.message,
        "attempts": row.attempts,
        "revision": row.revision,
        "outcome": row.outcome,
        "warnings": row.warnings,
        "seconds": round(row.seconds, 2),
    }
    if row.missing:
        data["missing"] = row.missing
    if row.same_as:
        data["same_as"] = row.same_as
    if row.stage and row.state == "running":
        data |= {"step": row.step, "stage": row.stage, "share": round(row.share, 3)}
    if row.state == FAILED:
        data["folder"] = f"{QUARANTINE}/{row.place}"
    elif row.revision:
        data["folder"] = row.place
    if row.not_before and row.state == QUEUED:
        data["not_before"] = row.not_before
    return data


def retry(state: Path, names: Sequence[str] = (), *, force: bool = False) -> list[str]:
    """Ask for assets to be done again: those of `names` (inputs, results or globs), or all that failed.

    What is published stays as it is unless `force`. Returns the inputs. Raises AssetError for a name that fits none.
    """
    table = JobTable(state)
    try:
        rows = table.rows()
        if not names:
            chosen = [row for row in rows if row.state == FAILED or (row.state == QUEUED and row.trouble)]
        else:
            chosen = []
            for name in names:
                fitting = [row for row in rows if _fits(row, name)]
                if not fitting:
                    raise AssetError("there is no such asset", place=name, advice="`lodpipe status` lists them")
                chosen += [row for row in fitting if row not in chosen]
        chosen = [row for row in chosen if row.state in (*AT_REST, QUEUED)]
        if chosen:
            keys = [os.fsencode(row.key).hex() for row in chosen]
            table.add_request({"what": "retry", "keys": keys, "force": force})
        return [row.key for row in chosen]
    finally:
        table.close()


def _fits(row: Row, name: str) -> bool:
    plain = name.rstrip("/")
    return row.state != GONE and (
        plain in (row.key, row.place, Path(row.key).name)
        or fnmatch.fnmatchcase(row.key, plain)
        or row.key.startswith(plain + "/")
    )


def pause(state: Path) -> None:
    """No new jobs are begun; running ones go on."""
    table = JobTable(state)
    table.set_facts(paused=True)
    table.close()


def resume(state: Path) -> None:
    """Go on, also with a watched folder that is another one than before."""
    table = JobTable(state)
    table.set_facts(paused=False)
    if table.fact("problem", ""):
        table.add_request({"what": "accept_root"})
    table.close()
