"""The fresh process that does one job: ``python -m lodpipe.service.worker FD [MODULE …]``.

It loads the modules that are named before it looks for its job, so that the job need not wait for that. The job
comes as a line of JSON on stdin, which then stays open for as long as the parent lives; what happens goes as lines of
JSON to the file descriptor FD, so that whatever a library prints cannot disturb it.
"""

from __future__ import annotations

import contextlib
import dataclasses
import faulthandler
import importlib
import json
import os
import resource
import signal
import sys
import threading
import time
from typing import Any

from lodpipe.core.errors import LodpipeError
from lodpipe.service.job import Job, nature_of, process

PROGRESS_SECONDS = 0.1
"""Shortest time between two lines about progress within a stage."""
ORPHANED = 130


def main() -> int:
    """Do the job; the exit code says only whether an outcome was delivered."""
    faulthandler.enable()
    faulthandler.register(signal.SIGTERM, chain=True)  # over its time: the log says where it was
    with open(int(sys.argv[1]), "w", encoding="ascii", buffering=1) as events:  # noqa: PTH123 a descriptor, no path
        for name in sys.argv[2:]:
            with contextlib.suppress(ImportError, LodpipeError):  # the job that needs it tells what is wrong
                importlib.import_module(name)
        line = sys.stdin.readline()
        if not line:  # the parent needs no job done after all
            return 0
        job = Job.from_data(json.loads(line))
        with contextlib.suppress(ValueError, OSError):
            size, hard = job.limits.output_bytes, resource.getrlimit(resource.RLIMIT_FSIZE)[1]
            resource.setrlimit(resource.RLIMIT_FSIZE, (size if hard < 0 else min(size, hard), hard))
        threading.Thread(target=_die_with_parent, daemon=True).start()
        last: list[Any] = ["", 0.0]

        def progress(index: int, name: str, share: float) -> None:
            now = time.monotonic()
            if name != last[0] or now - last[1] >= PROGRESS_SECONDS:
                last[:] = [name, now]
                events.write(json.dumps({"progress": [index, name, share]}) + "\n")

        try:
            outcome = process(job, progress)
        except LodpipeError as error:
            events.write(json.dumps({"error": {"message": str(error), "nature": nature_of(error)}}) + "\n")
            return 1
        events.write(json.dumps({"modules": _loaded()}) + "\n")
        events.write(json.dumps({"outcome": dataclasses.asdict(outcome)}) + "\n")
    return 0


def _loaded() -> list[str]:
    """The parts of lodpipe that the job has needed: the next one will, too."""
    return sorted(name for name in sys.modules if name.startswith("lodpipe.") and name != "lodpipe.service.worker")


def _die_with_parent() -> None:
    """End this process when stdin ends: nobody is left who wants the result."""
    sys.stdin.read()
    os._exit(ORPHANED)


if __name__ == "__main__":
    sys.exit(main())
