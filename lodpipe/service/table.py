"""The job table: what the daemon knows about every asset, in SQLite, which is the truth.

The daemon alone writes assets. `status` and the status page read beside it; `retry`, `pause` and `resume` leave a
request or a fact, which the daemon looks at whenever somebody has written. Paths are stored as the bytes that the file
system has, so that no name is lost.
"""

from __future__ import annotations

import contextlib
import json
import os
import sqlite3
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from lodpipe.core.errors import OutputError

FILE = "jobs.sqlite"
VERSION = 1

SETTLING, WAITING, QUEUED, RUNNING = "settling", "waiting", "queued", "running"
DONE, SAME, FAILED, GONE = "done", "same", "failed", "gone"
STATES = (RUNNING, QUEUED, SETTLING, WAITING, DONE, SAME, FAILED, GONE)
"""In the order in which `status` lists them."""
AT_REST = (DONE, SAME, FAILED)
"""Nothing happens to an asset in one of these until its files, the configuration or the user change."""

_PATHS = ("key", "place", "same_as")
_DATA = ("signature", "missing", "members")


@dataclass(slots=True)
class Row:
    """One asset. `key` is its path below the watched folder, `place` that of its result below the output folder."""

    key: str
    place: str
    state: str = SETTLING
    size: int = 0
    """Bytes of all its files."""
    priority: int = 0
    signature: dict[str, list[int] | None] = field(default_factory=dict)
    """Of each member when it was last taken, None for one that was missing: size, mtime_ns, inode."""
    members: list[str] = field(default_factory=list)
    """Its files, relative to the watched folder, its own first."""
    missing: list[str] = field(default_factory=list)
    content: str = ""
    """Hash of the content of its files, the configuration and the stages, as last taken; names do not count."""
    recipe: str = ""
    """Id of the configuration and stages that it was last taken with."""
    same_as: str = ""
    """Of an asset in the state `same`: the place where its content is published."""
    attempts: int = 0
    revision: int = 0
    """How many results have been published."""
    queued_at: float = 0.0
    not_before: float = 0.0
    changed_at: float = 0.0
    """When its state last changed; this and the other times are seconds since 1970."""
    owner: str = ""
    """Of a running one: the daemon that it belongs to, and the process that does it."""
    leased_until: float = 0.0
    pid: int = 0
    pid_start: int = 0
    step: int = 0
    stage: str = ""
    share: float = 0.0
    outcome: str = ""
    message: str = ""
    """One line: why it failed, or what it waits for."""
    warnings: int = 0
    reason: str = ""
    """Why it is processed."""
    seconds: float = 0.0
    trouble: int = 0
    """How often passing trouble has come in the way since the last success."""
    force: int = 0
    """Whether it is to be done even if its result is there."""
    failed: str = ""
    """The content that has failed for good: it is not tried again until it, the recipe or the user changes that."""
    disposed: int = 0
    """Whether its files were moved or deleted after success, as `on_success` asks."""


_COLUMNS = tuple(column.name for column in fields(Row))
_TYPES = {"int": "INTEGER", "float": "REAL", "str": "TEXT"}


