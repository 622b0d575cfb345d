"""What several steps of one run need and is dear to make: kept by content, within a bound on memory."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Any, TypeVar

T = TypeVar("T")


class Cache:
    """Values by key, the least recently used dropped first when their sizes add up to more than `limit` bytes.

    A key must name everything that the value depends on (fingerprints, options): what comes out of the cache is then
    what would have been made anew. It lives as long as a run over one asset. Threads may share it; two that ask for
    the same key at once make the value twice.
    """

    def __init__(self, limit: int = 512 << 20) -> None:
        self.limit = limit
        self.held = 0
        self._values: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()
        self._guard = Lock()

    def get(self, key: Hashable, make: Callable[[], T], size: Callable[[T], int]) -> T:
        """The value of `key`; made, and kept if its size in bytes is within the limit, when it is not there."""
        with self._guard:
            if key in self._values:
                self._values.move_to_end(key)
                found: T = self._values[key][0]
                return found
        value = make()
        cost = size(value)
        with self._guard:
            if cost <= self.limit and key not in self._values:
                self._values[key] = (value, cost)
                self.held += cost
                while self.held > self.limit:
                    _, (_, dropped) = self._values.popitem(last=False)
                    self.held -= dropped
        return value

    def __len__(self) -> int:
        return len(self._values)
