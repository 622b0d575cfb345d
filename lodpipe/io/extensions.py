"""What becomes of each glTF extension: decoded, carried as it is, left out with a warning, or refused."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from lodpipe.core.errors import AssetError
from lodpipe.io.clean import Warn
from lodpipe.io.gltf_schema import Json

#: Ways to store arrays: undone on reading, so that they are no longer true of what is written.
DECODED = frozenset(
    {
        "KHR_draco_mesh_compression",
        "EXT_meshopt_compression",
        "KHR_meshopt_compression",
        "KHR_mesh_quantization",
    }
)
#: Known to hold no array, or only arrays that the reader follows; their JSON is kept as it is.
CARRIED = frozenset(
    {
        "KHR_lights_punctual",
        "KHR_texture_transform",
        "KHR_texture_basisu",
        "KHR_animation_pointer",
        "KHR_node_visibility",
        "KHR_node_hoverability",
        "KHR_node_selectability",
        "KHR_xmp_json_ld",
        "EXT_lights_image_based",
        "EXT_mesh_features",
        "EXT_mesh_gpu_instancing",
        "EXT_texture_avif",
        "EXT_texture_webp",
        "MSFT_lod",
        "MSFT_texture_dds",
    }
)
_CARRIED_FAMILIES = ("KHR_materials_", "MSFT_packing_", "VRMC_")
#: Keys under which an extension names an array by its number, which is another one after writing.
_ARRAY_KEYS = frozenset(
    {"accessor", "accessors", "bufferView", "bufferViews", "buffer", "indices", "arrayOffsets", "stringOffsets"}
)
#: Extensions that name arrays under other keys.
_WITH_ARRAYS = frozenset({"EXT_structural_metadata", "EXT_feature_metadata"})
#: Left out together with the one they point into.
_TOGETHER = {"EXT_structural_metadata": "EXT_mesh_features", "EXT_feature_metadata": "EXT_mesh_features"}
#: Levels of the file at which an unknown extension may change how arrays are to be read.
_ARRAY_LEVELS = ("accessors", "bufferViews", "buffers", "meshes")


def is_known(name: str) -> bool:
    """Whether the reader knows what to do with the extension."""
    return name in DECODED or name in CARRIED or name.startswith(_CARRIED_FAMILIES)


def settle(tree: Json, warn: Warn) -> None:
    """Take out of `tree` the extensions that cannot be carried, with a warning, and bring its two lists in order.

    Raises AssetError for a required extension that is unknown and may change how arrays are read.
    """
    required = list(tree.get("extensionsRequired", ()))
    found = list(_extensions(tree))
    levels: dict[str, set[str]] = {}
    for level, name, _ in found:
        levels.setdefault(name, set()).add(level)
    for name in required:
        seen = levels.get(name, set())
        if not is_known(name) and (not seen or seen & set(_ARRAY_LEVELS)):
            raise AssetError(
                f"it requires the extension {name}, which is not supported", advice="export the model without it"
            )
    lost = {name for _, name, said in found if name in _WITH_ARRAYS or (not _followed(name) and _names_arrays(said))}
    lost |= {
        name for _, name, _ in found if not _followed(name) and levels[name] & {"accessors", "bufferViews", "buffers"}
    }
    lost |= {other for name, other in _TOGETHER.items() if name in lost and other in levels}
    for name in sorted(lost):
        if name in required:
            raise AssetError(
                f"it requires the extension {name}, whose data cannot be carried along",
                advice="export the model without it",
            )
        warn(f"extension {name} left out: it points at data that changes when the model is simplified")
    for name in sorted(set(levels) - lost):
        if not is_known(name):
            warn(f"extension {name} is not known; carried along as it is")
    _remove(tree, lost)
    for key in ("extensionsUsed", "extensionsRequired"):
        kept = [name for name in dict.fromkeys(tree.get(key, ())) if name not in lost and name not in DECODED]
        tree.pop(key, None)
        if kept:
            tree[key] = kept


def used_extensions(tree: Any) -> set[str]:
    """The names of all extensions that `tree` holds."""
    found: set[str] = set()
    stack = [tree]
    while stack:
        item = stack.pop()
        if isinstance(item, dict):
            if isinstance(item.get("extensions"), dict):
                found |= set(item["extensions"])
            stack += [value for key, value in item.items() if key != "extras"]
        elif isinstance(item, list | tuple):
            stack += item
    return found


def _followed(name: str) -> bool:
    return name in DECODED or name in CARRIED or name.startswith(_CARRIED_FAMILIES)


def _extensions(tree: Json) -> Iterator[tuple[str, str, Any]]:
    """(top-level key, name, content) of each extension object."""
    stack: list[tuple[str, Any]] = [(key, value) for key, value in tree.items() if key not in ("extensions", "extras")]
    stack.append(("", {"extensions": tree.get("extensions", {})}))
    while stack:
        level, item = stack.pop()
        if isinstance(item, dict):
            for key, value in item.items():
                if key == "extensions" and isinstance(value, dict):
                    for name, said in value.items():
                        yield level, name, said
                        stack.append((level, said))
                elif key != "extras":
                    stack.append((level, value))
        elif isinstance(item, list):
            stack += [(level, value) for value in item]


def _names_arrays(said: Any) -> bool:
    stack = [said]
    while stack:
        item = stack.pop()
        if isinstance(item, dict):
            if _ARRAY_KEYS & set(item):
                return True
            stack += item.values()
        elif isinstance(item, list):
            stack += item
    return False


def _remove(tree: Any, names: set[str]) -> None:
    if not names:
        return
    stack = [tree]
    while stack:
        item = stack.pop()
        if isinstance(item, dict):
            extensions = item.get("extensions")
            if isinstance(extensions, dict):
                for name in names & set(extensions):
                    del extensions[name]
                if not extensions:
                    del item["extensions"]
            stack += item.values()
        elif isinstance(item, list):
            stack += item
