"""Where configurations come from: a file, or the bare name of a preset that is shipped with lodpipe."""

from __future__ import annotations

from pathlib import Path

from lodpipe.config.problems import did_you_mean
from lodpipe.config.source import Source, read_file
from lodpipe.core.errors import ConfigError

_HERE = Path(__file__).parent
FOLDER = _HERE / "presets" if (_HERE / "presets").is_dir() else _HERE.parents[1] / "config"
"""Beside this module in an installed package; the repository's `config` folder in a working tree."""


def names() -> list[str]:
    """The presets' names."""
    return sorted(path.stem for path in FOLDER.glob("*.yaml"))


def find(config: str | Path) -> Source:
    """The configuration `config`: a path, or a preset's bare name. Raises ConfigError."""
    path = Path(config)
    if path.is_file():
        return read_file(path)
    text = str(config)
    if text in names():
        return read_file(FOLDER / f"{text}.yaml", text)
    if path.suffix in (".yaml", ".yml") or len(path.parts) > 1:
        raise ConfigError("there is no such file", place=text)
    raise ConfigError(f"there is no such file or preset{did_you_mean(text, names())}", place=text)
