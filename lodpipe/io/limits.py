"""How much a file may ask for before it is refused."""

from __future__ import annotations

from dataclasses import dataclass

from lodpipe.core.errors import LimitError


@dataclass(frozen=True)
class Limits:
    """Upper bounds that hold while a file is read; beyond one of them reading stops with a LimitError."""

    triangles: int = 20_000_000
    """Triangles stored in one file (instances count once)."""
    texture_pixels: int = 268_435_456
    """Pixels of one image, by its header."""
    input_bytes: int = 4 << 30
    """Bytes of all files of one asset, and of each array that a file declares."""
    json_bytes: int = 256 << 20
    """Bytes of a glTF's JSON."""
    json_depth: int = 200
    """Brackets inside brackets in a glTF's JSON."""
    node_depth: int = 1000
    """Nodes under nodes in a glTF's scene."""

    def check_triangles(self, count: int) -> None:
        """Raise LimitError if a file has `count` triangles, or says so, and that is too many."""
        if count > self.triangles:
            raise LimitError(
                f"{count:,} triangles, more than the limit of {self.triangles:,}",
                advice="split the model, or raise limits.triangles",
            )


DEFAULT = Limits()