class JobTable:
    """The table in a state folder. Made if it is not there, set aside and made anew if it is damaged."""

    def __init__(self, folder: Path, *, create: bool = False, journal: str = "wal") -> None:
        self.path = folder / FILE
        self.set_aside: Path | None = None
        """Where a damaged table has been moved."""
        if not create and not self.path.is_file():
            raise OutputError(
                "has no job table", place=str(folder), advice="is it the output folder of `lodpipe watch`? see --state"
            )
        try:
            self._open(journal, create)
        except sqlite3.DatabaseError as error:
            if not create or "locked" in str(error):
                raise _broken(self.path, error) from error
            self.set_aside = _set_aside(self.path)
            self._open(journal, create)

    def _open(self, journal: str, create: bool) -> None:
        self._base = sqlite3.connect(self.path, timeout=30, isolation_level=None)
        self._base.row_factory = sqlite3.Row
        if not create:
            return
        if self._base.execute("PRAGMA quick_check(1)").fetchone()[0] != "ok":
            self._base.close()
            raise sqlite3.DatabaseError("damaged")
        self._base.execute(f"PRAGMA journal_mode={journal}")
        self._base.execute("PRAGMA synchronous=NORMAL")
        columns = ", ".join(
            f"{column.name} {'BLOB' if column.name in _PATHS else _TYPES.get(str(column.type), 'TEXT')}"
            for column in fields(Row)
        )
        with self.transaction():
            self._base.execute(f"CREATE TABLE IF NOT EXISTS asset ({columns}, PRIMARY KEY (key))")
            self._base.execute("CREATE TABLE IF NOT EXISTS fact (name TEXT PRIMARY KEY, value TEXT)")
            self._base.execute("CREATE TABLE IF NOT EXISTS call (id INTEGER PRIMARY KEY, tried INTEGER, data TEXT)")
            self._base.execute("CREATE TABLE IF NOT EXISTS request (id INTEGER PRIMARY KEY, data TEXT)")
            self._base.execute("CREATE INDEX IF NOT EXISTS by_state ON asset (state)")
            self._base.execute("CREATE INDEX IF NOT EXISTS by_content ON asset (content)")
        found = self.fact("version", VERSION)
        if found != VERSION:
            raise OutputError(
                f"was written by another version of lodpipe (table version {found})",
                place=str(self.path),
                advice="move it away: results that are published are recognised without it",
            )
        self.set_facts(version=VERSION)

    @contextlib.contextmanager
    def transaction(self) -> Iterator[None]:
        """All or nothing of what is written within it."""
        self._base.execute("BEGIN IMMEDIATE")
        try:
            yield
        except BaseException:
            self._base.execute("ROLLBACK")
            raise
        self._base.execute("COMMIT")

    def rows(self, where: str = "1", values: tuple[Any, ...] = ()) -> list[Row]:
        """The assets for which a condition holds."""
        return [_row(found) for found in self._base.execute(f"SELECT * FROM asset WHERE {where}", values)]

    def row(self, key: str) -> Row | None:
        """One asset."""
        return next(iter(self.rows("key = ?", (os.fsencode(key),))), None)

    def put(self, row: Row) -> None:
        """Write one asset whole."""
        names, marks = ", ".join(_COLUMNS), ", ".join("?" * len(_COLUMNS))
        self._base.execute(f"INSERT OR REPLACE INTO asset ({names}) VALUES ({marks})", _stored(row))

    def progress(self, key: str, step: int, stage: str, share: float, leased_until: float) -> None:
        """Note how far a running asset is."""
        self._base.execute(
            "UPDATE asset SET step = ?, stage = ?, share = ?, leased_until = ? WHERE key = ? AND state = ?",
            (step, stage, share, leased_until, os.fsencode(key), RUNNING),
        )

    def delete(self, key: str) -> None:
        """Forget an asset."""
        self._base.execute("DELETE FROM asset WHERE key = ?", (os.fsencode(key),))

    def published(self, content: str) -> Row | None:
        """An asset whose published result was made from that content."""
        found = self.rows("content = ? AND revision > 0 AND state IN (?, ?)", (content, DONE, GONE))
        return min(found, key=lambda row: (row.state != DONE, row.key), default=None)

    def counts(self) -> dict[str, int]:
        """How many assets are in each state."""
        found = dict(self._base.execute("SELECT state, count(*) FROM asset GROUP BY state").fetchall())
        return {state: int(found.get(state, 0)) for state in STATES}

    def fact(self, name: str, default: Any = None) -> Any:
        """Something that is known of the daemon as a whole."""
        found = self._base.execute("SELECT value FROM fact WHERE name = ?", (name,)).fetchone()
        return default if found is None else json.loads(found[0])

    def facts(self) -> dict[str, Any]:
        """All of that."""
        return {name: json.loads(value) for name, value in self._base.execute("SELECT name, value FROM fact")}

    def set_facts(self, **values: Any) -> None:
        """Write some of it."""
        self._base.executemany(
            "INSERT OR REPLACE INTO fact VALUES (?, ?)", [(name, json.dumps(value)) for name, value in values.items()]
        )

    def add_call(self, data: Mapping[str, Any]) -> None:
        """Note that a hook is to be called, until `end_call`."""
        self._base.execute("INSERT INTO call (tried, data) VALUES (0, ?)", (json.dumps(data),))

    def calls(self) -> list[tuple[int, int, dict[str, Any]]]:
        """(id, times tried, data) of the hooks to be called, oldest first."""
        return [(row[0], row[1], json.loads(row[2])) for row in self._base.execute("SELECT * FROM call ORDER BY id")]

    def try_call(self, number: int) -> None:
        """Count one try."""
        self._base.execute("UPDATE call SET tried = tried + 1 WHERE id = ?", (number,))

    def end_call(self, number: int) -> None:
        """Forget a call."""
        self._base.execute("DELETE FROM call WHERE id = ?", (number,))

    def add_request(self, data: Mapping[str, Any]) -> None:
        """Ask the daemon for something; it does it when it sees it, or when it is started next."""
        self._base.execute("INSERT INTO request (data) VALUES (?)", (json.dumps(data),))

    def requests(self) -> list[tuple[int, dict[str, Any]]]:
        """(id, data) of what has been asked for and not been done, oldest first."""
        return [(row[0], json.loads(row[1])) for row in self._base.execute("SELECT * FROM request ORDER BY id")]

    def end_request(self, number: int) -> None:
        """Forget a request."""
        self._base.execute("DELETE FROM request WHERE id = ?", (number,))

    def changes(self) -> int:
        """A number that is another one whenever somebody else has written."""
        return int(self._base.execute("PRAGMA data_version").fetchone()[0])

    def close(self) -> None:
        """Let go of the file."""
        self._base.close()


def _row(found: sqlite3.Row) -> Row:
    values = dict(found)
    for name in _PATHS:
        values[name] = os.fsdecode(values[name] or b"")
    for name in _DATA:
        values[name] = json.loads(values[name])
    return Row(**values)


def _stored(row: Row) -> list[Any]:
    values = {column: getattr(row, column) for column in _COLUMNS}
    for name in _PATHS:
        values[name] = os.fsencode(values[name])
    for name in _DATA:
        values[name] = json.dumps(values[name])
    for name in ("message", "reason", "stage"):  # names that are not Unicode
        values[name] = values[name].encode("utf-8", "backslashreplace").decode()
    return [values[column] for column in _COLUMNS]


def _set_aside(path: Path) -> Path:
    number = 1
    while (aside := path.with_name(f"{path.name}.broken{number}")).exists():
        number += 1
    path.rename(aside)
    for tail in ("-wal", "-shm"):
        with contextlib.suppress(FileNotFoundError):
            path.with_name(path.name + tail).rename(aside.with_name(aside.name + tail))
    return aside


def _broken(path: Path, error: Exception) -> OutputError:
    return OutputError(f"cannot be used ({error})", place=str(path), advice="see docs/operations.md, 'A broken disk'")
