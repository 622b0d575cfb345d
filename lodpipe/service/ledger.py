"""The book-keeping of assets: every change of a row goes into the table, and into the log, before anything else."""

from __future__ import annotations

import logging
from pathlib import Path, PurePosixPath
from typing import Any

from lodpipe.config.watch import Watch
from lodpipe.service.clock import Clock
from lodpipe.service.discover import Places
from lodpipe.service.job import Outcome
from lodpipe.service.table import AT_REST, DONE, FAILED, GONE, QUEUED, RUNNING, SETTLING, JobTable, Row

FIRST_PAUSE, LONGEST_PAUSE = 2.0, 60.0
"""Seconds until what met passing trouble is tried again: doubled each time, up to the longest."""


class Ledger:
    """The rows of the table, in memory too."""

    def __init__(self, table: JobTable, clock: Clock, log: logging.Logger, root: Path, output: Path) -> None:
        self.table, self.clock, self.log = table, clock, log
        self.root, self.output = root, output
        self.watch = Watch()
        self.rows: dict[str, Row] = {}
        self.open: dict[str, Row] = {}
        """Those of them that are not at rest: most of the time few of many."""
        self.outcomes = 0
        """How often the output folder has changed since the start: results, records of failures, and their end."""
        self.load()

    def load(self) -> None:
        """Take from the table what is known."""
        self.rows = {row.key: row for row in self.table.rows()}
        self.open = {key: row for key, row in self.rows.items() if row.state not in (*AT_REST, GONE)}
        self._places = Places(row.place for row in self.rows.values())

    def new(self, key: str) -> Row:
        """A row for an asset that has not been seen before."""
        row = self.rows[key] = Row(key, self._places.give(PurePosixPath(key)), changed_at=self.clock.time())
        self.log.info("%s: seen", key, extra=about(row))
        self.set(row, SETTLING, reason="new")
        return row

    def forget(self, row: Row) -> None:
        """Nothing of the asset is left."""
        self.table.delete(row.key)
        self._places.free(row.place)
        del self.rows[row.key]
        self.open.pop(row.key, None)

    def set(self, row: Row, state: str, **values: Any) -> None:
        """Change a row, in memory and in the table."""
        if state != row.state:
            row.changed_at = self.clock.time()
        if row.state == RUNNING != state:
            values = {"owner": "", "pid": 0, "pid_start": 0, "step": 0, "share": 0.0} | values
        row.state = state
        for name, value in values.items():
            setattr(row, name, value)
        if state in AT_REST or state == GONE:
            self.open.pop(row.key, None)
        else:
            self.open[row.key] = row
        self.table.put(row)

    def forgive(self, bounds: Any) -> None:
        """Give what has failed another chance if the `bounds` that it may have failed by are others than before."""
        known = self.table.fact("bounds")
        if known == bounds:
            return
        for row in self.rows.values():
            if row.state == FAILED and known is not None:
                self.set(row, FAILED, recipe="", failed="", reason="the limits changed")
        self.table.set_facts(bounds=bounds)

    def retry(self, row: Row, *, force: bool) -> None:
        """The user asks for it."""
        self.set(row, SETTLING, **_CLEAN | {"recipe": "", "force": int(force), "reason": "asked for"})

    def published(self, row: Row, outcome: Outcome) -> None:
        """A job has published a result."""
        report = outcome.report or {}
        warnings = len(report.get("warnings", ())) + sum(len(part["warnings"]) for part in report.get("stages", ()))
        with self.table.transaction():
            self.set(
                row,
                DONE,
                **_CLEAN,
                revision=row.revision + 1,
                outcome=outcome.outcome,
                warnings=warnings,
                same_as="",
            )
            self._count(done=1, seconds=row.seconds)
            self.outcomes += 1
            self._call("done", row)
        self.log.info("%s: %s in %.1f s", row.key, outcome.outcome, row.seconds, extra=about(row))

    def current(self, row: Row, state: str, text: str, **values: Any) -> None:
        """The result of an asset is there already."""
        self.set(row, state, **_CLEAN | {"outcome": row.outcome or "ok"} | values)
        self.log.info("%s: %s", row.key, text, extra=about(row))

    def failed(self, row: Row, outcome: Outcome, recipe: str, **values: Any) -> None:
        """An asset has failed for good: until it, the recipe or the user change that."""
        facts = {"outcome": outcome.outcome, "message": outcome.message, "failed": row.content, "recipe": recipe}
        with self.table.transaction():
            self.set(row, FAILED, **_CLEAN | facts | values)
            self._count(failed=1)
            self.outcomes += 1
            self._call("failed", row)
        self.log.error("%s", outcome.message, extra=about(row))

    def again(self, row: Row, message: str) -> None:
        """An attempt has failed, and there will be another."""
        with self.table.transaction():
            self.set(row, QUEUED, message=message, reason=f"attempt {row.attempts} failed")
            self._count(retries=1)
        self.log.warning("%s; tried again", message, extra=about(row))

    def put_off(self, row: Row, message: str) -> None:
        """Passing trouble: wait, a little longer each time."""
        pause = self.clock.jitter(min(LONGEST_PAUSE, FIRST_PAUSE * 2.0**row.trouble))
        text = f"put off: {message}"
        self.set(row, QUEUED, trouble=row.trouble + 1, not_before=self.clock.time() + pause, message=text)
        self.log.warning("%s: put off for %.0f s: %s", row.key, pause, message, extra=about(row))

    def _count(self, **more: float) -> None:
        self.table.set_facts(**{name: self.table.fact(name, 0) + value for name, value in more.items()})

    def _call(self, event: str, row: Row) -> None:
        hook = self.watch.on_done if event == "done" else self.watch.on_failed
        if hook.wanted:
            self.table.add_call(
                {
                    "event": event,
                    "asset": row.place,
                    "input": str(self.root / row.key),
                    "output": str(self.output / row.place),
                    "outcome": row.outcome,
                    "message": row.message,
                    "revision": row.revision,
                    "seconds": round(row.seconds, 3),
                }
            )


_CLEAN = {"attempts": 0, "trouble": 0, "not_before": 0.0, "failed": "", "force": 0, "message": "", "missing": []}


def about(row: Row) -> dict[str, Any]:
    """What a line of the log says of the asset that it is about."""
    return {"asset": row.place, "job": f"{row.content[:12] or '-'}.{row.attempts}", "state": row.state}
