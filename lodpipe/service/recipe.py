"""What a result is made by, as plain data: the resolved configuration, the stages' versions, where plug-ins lie.

The daemon asks for it in a process of its own (``python -m lodpipe.service.recipe``): plug-ins are then imported
anew whenever the configuration is read, and neither they nor the geometry behind the stages stay in its memory.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import json
import os
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import lodpipe
from lodpipe.config.problems import ConfigErrors, Problem
from lodpipe.core.errors import ConfigError, LodpipeError
from lodpipe.pipeline import Pipeline
from lodpipe.service.chain import Loaded, load_chain
from lodpipe.stage import AnyStage

_NO_INFLUENCE = ("threads", "limits", "watch", "cache")
"""Keys of the configuration that never change what is published."""


@dataclass(frozen=True)
class Recipe:
    """A chain as data that a job, a manifest and a fingerprint are made of."""

    config: dict[str, Any]
    """Resolved, every default included."""
    stages: tuple[dict[str, Any], ...]
    """Name and version of each step; of plug-ins a digest of their file as well."""
    plugins: tuple[str, ...] = ()
    """Folders of plug-ins."""
    files: tuple[str, ...] = ()
    """The configuration's file and the plug-ins': when one changes, the recipe may."""

    @classmethod
    def of(cls, pipeline: Pipeline, folders: Iterable[Path] = (), config: str = "") -> Recipe:
        """The recipe of a pipeline that was loaded from the file `config`, with plug-ins from `folders`."""
        resolved = tuple(str(folder.resolve()) for folder in folders)
        files = [str(path) for folder in resolved for path in sorted(Path(folder).glob("*.py"))]
        if config and Path(config).is_file():
            files.insert(0, str(Path(config).resolve()))
        stages = tuple(_version(step.stage) for step in pipeline.steps)
        return cls(pipeline.resolved(), stages, resolved, tuple(files))

    @classmethod
    def loaded(cls, loaded: Loaded) -> Recipe:
        """The same of what `load_chain` gives."""
        return cls.of(loaded.pipeline, loaded.folders, loaded.name)

    @property
    def influence(self) -> dict[str, Any]:
        """What of it decides on the result."""
        config = {key: value for key, value in self.config.items() if key not in _NO_INFLUENCE}
        return {"config": config, "stages": list(self.stages)}

    @functools.cached_property
    def id(self) -> str:
        """Hex digest of its influence: two recipes of one id make the same."""
        return hashlib.sha256(json.dumps(self.influence, sort_keys=True).encode()).hexdigest()


def read_recipe(config: str, settings: Iterable[str] = (), plugins: Iterable[str | Path] = ()) -> Recipe:
    """Load a configuration in a process of its own. Raises ConfigError, with a line for each problem."""
    request = {"config": config, "settings": list(settings), "plugins": [os.fspath(folder) for folder in plugins]}
    done = subprocess.run(
        [sys.executable, "-m", "lodpipe.service.recipe"],
        input=json.dumps(request),
        capture_output=True,
        text=True,
        check=False,
        env=module_environment(),
    )
    answer = json.loads(done.stdout.splitlines()[-1]) if done.returncode == 0 else {}
    if "problems" in answer:
        raise ConfigErrors(Problem(*entry) for entry in answer["problems"])
    if "recipe" not in answer:
        last = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        raise ConfigError(f"the configuration cannot be loaded: {last}", place=config)
    data = answer["recipe"]
    return Recipe(data["config"], *(tuple(data[key]) for key in ("stages", "plugins", "files")))


def module_environment() -> dict[str, str]:
    """The environment in which ``python -m lodpipe…`` finds the same lodpipe as this process."""
    home = str(Path(lodpipe.__file__).parent.parent)
    path = os.pathsep.join(filter(None, (home, os.environ.get("PYTHONPATH"))))
    return {**os.environ, "PYTHONPATH": path}


def _version(stage: AnyStage) -> dict[str, Any]:
    """A stage's name and version; for plug-ins, which are edited in place, a digest of their file as well."""
    entry: dict[str, Any] = {"name": stage.name, "version": stage.version}
    if stage.origin != "built in":
        source = inspect.getsourcefile(stage.function)
        entry["source"] = hashlib.sha256(Path(source).read_bytes()).hexdigest() if source else ""
    return entry


def main() -> int:
    """Answer one request: JSON on stdin, JSON on stdout."""
    request = json.load(sys.stdin)
    try:
        loaded = load_chain(request["config"], request["settings"], request["plugins"])
        answer: dict[str, Any] = {"recipe": asdict(Recipe.loaded(loaded))}
    except ConfigErrors as error:
        answer = {"problems": [[entry.place, entry.subject, entry.cause] for entry in error.problems]}
    except LodpipeError as error:
        cause = f"{error.cause}; {error.advice}" if error.advice else error.cause
        answer = {"problems": [[error.place, "", cause]]}
    print(json.dumps(answer))
    return 0


if __name__ == "__main__":
    sys.exit(main())
