"""What can be seen of assets: their files, which files they need, and which of them have changed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lodpipe.io.limits import Limits
from lodpipe.io.needs import Needs
from lodpipe.service.scan import Tree
from lodpipe.service.settle import Seen, Signature, note
from lodpipe.service.snapshot import member_path, needs_of

Signatures = Mapping[str, list[int] | None]
"""Of the members of an asset, by their paths below the watched folder; None for one that was not there."""


class Sight:
    """The listing of the watched folder, and what follows from it for single assets."""

    def __init__(self, tree: Tree, limits: Limits) -> None:
        self.tree = tree
        self._limits = limits
        self._needs: dict[str, tuple[Any, Needs]] = {}
        self._beside: dict[str, Seen] = {}

    def seen(self, path: str, now: float) -> Seen | None:
        """A file, also one that the listing leaves out (in a hidden folder of textures)."""
        if seen := self.tree.get(path):
            return seen
        try:
            status = (self.tree.root / path).stat()
        except OSError:
            self._beside.pop(path, None)
            return None
        signature = Signature(status.st_size, status.st_mtime_ns, status.st_ino)
        self._beside[path] = note(self._beside.get(path), signature, now)
        return self._beside[path]

    def same(self, known: Signatures, now: float) -> bool:
        """Whether the files are there, and absent, as they are known; False where nothing is known."""
        return bool(known) and not self.changed(known, now)

    def changed(self, known: Signatures, now: float) -> list[str]:
        """Those that are not."""
        return [path for path, said in known.items() if self._signature(path, now) != said]

    def stale(self, known: Signatures) -> bool:
        """Whether a file that was there is another one now, as the file system says this moment."""
        for path, said in known.items():
            if said is None:
                continue
            try:
                status = (self.tree.root / path).stat()
            except OSError:
                return True
            if [status.st_size, status.st_mtime_ns, status.st_ino] != said:
                return True
        return False

    def needs(self, key: str, now: float) -> Needs:
        """What an asset needs, looked up anew when it or a file that may name further ones has changed."""
        known = self._needs.get(key)
        if known and self._stamp(key, known[1], now) == known[0]:
            return known[1]
        needs = needs_of(self.tree.root / key, self._limits)
        self._needs[key] = (self._stamp(key, needs, now), needs)
        return needs

    def forget(self, key: str) -> None:
        """The asset is gone, or at rest: what was looked up can be looked up again."""
        self._needs.pop(key, None)

    def _stamp(self, key: str, needs: Needs, now: float) -> list[list[int] | None]:
        names = (*needs.members, *needs.wanted)
        return [self._signature(path, now) for path in (key, *(member_path(key, name) for name in names))]

    def _signature(self, path: str, now: float) -> list[int] | None:
        seen = self.seen(path, now)
        return list(seen.signature) if seen else None
