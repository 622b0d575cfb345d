"""A configuration's data, checked against the stages that there are: the name is looked up first, then its params."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from lodpipe.config.messages import show_path, validate
from lodpipe.config.model import Config
from lodpipe.config.problems import Problem, Problems, did_you_mean
from lodpipe.config.source import Path_, Source
from lodpipe.stage import AnyStage, Params


@dataclass(frozen=True)
class Step:
    """One stage with its parameters."""

    stage: AnyStage
    params: Params


def bind(source: Source, known: Mapping[str, AnyStage]) -> tuple[Config, tuple[Step, ...]]:
    """The configuration in `source`, its stages resolved to all their parameters, and the same as steps.

    Raises ConfigErrors with every problem found, one line each.
    """
    problems = Problems()
    data = source.data
    if not isinstance(data, dict):
        hint = "it is empty" if data is None else f"it is a {'list' if isinstance(data, list) else 'single value'}"
        problems.add(
            Problem(source.name, "", f"must be a mapping with the keys {', '.join(Config.model_fields)} ({hint})")
        )
        problems.raise_all()
    config = validate(Config, data, (), source, problems)
    steps = []
    entries = data.get("stages")
    for index, entry in enumerate(entries if isinstance(entries, list) else ()):
        step = _step(entry, ("stages", index), source, known, problems)
        if step:
            steps.append(step)
    problems.found.sort(key=lambda problem: _line(problem.place))
    problems.raise_all()
    if config is None:  # validate has left a problem, so this is out of reach; said for the type checker
        raise AssertionError("a configuration without problems must exist")
    listed = tuple({step.stage.name: step.params.model_dump(mode="json")} for step in steps)
    return config.model_copy(update={"stages": listed}), tuple(steps)


def resolved(config: Config) -> dict[str, Any]:
    """Everything that a bound configuration means, defaults included, as plain data that `bind` takes again."""
    data: dict[str, Any] = config.model_dump(mode="json", exclude={"lods", "budgets"})
    targets = config.model_dump(mode="json", include={"lods", "budgets"}, exclude_none=True)
    return {name: (data | targets)[name] for name in Config.model_fields}


def _step(entry: Any, path: Path_, source: Source, known: Mapping[str, AnyStage], problems: Problems) -> Step | None:
    params: Any
    if isinstance(entry, str):
        name, params = entry, {}
        here = path
    elif isinstance(entry, dict) and len(entry) == 1:
        name, params = next(iter(entry.items()))
        params = {} if params is None else params
        here = (*path, name)
    else:
        cause = "must be a stage's name, or one name with its parameters: {name: {…}}"
        if isinstance(entry, dict) and len(entry) > 1:
            cause += f" (got {len(entry)} names: {', '.join(map(str, entry))}; is there a '- ' or an indent missing?)"
        problems.add(Problem(source.place(path), show_path(path), cause))
        return None
    if name not in known:
        cause = f"unknown stage '{name}'{did_you_mean(name, known)}"
        problems.add(Problem(source.place(here, key=True), show_path(path), cause))
        return None
    stage = known[name]
    model: type[BaseModel] = stage.params
    checked = validate(model, params, (*path, name), source, problems)
    return Step(stage, checked) if isinstance(checked, Params) else None


def _line(place: str) -> tuple[int, int]:
    """Line and column at the end of a place, for the order of messages; what has none comes first."""
    numbers = [int(part) if part.isdigit() else 0 for part in place.rsplit(":", 2)[1:]]
    return (numbers[0], numbers[1]) if len(numbers) == 2 else (0, 0)
