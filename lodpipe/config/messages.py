"""Pydantic's validation errors in the user's words, at the user's lines."""

from __future__ import annotations

import json
import types
import typing
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from lodpipe.config.problems import Problem, Problems, did_you_mean
from lodpipe.config.source import Path_, Source

M = TypeVar("M", bound=BaseModel)

_KINDS = {
    "int": "a whole number",
    "float": "a number",
    "bool": "true or false",
    "string": "text",
    "tuple": "a list",
    "list": "a list",
    "dict": "a mapping (key: value)",
    "model": "a mapping (key: value)",
    "model_attributes": "a mapping (key: value)",
}
_BOUNDS = {
    "greater_than": ("more than", "gt"),
    "greater_than_equal": ("at least", "ge"),
    "less_than": ("less than", "lt"),
    "less_than_equal": ("at most", "le"),
    "multiple_of": ("a multiple of", "multiple_of"),
}


def validate(model: type[M], data: Any, at: Path_, source: Source, problems: Problems) -> M | None:
    """`data`, which stands at the path `at` of `source`, as a `model`; None, and lines in `problems`, if it is not.

    Strict: no text is taken for a number, no number for true or false. Lists stand for tuples, as in JSON.
    """
    try:
        return model.model_validate_json(json.dumps(data), strict=True)
    except ValidationError as error:
        unions: dict[tuple[str, str], list[str]] = {}
        for entry in error.errors(include_url=False):
            place, subject, cause = _problem(model, entry, at, source)
            unions.setdefault((place, subject), []).append(cause)
        for (place, subject), causes in unions.items():
            for cause in _joined(causes):
                problems.add(Problem(place, subject, cause))
    return None


def _joined(causes: list[str]) -> list[str]:
    """The branches of a union ("must be 'auto' (got 'x')", "must be a number (got 'x')") as one sentence."""
    branches = [cause for cause in causes if cause.startswith("must be ") and " (got " in cause]
    if len(branches) < 2:
        return causes
    wants = list(dict.fromkeys(cause.removeprefix("must be ").partition(" (got ")[0] for cause in branches))
    got = branches[0].partition(" (got ")[2]
    return [f"must be {' or '.join(wants)} (got {got}", *(cause for cause in causes if cause not in branches)]


def show_path(path: Path_) -> str:
    """``stages[1].decimate.ratios.1``: the index of a top-level list in brackets, the rest with dots."""
    text = ""
    for depth, part in enumerate(path):
        if isinstance(part, int) and depth == 1:
            text += f"[{part}]"
        else:
            text += f".{part}" if text else str(part)
    return text


def _problem(model: type[BaseModel], entry: Any, at: Path_, source: Source) -> tuple[str, str, str]:
    kind: str = entry["type"]
    path: Path_ = (*at, *_written(entry["loc"], source, at))
    given = entry["input"]
    if kind == "extra_forbidden":
        fields = _fields_at(model, entry["loc"][:-1])
        cause = f"unknown key '{path[-1]}'{did_you_mean(str(path[-1]), fields)}"
        return source.place(path, key=True), show_path(path[:-1]), cause
    if kind == "missing":
        return source.place(path[:-1]), show_path(path[:-1]), f"'{path[-1]}' is missing"
    of_key = entry["loc"][-1:] == ("[key]",)
    return source.place(path, key=of_key), show_path(path), _cause(kind, entry, given)


def _cause(kind: str, entry: Any, given: Any) -> str:
    context = entry.get("ctx", {})
    if kind in _BOUNDS:
        words, key = _BOUNDS[kind]
        return f"must be {words} {_short(context[key])} (got {_short(given)})"
    if kind == "literal_error":
        near = did_you_mean(given, _quoted(context["expected"])) if isinstance(given, str) else ""
        near = near if near.startswith("; did") else ""
        return f"must be {context['expected']} (got {_short(given)}){near}"
    if kind == "value_error":
        return str(context["error"])
    if kind in ("too_short", "too_long"):
        bound = context.get("min_length", context.get("max_length"))
        return f"must have {'at least' if kind == 'too_short' else 'at most'} {bound} (got {context['actual_length']})"
    for word, want in _KINDS.items():
        if kind in (f"{word}_type", f"{word}_parsing", f"{word}_from_float"):
            return f"must be {want} (got {_short(given)})"
    return f"{entry['msg'][:1].lower()}{entry['msg'][1:]} (got {_short(given)})"


def _quoted(expected: str) -> list[str]:
    """The words in pydantic's "'a', 'b' or 'c'"."""
    return expected.split("'")[1::2]


def _short(value: Any) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        value = int(value)
    text = json.dumps(value, default=str, ensure_ascii=False) if not isinstance(value, str) else f"'{value}'"
    return text if len(text) <= 60 else text[:57] + "…"


def _written(loc: tuple[Any, ...], source: Source, at: Path_) -> Path_:
    """`loc` without the parts that pydantic adds for branches of a union: only what stands in the text."""
    path: Path_ = ()
    for index, part in enumerate(loc):
        last = index == len(loc) - 1
        step = part if (*at, *path, part) in source.values or not isinstance(part, int) else str(part)
        if (*at, *path, step) in source.values or (last and not _is_branch(part)):
            path = (*path, step)
    return path


def _is_branch(part: Any) -> bool:
    return isinstance(part, str) and (part in _KINDS or part == "str" or "[" in part)


def _fields_at(model: type[BaseModel], loc: tuple[Any, ...]) -> list[str]:
    """The keys that are known at `loc` below `model`."""
    current: Any = model
    for part in loc:
        candidates = _models(current)
        found = next((m for m in candidates if isinstance(part, str) and part in m.model_fields), None)
        current = found.model_fields[part].annotation if found else current
    return sorted({name for m in _models(current) for name in m.model_fields})


def _models(annotation: Any) -> list[type[BaseModel]]:
    """The models that `annotation` is made of: itself, or inside tuples, mappings, unions and Annotated."""
    if isinstance(annotation, type) and not isinstance(annotation, types.GenericAlias):
        return [annotation] if issubclass(annotation, BaseModel) else []
    return [model for argument in typing.get_args(annotation) for model in _models(argument)]
