"""``--set path=value``: a value put over what the configuration says."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Any

from lodpipe.config.model import Config
from lodpipe.config.problems import Problem, Problems, did_you_mean
from lodpipe.config.source import Path_, Source, read_text
from lodpipe.core.errors import ConfigError

_STEP = re.compile(r"([^.\[\]]+)|\[(\d+)\]")


def apply(source: Source, settings: Iterable[str]) -> Source:
    """`source` with every ``path=value`` of `settings` put in, in order.

    A path starts with a key of the configuration (``limits.minutes``, ``lods[0].ratio``, ``stages[1].padding``) or
    with the name of one of its stages (``decimate.metric``). Values are YAML. Raises ConfigErrors.
    """
    result = Source(source.name, copy.deepcopy(source.data), source.folder, dict(source.values), dict(source.keys))
    problems = Problems()
    for setting in settings:
        name = f"--set {setting.partition('=')[0]}"
        try:
            _apply(result, setting, name)
        except ConfigError as error:
            problems.add(Problem("", "", str(error)))
    problems.raise_all()
    return result


def settings_of(values: Mapping[str, Any]) -> list[str]:
    """``{"decimate.metric": "quadric"}`` as what `apply` takes."""
    return [f"{path}={json.dumps(value)}" for path, value in values.items()]


def _apply(source: Source, setting: str, name: str) -> None:
    path_text, equals, value_text = setting.partition("=")
    if not equals:
        raise ConfigError("must have the form stage.param=value", place=name)
    path = _resolve(source, _parse(path_text, name), name)
    value = read_text(value_text, name)
    if not isinstance(source.data, dict):
        source.data = {}
    target = source.data
    for depth, (step, following) in enumerate(pairwise(path)):
        if isinstance(step, str) and isinstance(target, dict) and target.get(step) is None:
            target[step] = [] if isinstance(following, int) else {}
            source.values[path[: depth + 1]] = name
        target = _into(target, step, name)
    last = path[-1]
    if isinstance(last, int) and isinstance(target, list) and last == len(target):
        target.append(None)
    _into(target, last, name, check_only=True)
    target[last] = value.data
    for places in (source.values, source.keys):
        for old in [written for written in places if written[: len(path)] == path]:
            del places[old]
    for inner in value.values:
        source.values[(*path, *inner)] = source.keys[(*path, *inner)] = name


def _parse(text: str, name: str) -> Path_:
    steps: list[str | int] = []
    position = 0
    while position < len(text):
        if text[position] == "." and steps and position + 1 < len(text):
            position += 1
        match = _STEP.match(text, position)
        if not match:
            raise ConfigError(f"'{text}' is not a path such as decimate.metric or lods[0].ratio", place=name)
        steps.append(int(match[2]) if match[2] else match[1])
        position = match.end()
    if not steps or not isinstance(steps[0], str):
        raise ConfigError(f"'{text}' is not a path such as decimate.metric or lods[0].ratio", place=name)
    return tuple(steps)


def _resolve(source: Source, path: Path_, name: str) -> Path_:
    """The path from the top of the data, stages found by their names, the stage's own name put in."""
    data = source.data if isinstance(source.data, dict) else {}
    listed = data.get("stages")
    stages = listed if isinstance(listed, list) else []
    names = [str(next(iter(stage), "") if isinstance(stage, dict) else stage) for stage in stages]
    head = path[0]
    if head not in Config.model_fields:
        places = [index for index, stage in enumerate(names) if stage == head]
        if not places:
            near = did_you_mean(str(head), {*names, *Config.model_fields})
            raise ConfigError(f"the configuration has no stage or key '{head}'{near}", place=name)
        if len(places) > 1:
            which = " or ".join(f"stages[{index}].{path[1] if len(path) > 1 else '…'}" for index in places)
            raise ConfigError(f"'{head}' stands {len(places)} times in the chain; say which: {which}", place=name)
        path = ("stages", places[0], *path[1:])
    if path[0] == "stages" and len(path) > 2 and isinstance(path[1], int) and path[1] < len(stages):
        stage = names[path[1]]
        if isinstance(stages[path[1]], str):
            stages[path[1]] = {stage: {}}
        rest = path[2:] if path[2] != stage else path[3:]
        path = ("stages", path[1], stage, *rest)
    return path


def _into(target: Any, step: str | int, name: str, *, check_only: bool = False) -> Any:
    if isinstance(target, dict) and isinstance(step, str):
        if check_only:
            return None
        if not isinstance(target[step], dict | list):
            raise ConfigError(f"'{step}' has no parts that could be set", place=name)
        return target[step]
    if isinstance(target, list) and isinstance(step, int):
        if step >= len(target):
            raise ConfigError(f"there is no [{step}]: the list has {len(target)} entries", place=name)
        return target[step]
    raise ConfigError(
        f"'{step}' does not fit here: {'a list' if isinstance(target, list) else 'a mapping'}", place=name
    )
