"""The daemon's log: JSON, a line for each event, with the asset and the job that it is about; text for terminals."""

from __future__ import annotations

import json
import logging
import time
from typing import TextIO

FIELDS = ("asset", "job", "state")


class JsonLines(logging.Formatter):
    """One JSON object a line."""

    def format(self, record: logging.LogRecord) -> str:
        stamp = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created))
        data = {"time": f"{stamp}.{int(record.msecs):03d}Z", "level": record.levelname.lower()}
        data |= {name: getattr(record, name) for name in FIELDS if hasattr(record, name)}
        data["message"] = record.getMessage()
        if record.exc_info:
            data["traceback"] = self.formatException(record.exc_info)
        return json.dumps(data)


def daemon_log(stream: TextIO, *, text: bool) -> logging.Logger:
    """A logger of the daemon's own."""
    handler = logging.StreamHandler(stream)
    handler.setFormatter(logging.Formatter("%(asctime)s %(message)s", "%H:%M:%S") if text else JsonLines())
    log = logging.Logger("lodpipe.watch", logging.INFO)
    log.addHandler(handler)
    return log
