"""Which asset is next: priorities first, then the small ones, and nobody waits for ever."""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping

from lodpipe.service.table import Row

BYTES_PER_SECOND = 1_000_000.0
"""How much smaller a later asset must be to go first, for each second that the earlier one has waited."""
SECONDS_PER_POINT = 60.0


def priority_of(key: str, priorities: Mapping[str, int]) -> int:
    """The priority of an asset: the highest of the globs that match its path or its name, 0 without one."""
    name = key.rpartition("/")[2]
    found = [
        value
        for pattern, value in priorities.items()
        if fnmatch.fnmatchcase(key, pattern) or fnmatch.fnmatchcase(name, pattern)
    ]
    return max(found, default=0)


def rank(row: Row) -> tuple[bool, float, str]:
    """The lowest goes first. As all ages grow alike, the order of two assets never changes while they wait.

    What had the same content as another asset waits for that one, which has a result of its own.
    """
    return bool(row.same_as), row.queued_at + row.size / BYTES_PER_SECOND - row.priority * SECONDS_PER_POINT, row.key
