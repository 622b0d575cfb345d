"""Files beside an asset: found by the names that it gives, and never outside its own folder."""

from __future__ import annotations

import os
import re
import stat
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote

from lodpipe.core.errors import AssetError, LimitError
from lodpipe.io.limits import Limits

_SCHEME = re.compile(r"^[A-Za-z][A-Za-z0-9+.-]*:")


@dataclass
class Folder:
    """The folder of one asset, and the files of it that have been read (`members`, in order)."""

    path: Path
    """The asset's own file."""
    limits: Limits
    members: list[Path] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    """Names that the asset gives, with slashes, and that are not there."""
    _bytes: int = 0

    def read_asset(self) -> bytes:
        """The asset's own file."""
        return self._read(self.path)

    def read(self, name: str) -> bytes:
        """The file that the asset calls `name`. AssetError: unsafe, missing or unreadable."""
        return self._read(self.find(name))

    def read_uri(self, uri: str) -> bytes:
        """The same for a glTF URI, in which %20 stands for a space."""
        try:
            name = unquote(uri, errors="strict")
        except UnicodeDecodeError as error:
            raise AssetError(f"the URI {shorten(uri)} is not UTF-8") from error
        return self.read(name)

    def find(self, name: str) -> Path:
        """The path of the file that the asset calls `name`, which is inside the folder and not a link that leaves it.

        Backslashes separate folders, and where there is no such file the case of letters does not count, if that leaves
        one (files written on Windows). Raises AssetError.
        """
        shown = shorten(name)
        parts = name.replace("\\", "/")
        if _SCHEME.match(parts):
            raise AssetError(f"{shown} is an address or a drive, not a file beside the asset", advice=_ADVICE)
        if parts.startswith("/") or "\0" in parts:
            raise AssetError(f"{shown} is not a relative path", advice=_ADVICE)
        root = self.path.parent.resolve()
        try:
            target = (root / parts).resolve()
            inside = target.is_relative_to(root)
            exists = inside and target.is_file()
            if inside and not exists:
                target = (_in_other_case(root, parts) or target).resolve()
                exists = target.is_relative_to(root) and target.is_file()
        except (OSError, RuntimeError) as error:  # a name too long; a loop of links
            why = getattr(error, "strerror", None) or "a loop of links"
            raise AssetError(f"{shown} cannot be opened ({why})") from error
        if not inside:
            raise AssetError(f"{shown} leads out of the asset's folder", advice=_ADVICE)
        if not exists:
            self.missing.append(parts)
            raise AssetError(f"{shown} is missing", advice="put the file beside the asset")
        return target

    def _read(self, path: Path) -> bytes:
        try:
            status = path.stat()
            if not stat.S_ISREG(status.st_mode):
                raise AssetError(f"{path.name} is not a regular file")
            self._bytes += status.st_size
            if self._bytes > self.limits.input_bytes:
                raise LimitError(
                    f"its files have {self._bytes:,} bytes, more than the limit of {self.limits.input_bytes:,}",
                    advice="split the model, or raise limits.input_bytes",
                )
            data = path.read_bytes()
        except FileNotFoundError as error:
            raise AssetError("no such file", advice="check the path") from error
        except OSError as error:
            raise AssetError(
                f"{path.name} cannot be read ({error.strerror or error})", advice="check its permissions"
            ) from error
        if path not in self.members:
            self.members.append(path)
        return data


def _in_other_case(root: Path, name: str) -> Path | None:
    """The one path below `root` that is `name` but for the case of its letters."""
    path = root
    for part in name.split("/"):
        if part == "..":
            return None
        if part in ("", "."):
            continue
        if not path.is_dir():
            return None
        same = [entry.name for entry in path.iterdir() if entry.name.casefold() == part.casefold()]
        if part not in same and len(same) != 1:
            return None
        path /= part if part in same else same[0]
    return path


def stem(path: Path) -> str:
    """A file's name without its ending, as text: bytes that are not UTF-8 become U+FFFD."""
    return os.fsencode(path.stem).decode("utf-8", "replace")


_ADVICE = "only files in the folder of the asset, or below it, are read"


def shorten(text: str, length: int = 80) -> str:
    """`text` in quotes, without control characters and cut to `length`, for messages."""
    clean = "".join(c if c.isprintable() else "?" for c in text)
    return f"'{clean}'" if len(clean) <= length else f"'{clean[: length - 1]}…'"
