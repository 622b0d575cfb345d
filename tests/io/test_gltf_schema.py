from __future__ import annotations

import json
from typing import Any

import pytest

import model_files as files
from lodpipe.core.errors import AssetError, LimitError
from lodpipe.io import Limits
from lodpipe.io.gltf_schema import check_shape, node_depth, parse_json


def tree() -> dict[str, Any]:
    built = files.rich()
    return {**built.tree, "buffers": [{"byteLength": len(built.data)}]}


def test_a_valid_file_passes() -> None:
    check_shape(tree())
    assert node_depth(tree()) == 3


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("asset", None, "'asset' is missing"),
        ("asset.version", 2, "asset.version: must be a text (got 2)"),
        ("meshes", {}, "meshes: must be an array, not an object"),
        ("meshes.0.primitives", {"0": 1}, "meshes[0].primitives: must be an array, not an object"),
        ("meshes.0.primitives.0.attributes", None, "meshes[0].primitives[0]: 'attributes' is missing"),
        (
            "meshes.0.primitives.0.attributes.POSITION",
            999,
            "meshes[0].primitives[0].attributes.POSITION: must be a row",
        ),
        ("meshes.0.primitives.0.attributes.POSITION", -1, "must be a row of 'accessors'"),
        ("meshes.0.primitives.0.attributes.POSITION", True, "must be a row of 'accessors'"),
        ("meshes.0.primitives.0.mode", "4", "must be a whole number, 0 or more"),
        ("materials.0.pbrMetallicRoughness.baseColorTexture.index", 9, "must be a row of 'textures', which has 3"),
        ("materials.0.emissiveFactor", [1, 2], "must be an array of 3 numbers"),
        ("materials.0.pbrMetallicRoughness.roughnessFactor", "1", 'roughnessFactor: must be a number (got "1")'),
        ("nodes.0.translation", [1, 2, "x"], "nodes[0].translation: must be an array of 3 numbers"),
        ("nodes.0.extensions", [], "nodes[0].extensions: must be an object of objects"),
        ("nodes.0.name", 7, "nodes[0].name: must be a text"),
        ("scenes.0.nodes", [6], "scenes[0].nodes[0]: must be a row of 'nodes', which has 6"),
        ("scene", 2, "scene: must be a row of 'scenes'"),
        ("accessors.0.count", 0, "accessors[0]: it is empty"),
        ("accessors.0.count", 1.5, "accessors[0].count: must be a whole number"),
        ("bufferViews.0.byteLength", -3, "bufferViews[0].byteLength: must be a whole number"),
        ("buffers.0.byteLength", 0, "buffers[0]: it is empty"),
        ("animations.0.channels.0.target", 1, "must be an object, not a number"),
        ("nodes.3.children", [1, 2], "nodes[2]: it has two parents"),
        ("nodes.5.children", [3], "nodes[3]: it has two parents"),
        ("nodes.1.children", [1], "nodes: the node tree has a cycle"),
    ],
)
def test_each_mistake_has_a_place(path: str, value: Any, message: str) -> None:
    broken = tree()
    *way, last = [int(p) if p.isdigit() else p for p in path.split(".")]
    spot: Any = broken
    for step in way:
        spot = spot[step]
    if value is None:
        del spot[last]
    else:
        spot[last] = value
    with pytest.raises(AssetError) as caught:
        check_shape(broken)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"", "not valid"),
        (b"[1]", "not an object"),
        (b"\xff\xfe", "not UTF-8"),
        (b'{"a": NaN}', "NaN is not JSON"),
        (b'{"a": 1', "not valid"),
        (b'{"a":' * 150 + b"[" * 60 + b"]" * 60 + b"}" * 150, "nested more than 200 deep"),
        (b"[" * 100_000, "nested more than 200 deep|not valid"),
        (b'{"a":' * 100_000 + b"1" + b"}" * 100_000, "nested more than 200 deep"),
    ],
)
def test_what_is_no_json(text: bytes, message: str) -> None:
    with pytest.raises(AssetError, match=message):
        parse_json(text, Limits())


def test_limits_of_json() -> None:
    assert parse_json(b'\xef\xbb\xbf{"a": [1]}', Limits()) == {"a": [1]}
    with pytest.raises(LimitError, match="11 bytes"):
        parse_json(b'{"a": "bc"}', Limits(json_bytes=10))
    deep = json.dumps({"nodes": [{"children": [i + 1]} for i in range(5000)] + [{}]}).encode()
    assert node_depth(parse_json(deep, Limits())) == 5001
