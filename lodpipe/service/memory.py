"""How much memory this process may take, and has taken."""

from __future__ import annotations

import contextlib
import resource
import sys
from collections.abc import Iterator
from pathlib import Path

_GB = 1 << 30


@contextlib.contextmanager
def memory_limit(gigabytes: float) -> Iterator[None]:
    """Let this process take `gigabytes` more than it has now; beyond that allocations fail (MemoryError).

    It bounds private writable memory (RLIMIT_DATA): address space alone says little, as libraries reserve more than
    they use. A system without such limits is left as it is.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    wanted = _data_now() + int(gigabytes * _GB)
    if hard != resource.RLIM_INFINITY:
        wanted = min(wanted, hard)
    try:
        resource.setrlimit(resource.RLIMIT_DATA, (wanted, hard))
    except (ValueError, OSError):
        yield
        return
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def peak_memory_mb() -> float:
    """The most memory that this process has had at once, in MB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(peak / (1 << 20 if sys.platform == "darwin" else 1 << 10), 1)


def resident_gb(pid: int, *, family: bool = True) -> float:
    """Memory in GB that a process, with `family` all that it has started too, holds; 0 where the system tells not."""
    page = resource.getpagesize()
    total, todo, seen = 0, [pid], set[int]()
    while todo:
        one = todo.pop()
        if one in seen:
            continue
        seen.add(one)
        try:
            total += int(Path(f"/proc/{one}/statm").read_text(encoding="ascii").split()[1]) * page
            for thread in Path(f"/proc/{one}/task").iterdir() if family else ():
                todo += map(int, (thread / "children").read_text(encoding="ascii").split())
        except (OSError, IndexError):  # it has ended in between, or there is no /proc
            continue
    return total / _GB


def _data_now() -> int:
    """Bytes of private writable memory that this process has, 0 where the system does not tell."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) << 10 for line in lines if line.startswith("VmData:")), 0)
