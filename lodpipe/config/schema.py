"""The JSON Schema (draft 2020-12) of configurations, for editors."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from lodpipe.config.model import Config
from lodpipe.stage import AnyStage


def json_schema(known: Mapping[str, AnyStage]) -> dict[str, Any]:
    """The schema of configurations whose stages are `known`."""
    schema = Config.model_json_schema()
    definitions = schema.setdefault("$defs", {})
    choices: list[dict[str, Any]] = [{"enum": sorted(known), "description": "a stage with its defaults"}]
    for name, stage in sorted(known.items()):
        params = stage.params.model_json_schema(ref_template="#/$defs/{model}")
        definitions.update(params.pop("$defs", {}))
        params["description"] = stage.summary
        definitions[f"stage_{name}"] = {"anyOf": [params, {"type": "null"}]}
        choices.append(
            {
                "type": "object",
                "properties": {name: {"$ref": f"#/$defs/stage_{name}"}},
                "required": [name],
                "additionalProperties": False,
            }
        )
    schema["properties"]["stages"]["items"] = {"anyOf": choices}
    level = definitions["Level"]
    alone = [{"required": [name], "maxProperties": 1} for name in ("ratio", "triangles", "error")]
    level["oneOf"] = [*alone, {"required": ["pixels", "screen"], "maxProperties": 2}]
    schema["title"] = "lodpipe configuration"
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def schema_text(known: Mapping[str, AnyStage]) -> str:
    """The schema as the text of a file."""
    return json.dumps(json_schema(known), indent=2) + "\n"
