"""The stages that there are: built in, from installed packages, and from folders of Python files."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.util
import sys
import traceback
from collections.abc import Iterable, Iterator
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType

from lodpipe.core.errors import ConfigError
from lodpipe.stage import AnyStage, Stage

ENTRY_POINTS = "lodpipe.stages"
"""The group in which a package names its stages: each entry a `Stage`, or a module that has some."""


def find_stages(folders: Iterable[Path] = (), *, installed: bool = True) -> dict[str, AnyStage]:
    """All stages by name: built in, then entry points (if `installed`), then the files in `folders`.

    Every ``.py`` file in a folder is a plug-in, except those whose names start with ``_``, ``.`` or ``test_``. Raises
    ConfigError, one line, for a plug-in that cannot be loaded and for a name that is taken.
    """
    from lodpipe.stages import BUILTIN  # pulls in the geometry: only when stages are really wanted

    found: dict[str, AnyStage] = dict(BUILTIN)
    for stage in _installed() if installed else ():
        _add(found, stage)
    for folder in dict.fromkeys(path.resolve() for path in folders):
        for stage in _in_folder(folder):
            _add(found, stage)
    return found


def _add(found: dict[str, AnyStage], stage: AnyStage) -> None:
    taken = found.get(stage.name)
    if taken:
        raise ConfigError(
            f"the stage '{stage.name}' is there already ({taken.origin})",
            place=stage.origin,
            advice="give one of the two another name",
        )
    found[stage.name] = stage


def _installed() -> Iterator[AnyStage]:
    for point in sorted(entry_points(group=ENTRY_POINTS), key=lambda point: point.name):
        origin = f"{point.dist.name} {point.dist.version}" if point.dist else point.value
        try:
            loaded = point.load()
        except Exception as error:  # whatever a package does while it is imported, the user gets one line
            raise ConfigError(
                f"the plug-in cannot be loaded: {type(error).__name__}: {error}",
                place=f"{origin} ({point.value})",
                advice="update or uninstall it",
            ) from error
        stages = _stages_of(loaded) if isinstance(loaded, ModuleType) else [loaded]
        for stage in stages:
            if not isinstance(stage, Stage):
                raise ConfigError(f"is not a stage but a {type(stage).__name__}", place=f"{origin} ({point.value})")
            yield dataclasses.replace(stage, origin=origin)


def _in_folder(folder: Path) -> Iterator[AnyStage]:
    if not folder.is_dir():
        raise ConfigError("there is no such folder of plug-ins", place=str(folder))
    for path in sorted(folder.glob("*.py")):
        if path.name.startswith(("_", ".", "test_")):
            continue
        stages = _stages_of(_load(path))
        if not stages:
            raise ConfigError(
                "has no stage", place=str(path), advice="decorate a function with @stage, or let its name start with _"
            )
        yield from (dataclasses.replace(stage, origin=str(path)) for stage in stages)


def _load(path: Path) -> ModuleType:
    """The module in a file. It needs an entry in `sys.modules`: pydantic looks annotations up there."""
    name = f"lodpipe_plugin_{hashlib.sha256(str(path).encode()).hexdigest()[:12]}_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ConfigError("is not a Python file", place=str(path))
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:  # whatever the file does, the user gets one line
        del sys.modules[name]
        cause = f"the plug-in cannot be loaded: {type(error).__name__}: {error}"
        raise ConfigError(cause, place=_place(path, error), advice="mend it, or take it out of the folder") from error
    return module


def _place(path: Path, error: BaseException) -> str:
    """The last line of the file that the error went through."""
    if isinstance(error, SyntaxError) and error.lineno:
        return f"{path}:{error.lineno}"
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    return f"{path}:{lines[-1]}" if lines else str(path)


def _stages_of(module: ModuleType) -> list[AnyStage]:
    """The stages that are defined in `module`, not those that it imports."""
    return [
        value
        for value in vars(module).values()
        if isinstance(value, Stage) and value.function.__module__ == module.__name__
    ]
