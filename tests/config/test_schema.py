"""The JSON Schema for editors: fresh, valid, and of one mind with the program about presets and mistakes."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pytest
import yaml

from lodpipe.config import presets
from lodpipe.config.load import bind
from lodpipe.config.schema import json_schema, schema_text
from lodpipe.config.source import Source
from lodpipe.core.errors import ConfigError
from lodpipe.stages import BUILTIN

REPO = Path(__file__).parents[2]
SCHEMA = json_schema(BUILTIN)


def stages_of(steps):
    return [step.stage.name for step in steps]


def stages_named(data):
    return [entry if isinstance(entry, str) else next(iter(entry)) for entry in data["stages"]]


def test_the_committed_schema_is_fresh():
    committed = (REPO / "config" / "chain.schema.json").read_text(encoding="utf-8")
    assert committed == schema_text(BUILTIN), "stale; run: lodpipe schema > config/chain.schema.json"


def test_it_is_a_schema_of_its_draft():
    assert SCHEMA["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    jsonschema.Draft202012Validator.check_schema(SCHEMA)


@pytest.mark.parametrize("name", presets.names())
def test_presets_are_valid_and_load(name):
    text = (presets.FOLDER / f"{name}.yaml").read_text(encoding="utf-8")
    data = yaml.safe_load(text)
    jsonschema.validate(data, SCHEMA)
    _, steps = bind(presets.find(name), BUILTIN)
    assert stages_of(steps) == stages_named(data)


@pytest.mark.parametrize(
    "data",
    [
        {},
        {"stages": []},
        {"stages": ["exprt"]},
        {"stages": [{"export": {"format": ["glb"]}}]},
        {"stages": [{"export": {"formats": ["fbx"]}}]},
        {"stages": [{"export": {}, "report": {}}]},
        {"stages": [{"report": {"samples": 1}}]},
        {"stages": ["export"], "lods": [{"ratio": 2}]},
        {"stages": ["export"], "lods": [{"ratio": 0.5, "error": 1}]},
        {"stages": ["export"], "lods": [{}]},
        {"stages": ["export"], "lods": [{"pixels": 1}]},
        {"stages": ["export"], "version": 2},
        {"stages": ["export"], "limit": {}},
        {"stages": ["export"], "budgets": {"levels": {"1": {"size": 1}}}},
    ],
)
def test_what_the_program_refuses_the_schema_refuses(data):
    with pytest.raises(ConfigError):
        bind(Source("x", json.loads(json.dumps(data))), BUILTIN)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(data, SCHEMA)


@pytest.mark.parametrize(
    "data",
    [
        {"stages": ["export"]},
        {"stages": [{"export": None}]},
        {"stages": [{"export": {"formats": ["glb", "obj"], "combined": True}}, "report"], "seed": 1, "threads": 2},
        {"stages": ["export"], "lods": [{"ratio": 0.5}, {"triangles": 10}, {"error": 1}], "version": 1},
        {"stages": ["export"], "limits": {"minutes": 1}, "budgets": {"levels": {"1": {"bytes": 1}}, "bytes": 4}},
    ],
)
def test_what_the_program_takes_the_schema_takes(data):
    jsonschema.validate(data, SCHEMA)
    _, steps = bind(Source("x", data), BUILTIN)
    assert stages_of(steps) == stages_named(data)


def test_parameters_have_descriptions():
    params = SCHEMA["$defs"]["stage_export"]["anyOf"][0]
    assert all(entry["description"] for entry in params["properties"].values())
