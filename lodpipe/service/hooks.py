"""Hooks: a command or a web address of the user's, told when an asset is done or has failed.

Calls wait in the job table until they have been made, so that a crash of the daemon loses none; one may be made twice.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import signal
import sqlite3
import subprocess
import tempfile
import threading
import urllib.request
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lodpipe.config.watch import Hook, Watch
from lodpipe.core.errors import LodpipeError
from lodpipe.service.table import JobTable

TRIES = 3
PAUSE_SECONDS = 5.0
TAIL_BYTES = 4096


class Hooks:
    """A thread that makes the calls that wait in a job table."""

    def __init__(self, state: Path, watch: Watch, log: logging.Logger) -> None:
        self._state, self._log = state, log
        self.watch = watch
        self._wake, self._stop = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="hooks", daemon=True)
        self._thread.start()

    def look(self) -> None:
        """There may be calls to make."""
        self._wake.set()

    def close(self) -> None:
        """End after the call that is being made; what waits is made next time."""
        self._stop.set()
        self._wake.set()
        self._thread.join(timeout=10)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                table = JobTable(self._state)
                try:
                    while not self._stop.is_set():
                        again = self._make_calls(table)
                        self._wake.wait(PAUSE_SECONDS if again else None)
                        self._wake.clear()
                finally:
                    table.close()
            except (sqlite3.Error, LodpipeError) as error:  # a full disk: what waits is made when there is space
                self._log.warning("hooks wait: %s", error)
                self._stop.wait(PAUSE_SECONDS)

    def _make_calls(self, table: JobTable) -> bool:
        """Make the calls that wait; whether some must be made again."""
        again = False
        for number, tried, data in table.calls():
            if self._stop.is_set():
                break
            table.try_call(number)
            problem = call(self.watch.on_done if data["event"] == "done" else self.watch.on_failed, data)
            if problem and tried + 1 < TRIES:
                again = True
            else:
                table.end_call(number)
            if problem:
                self._log.warning("hook for %s: %s", data["asset"], problem, extra={"asset": data["asset"]})
        return again


def call(hook: Hook, data: Mapping[str, Any]) -> str:
    """Make one call; what went wrong, or ''. Names never reach a shell: they are variables and JSON, not arguments."""
    text = json.dumps(dict(data))
    problem = ""
    if hook.command:
        names = {f"LODPIPE_{name.upper()}": str(value) for name, value in data.items()}
        try:
            problem = _run_command(hook, text, {**os.environ, **names})
        except (OSError, ValueError) as error:
            problem = f"{hook.command[0]}: {error}"
    if hook.webhook:
        request = urllib.request.Request(hook.webhook, text.encode(), {"Content-Type": "application/json"})
        try:
            with urllib.request.urlopen(request, timeout=hook.timeout_s):
                pass
        except (OSError, ValueError) as error:
            problem = f"{problem}; {hook.webhook}: {error}".removeprefix("; ")
    return problem


def _run_command(hook: Hook, text: str, environment: Mapping[str, str]) -> str:
    """Run the program; what went wrong. Over its time, it is ended with all that it has started."""
    with tempfile.TemporaryFile() as stdin, tempfile.TemporaryFile() as stderr:
        stdin.write(text.encode("ascii"))
        stdin.seek(0)
        process = subprocess.Popen(
            list(hook.command),
            stdin=stdin,
            stdout=subprocess.DEVNULL,
            stderr=stderr,
            env=environment,
            start_new_session=True,
        )
        try:
            code = process.wait(hook.timeout_s)
        except subprocess.TimeoutExpired:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            return f"{hook.command[0]} took longer than {hook.timeout_s:g} s"
        if not code:
            return ""
        stderr.seek(max(0, stderr.seek(0, os.SEEK_END) - TAIL_BYTES))
        said = stderr.read().decode("utf-8", "replace").strip().splitlines()
        return f"{hook.command[0]} ended with {code} {said[-1] if said else ''}".strip()
