"""Why a stage runs again: what is different from the run whose result is published."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

from lodpipe.service.recipe import Recipe

SHOWN = 40
"""Longest value that is written out."""


def reasons(old: Mapping[str, Any] | None, inputs: Iterable[Mapping[str, Any]], recipe: Recipe) -> list[str]:
    """For each stage of `recipe`, in words; '' where nothing was published before. `old` is that manifest."""
    chain = [(next(iter(entry)), next(iter(entry.values()))) for entry in recipe.config["stages"]]
    if old is None:
        return [""] * len(chain)
    try:
        return _compare(old, list(inputs), recipe, chain)
    except (KeyError, TypeError, AttributeError, StopIteration):  # of another version
        return ["the last result is of another version"] * len(chain)


def _compare(
    old: Mapping[str, Any], inputs: list[Mapping[str, Any]], recipe: Recipe, chain: list[tuple[str, dict[str, Any]]]
) -> list[str]:
    before = [(next(iter(entry)), next(iter(entry.values()))) for entry in old["config"]["stages"]]
    known = {entry["path"]: entry["sha256"] for entry in old["inputs"]}
    now = {entry["path"]: entry["sha256"] for entry in inputs}
    changed = sorted(path for path in known.keys() | now.keys() if known.get(path) != now.get(path))
    cause = f"changed: {', '.join(changed)}" if changed else ""
    general = [f"{name} changed" for name in ("lods", "seed") if old["config"].get(name) != recipe.config.get(name)]
    found = []
    for index, (name, params) in enumerate(chain):
        own = ""
        if index >= len(before) or before[index][0] != name:
            own = "new at this place in the chain"
        elif old["stages"][index] != recipe.stages[index]:
            was, new = old["stages"][index].get("version"), recipe.stages[index].get("version")
            own = f"version {was} → {new}" if was != new else "the plug-in was edited"
        elif before[index][1] != params:
            own = ", ".join(_differences(before[index][1], params))
        found.append(cause or own or ", ".join(general) or "no result of it was kept")
        if not cause and own:
            cause = f"after {name}"
    return found


def _differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    return [
        f"{name}: {_short(old.get(name))} → {_short(new.get(name))}"
        for name in sorted(old.keys() | new.keys())
        if old.get(name) != new.get(name)
    ]


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 1]}…"
