"""From what the user names (a configuration, settings, folders of plug-ins) to a pipeline that can run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lodpipe.config import overrides, presets
from lodpipe.config.source import Source
from lodpipe.pipeline import Pipeline
from lodpipe.plugins import find_stages

Config = str | Path | Mapping[str, Any]
"""A path, a preset's bare name, or the configuration itself as data."""
Settings = Iterable[str] | Mapping[str, Any]
"""``["decimate.metric=quadric"]``, or the same as ``{"decimate.metric": "quadric"}``."""

PLUGINS = "plugins"
"""The folder beside a configuration whose plug-ins are found without being named."""


@dataclass(frozen=True)
class Loaded:
    """A pipeline, the name of its configuration, and the folders that its plug-ins came from."""

    name: str
    pipeline: Pipeline
    folders: tuple[Path, ...]


def load_chain(config: Config = "default", settings: Settings = (), plugins: Iterable[str | Path] = ()) -> Loaded:
    """Read, override and check a configuration. Raises ConfigError, with a line for each problem."""
    source = Source("config", dict(config)) if isinstance(config, Mapping) else presets.find(config)
    listed = overrides.settings_of(settings) if isinstance(settings, Mapping) else settings
    source = overrides.apply(source, listed)
    folders = (*plugin_folders(source), *(Path(folder) for folder in plugins))
    return Loaded(source.name, Pipeline.load(source, find_stages(folders)), folders)


def load_pipeline(config: Config = "default", settings: Settings = (), plugins: Iterable[str | Path] = ()) -> Pipeline:
    """The pipeline of a configuration: a path, a preset's bare name, or the data itself.

    `settings` stand over it (``{"decimate.metric": "quadric", "lods": [{"ratio": 0.1}]}``); `plugins` are folders of
    plug-in files. Raises ConfigError, with a line for each problem.
    """
    return load_chain(config, settings, plugins).pipeline


def plugin_folders(source: Source) -> tuple[Path, ...]:
    """Folders of plug-ins that a configuration names, and the one beside it."""
    home = source.folder or Path()
    data = source.data if isinstance(source.data, dict) else {}
    listed = data.get("plugins")
    named = [home / name for name in listed if isinstance(name, str)] if isinstance(listed, list) else []
    beside = home / PLUGINS
    return (*named, *([beside] if source.folder is not None and beside.is_dir() else []))
