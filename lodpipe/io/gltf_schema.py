"""The shape of glTF 2.0's JSON, as far as a reader must rely on it, and the check against it."""

from __future__ import annotations

import json
import math
from typing import Any

from lodpipe.core.errors import AssetError, LimitError
from lodpipe.io.limits import Limits

Json = dict[str, Any]

_TEXTURE = {
    "index!": "->textures",
    "texCoord": int,
    "scale": float,
    "strength": float,
    "extensions": {
        "KHR_texture_transform": {"offset": (float, 2), "scale": (float, 2), "rotation": float, "texCoord": int}
    },
}
#: A dict is an object: `!` marks what must be there, `*` is any other key. A list is an array of its one item.
#: `->x` is a row of the top-level array x. (float, n) is an array of n numbers.
SHAPE: Json = {
    "asset!": {"version!": str},
    "extensionsUsed": [str],
    "extensionsRequired": [str],
    "scene": "->scenes",
    "scenes": [{"nodes": ["->nodes"], "name": str}],
    "nodes": [
        {
            "mesh": "->meshes",
            "skin": "->skins",
            "camera": "->cameras",
            "children": ["->nodes"],
            "matrix": (float, 16),
            "translation": (float, 3),
            "rotation": (float, 4),
            "scale": (float, 3),
            "weights": [float],
            "name": str,
        }
    ],
    "meshes": [
        {
            "primitives!": [
                {
                    "attributes!": {"*": "->accessors"},
                    "indices": "->accessors",
                    "material": "->materials",
                    "mode": int,
                    "targets": [{"*": "->accessors"}],
                }
            ],
            "weights": [float],
            "name": str,
        }
    ],
    "materials": [
        {
            "name": str,
            "pbrMetallicRoughness": {
                "baseColorFactor": (float, 4),
                "metallicFactor": float,
                "roughnessFactor": float,
                "baseColorTexture": _TEXTURE,
                "metallicRoughnessTexture": _TEXTURE,
            },
            "normalTexture": _TEXTURE,
            "occlusionTexture": _TEXTURE,
            "emissiveTexture": _TEXTURE,
            "emissiveFactor": (float, 3),
            "alphaMode": str,
            "alphaCutoff": float,
            "doubleSided": bool,
        }
    ],
    "textures": [{"source": "->images", "sampler": "->samplers", "name": str}],
    "images": [{"uri": str, "bufferView": "->bufferViews", "mimeType": str, "name": str}],
    "samplers": [{"wrapS": int, "wrapT": int, "magFilter": int, "minFilter": int}],
    "accessors": [
        {
            "bufferView": "->bufferViews",
            "byteOffset": int,
            "componentType!": int,
            "normalized": bool,
            "count!": int,
            "type!": str,
            "sparse": {
                "count!": int,
                "indices!": {"bufferView!": "->bufferViews", "byteOffset": int, "componentType!": int},
                "values!": {"bufferView!": "->bufferViews", "byteOffset": int},
            },
            "name": str,
        }
    ],
    "bufferViews": [{"buffer!": "->buffers", "byteOffset": int, "byteLength!": int, "byteStride": int}],
    "buffers": [{"uri": str, "byteLength!": int}],
    "skins": [{"joints!": ["->nodes"], "skeleton": "->nodes", "inverseBindMatrices": "->accessors"}],
    "cameras": [{"type!": str}],
    "animations": [
        {
            "channels!": [{"sampler!": int, "target!": {"node": "->nodes", "path!": str}}],
            "samplers!": [{"input!": "->accessors", "output!": "->accessors", "interpolation": str}],
        }
    ],
}
_NAMES = {int: "a whole number, 0 or more", float: "a number", str: "a text", bool: "true or false"}


def parse_json(text: bytes, limits: Limits) -> Json:
    """The JSON object in `text`. Raises AssetError for what is none, LimitError for one that is too large or deep."""
    if len(text) > limits.json_bytes:
        raise LimitError(f"its JSON has {len(text):,} bytes, more than the limit of {limits.json_bytes:,}")
    too_deep = AssetError(
        f"its JSON is nested more than {limits.json_depth} deep", advice="the file is damaged: copy or export it again"
    )
    try:
        tree = json.loads(text.decode("utf-8-sig"), parse_constant=_refuse)
    except UnicodeDecodeError as error:
        raise AssetError("its JSON is not UTF-8 text", advice="the file is damaged: copy or export it again") from error
    except RecursionError as error:
        raise too_deep from error
    except ValueError as error:
        raise AssetError(
            f"its JSON is not valid ({error})", advice="the file is damaged: copy or export it again"
        ) from error
    if not isinstance(tree, dict):
        raise AssetError("its JSON is not an object", advice="check that the file is a glTF")
    level: list[Any] = [tree]
    for _ in range(limits.json_depth + 1):
        level = [
            child
            for item in level
            for child in (item.values() if isinstance(item, dict) else item)
            if isinstance(child, dict | list)
        ]
        if not level:
            return tree
    raise too_deep


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is not JSON")


