"""Hooks: a command or a web address of the user's, told when an asset is done or has failed.

Calls wait in the job table until they have been made, so that a crash of the daemon loses none; one may be made twice.
"""

from __future__ import annotations

import json
import logging
import os
import subprocess
import threading
import urllib.request
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lodpipe.config.watch import Hook, Watch
from lodpipe.service.table import JobTable

TRIES = 3
PAUSE_SECONDS = 5.0


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
        table = JobTable(self._state)
        while not self._stop.is_set():
            again = False
            for number, tried, data in table.calls():
                if self._stop.is_set():
                    break
                problem = call(self.watch.on_done if data["event"] == "done" else self.watch.on_failed, data)
                if problem and tried + 1 < TRIES:
                    table.try_call(number)
                    again = True
                else:
                    table.end_call(number)
                if problem:
                    self._log.warning("hook for %s: %s", data["asset"], problem, extra={"asset": data["asset"]})
            self._wake.wait(PAUSE_SECONDS if again else None)
            self._wake.clear()
        table.close()


def call(hook: Hook, data: Mapping[str, Any]) -> str:
    """Make one call; what went wrong, or ''. Names never reach a shell: they are variables and JSON, not arguments."""
    text = json.dumps(dict(data))
    problem = ""
    if hook.command:
        names = {f"LODPIPE_{name.upper()}": str(value) for name, value in data.items()}
        try:
            done = subprocess.run(
                list(hook.command),
                input=text,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=hook.timeout_s,
                env={**os.environ, **names},
                check=False,
                start_new_session=True,
            )
            if done.returncode:
                last = (done.stderr.strip().splitlines() or [""])[-1]
                problem = f"{hook.command[0]} ended with {done.returncode} {last}".strip()
        except (OSError, ValueError, subprocess.TimeoutExpired) as error:
            problem = f"{hook.command[0]}: {error}"
    if hook.webhook:
        request = urllib.request.Request(hook.webhook, text.encode(), {"Content-Type": "application/json"})
        try:
            with urllib.request.urlopen(request, timeout=hook.timeout_s):
                pass
        except (OSError, ValueError) as error:
            problem = f"{problem}; {hook.webhook}: {error}".removeprefix("; ")
    return problem
