"""When an asset may be taken: the rule alone, without files and without a clock."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple


class Signature(NamedTuple):
    """What tells that a file has changed without reading it."""

    size: int
    mtime_ns: int
    inode: int


class Seen(NamedTuple):
    """A file as it was found, and since when (monotonic seconds) it has been found like that."""

    signature: Signature
    since: float
    closed: bool = False
    """Whether its writer is known to be through with it as it is."""

    def rests(self, settle_s: float, closed_s: float) -> float:
        """When it has been quiet for long enough."""
        return self.since + (min(closed_s, settle_s) if self.closed else settle_s)


@dataclass(frozen=True)
class Verdict:
    """What to do with an asset: take it when `ready`, else look again at the time `due`."""

    ready: bool
    due: float = float("inf")
    missing: tuple[str, ...] = ()
    """Files that it waits for; of those that are too short yet, how far they are."""
    given_up: bool = False
    """Whether the time to wait for them is over."""


def note(before: Seen | None, signature: Signature, now: float) -> Seen:
    """A file was found with `signature`: the quiet time begins anew if that is another one than before."""
    return before if before is not None and before.signature == signature else Seen(signature, now)


def judge(
    main: Seen,
    members: Mapping[str, tuple[Seen, int]],
    missing: Iterable[str],
    now: float,
    *,
    settle_s: float,
    closed_s: float,
    wait_s: float,
) -> Verdict:
    """The verdict on an asset of a file `main` and `members` (each with the bytes that it must have at least).

    1. No member may have changed for `settle_s`, or for `closed_s` if its writer is through; a file that appears
       counts as changed.
    2. All members must be there, and each be as long as the asset says; else the asset waits for them.
    3. After `wait_s` without any change it is given up.
    """
    files = [main, *(seen for seen, _ in members.values())]
    short = [
        f"{name} ({seen.signature.size:,} of {length:,} bytes)"
        for name, (seen, length) in members.items()
        if seen.signature.size < length
    ]
    absent = (*missing, *short)
    if absent:
        over = max(seen.since for seen in files) + max(wait_s, settle_s)
        return Verdict(False, over, absent, given_up=now >= over)
    over = max(seen.rests(settle_s, closed_s) for seen in files)
    return Verdict(now >= over, over)
