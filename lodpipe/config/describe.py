"""A stage and its parameters as data, for people who write chains."""

from __future__ import annotations

import inspect
import json
from typing import Any

from pydantic.fields import FieldInfo

from lodpipe.stage import AnyStage


def describe_stage(stage: AnyStage) -> dict[str, Any]:
    """A stage as data: name, origin, version, summary, doc, and its params with type, default and doc."""
    schema = stage.params.model_json_schema()
    params = [
        {
            "name": name,
            "type": _type(schema["properties"][name], schema.get("$defs", {})),
            "default": _default(field, schema["properties"][name]),
            "doc": " ".join((field.description or "").split()),
        }
        for name, field in stage.params.model_fields.items()
    ]
    doc = inspect.cleandoc(stage.function.__doc__ or "")
    return {
        "name": stage.name,
        "origin": stage.origin,
        "version": stage.version,
        "summary": stage.summary,
        "doc": doc,
        "params": params,
    }


def _default(field: FieldInfo, schema: dict[str, Any]) -> str:
    return "(required)" if field.is_required() else json.dumps(schema.get("default"))


_BOUNDS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<", "minItems": "at least"}


def _type(schema: dict[str, Any], definitions: dict[str, Any]) -> str:
    """A JSON Schema in a few words: ``number ≥ 0``, ``full or half``, ``list of text``."""
    if "$ref" in schema:
        return _type(definitions[schema["$ref"].rpartition("/")[2]], definitions)
    if "anyOf" in schema:
        return " or ".join(_type(part, definitions) for part in schema["anyOf"])
    if "enum" in schema or "const" in schema:
        return " or ".join(map(str, schema.get("enum", [schema.get("const")])))
    kind = str(schema.get("type", "anything"))
    words = {"null": "nothing", "string": "text", "boolean": "true or false", "array": "list", "object": "mapping"}
    text = {"integer": "whole number"}.get(kind, words.get(kind, kind))
    if kind == "array" and isinstance(schema.get("items"), dict):
        text += f" of {_type(schema['items'], definitions)}"
    return " ".join([text, *(f"{sign} {schema[key]:g}" for key, sign in _BOUNDS.items() if key in schema)])