def check_shape(tree: Json) -> None:
    """Raise AssetError, with the place, where `tree` is not as SHAPE says or names a row that is not there."""
    for key, shape in SHAPE.items():
        if isinstance(shape, list) and not isinstance(tree.get(key, []), list):
            raise AssetError(f"must be an array, not {_kind(tree[key])}", place=key)
    for key, shape in SHAPE.items():
        name = key.removesuffix("!")
        if name in tree:
            _check(tree[name], shape, name, tree)
        elif name != key:
            raise AssetError(f"'{name}' is missing", advice="check that the file is a glTF 2.0")
    for name in ("accessors", "bufferViews", "buffers"):
        for i, item in enumerate(tree.get(name, ())):
            if item.get("count", 1) < 1 or item.get("byteLength", 1) < 1:
                raise AssetError("it is empty", place=f"{name}[{i}]")
    _check_nodes(tree)


def _check(value: Any, shape: Any, place: str, tree: Json) -> None:
    if isinstance(shape, dict):
        if not isinstance(value, dict):
            raise AssetError(f"must be an object, not {_kind(value)}", place=place)
        extensions = value.get("extensions", {})
        if not isinstance(extensions, dict) or not all(isinstance(e, dict) for e in extensions.values()):
            raise AssetError("must be an object of objects", place=f"{place}.extensions")
        for key, part in shape.items():
            name = key.removesuffix("!")
            if name == "*":
                for other, item in value.items():
                    _check(item, part, f"{place}.{other}", tree)
            elif name in value:
                _check(value[name], part, f"{place}.{name}", tree)
            elif name != key:
                raise AssetError(f"'{name}' is missing", place=place)
    elif isinstance(shape, list):
        if not isinstance(value, list):
            raise AssetError(f"must be an array, not {_kind(value)}", place=place)
        for i, item in enumerate(value):
            _check(item, shape[0], f"{place}[{i}]", tree)
    elif isinstance(shape, tuple):
        if not isinstance(value, list) or len(value) != shape[1] or not all(_is_number(v) for v in value):
            raise AssetError(f"must be an array of {shape[1]} numbers", place=place)
    elif isinstance(shape, str):
        count = len(tree.get(shape[2:], ()))
        if not _is_index(value) or value >= count:
            raise AssetError(f"must be a row of '{shape[2:]}', which has {count} (got {_shown(value)})", place=place)
    elif not (_is_index(value) if shape is int else _is_number(value) if shape is float else isinstance(value, shape)):
        raise AssetError(f"must be {_NAMES[shape]} (got {_shown(value)})", place=place)


def _shown(value: Any) -> str:
    return json.dumps(value)[:40]


def _check_nodes(tree: Json) -> None:
    """No node has two parents or is its own ancestor."""
    nodes = tree.get("nodes", ())
    parents = [0] * len(nodes)
    for i, node in enumerate(nodes):
        for child in node.get("children", ()):
            parents[child] += 1
            if parents[child] > 1:
                raise AssetError(f"it has two parents, nodes[{i}] is the second", place=f"nodes[{child}]")
    level = [i for i, count in enumerate(parents) if count == 0]
    seen = len(level)
    while level:
        level = [child for i in level for child in nodes[i].get("children", ())]
        seen += len(level)
    if seen < len(nodes):
        raise AssetError(
            "the node tree has a cycle", place="nodes", advice="the file is damaged: copy or export it again"
        )


def node_depth(tree: Json) -> int:
    """How many nodes lie below one another at most."""
    nodes = tree.get("nodes", ())
    children = {c for node in nodes for c in node.get("children", ())}
    level, depth = [i for i in range(len(nodes)) if i not in children], 0
    while level:
        level, depth = [c for i in level for c in nodes[i].get("children", ())], depth + 1
    return depth


def _is_index(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _kind(value: Any) -> str:
    names = {dict: "an object", list: "an array", str: "a text", bool: "true or false", type(None): "null"}
    return names.get(type(value), "a number")
