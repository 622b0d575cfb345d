"""glTF 2.0 and GLB, written with the whole document; several levels in one file through MSFT_lod."""

from __future__ import annotations

import copy
import json
import struct
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any
from urllib.parse import quote

from lodpipe.core.asset import Asset
from lodpipe.core.errors import InvalidMesh, OutputError
from lodpipe.core.mesh import Mesh
from lodpipe.io.clean import Warn
from lodpipe.io.extensions import is_known, used_extensions
from lodpipe.io.gltf_read import INSTANCING
from lodpipe.io.pack import INDICES, VERTICES, Packer
from lodpipe.io.placing import Placing, is_bound, place_meshes
from lodpipe.io.primitives import far_offset, primitives
from lodpipe.io.textures import embed_images, link_images, portable, settle_textures

Json = dict[str, Any]
_MAX_GLB = (1 << 32) - 1


Files = list[tuple[str, bytes]]  # name and content of each file, the model itself first


def gltf_files(
    asset: Asset, path: Path, levels: Sequence[Sequence[Mesh]], coverages: Sequence[float], warn: Warn
) -> Files:
    """The files of a .glb or .gltf at `path`: the first level in the scene, others, if any, through MSFT_lod."""
    return _Writer(asset, path, warn).files(levels, coverages)


class _Writer:
    def __init__(self, asset: Asset, path: Path, warn: Warn) -> None:
        self.asset = asset
        self.path = path
        self.binary = path.suffix.lower() == ".glb"
        self.warn = warn
        self.pack = Packer()
        self.tree: Json = copy.deepcopy(dict(asset.document))
        self.bound: set[int] = set()

    def files(self, levels: Sequence[Sequence[Mesh]], coverages: Sequence[float]) -> Files:
        for level in levels:
            if len(level) != len(self.asset.meshes):
                raise InvalidMesh(f"{len(level)} meshes are given for an asset of {len(self.asset.meshes)}")
        tree = self.tree
        tree.setdefault("nodes", [{"mesh": i} for i in range(len(self.asset.meshes))])
        tree.setdefault("scenes", [{"nodes": list(range(len(tree["nodes"])))}])
        self.bound = {node["mesh"] for node in tree["nodes"] if "mesh" in node and is_bound(node)}
        placing = Placing(rows=[[] for _ in self.asset.meshes])
        written: list[Json] = []
        for number, level in enumerate(levels):
            for i, mesh in enumerate(level):
                earlier = next((k for k in range(number) if levels[k][i] is mesh), None)
                if earlier is not None:
                    placing.rows[i].append(placing.rows[i][earlier])
                else:
                    self._mesh(i, mesh, number, written, placing)
        self._carried()
        place_meshes(tree, placing, coverages, self.warn)
        tree["meshes"] = written
        tree["materials"] = [copy.deepcopy(dict(m.gltf)) for m in self.asset.materials]
        images = settle_textures(tree, portable(self.asset.images, self.warn), [tree["materials"], tree["meshes"]])
        bin_name = f"{self.path.stem}.bin"
        beside: Files = []
        if self.binary:
            embed_images(tree, images, self.pack)
        else:
            beside = link_images(tree, images, (self.path.name, bin_name))
        data = self.pack.data
        buffer = {"byteLength": len(data)} if self.binary else {"uri": quote(bin_name), "byteLength": len(data)}
        finished = self._finish(buffer)
        if self.binary:
            return [(self.path.name, _glb(finished, data))]
        return [(self.path.name, _dump(finished, indent=1)), (bin_name, data), *beside]

    def _mesh(self, row: int, mesh: Mesh, level: int, written: list[Json], placing: Placing) -> None:
        """Write one mesh of one level; a mesh that has lost all its faces has no row."""
        known = self.tree.get("meshes", ())
        rest: Json = copy.deepcopy(known[row]) if row < len(known) else {}
        place = f"mesh {row}" + (f" ({mesh.name})" if mesh.name else "")
        offset = None if row in self.bound else far_offset(mesh, place)
        said = primitives(mesh, self.pack, offset, place, self.warn)
        lines = [self._line(p) for p in rest.pop("primitives", ())] if level == 0 or not said else []
        if offset is not None:
            self.warn(f"{place} lies far from the origin; its node carries the offset, so that no detail is lost")
            placing.offsets[len(written)] = offset
        if not said and not lines:
            placing.rows[row].append(None)
            return
        if not any("targets" in p for p in said + lines):
            rest.pop("weights", None)
        rest.pop("name", None)
        name = {"name": f"{mesh.name}_LOD{level}" if level else mesh.name} if mesh.name else {}
        placing.rows[row].append(len(written))
        written.append({**name, **rest, "primitives": said + lines})

    def _line(self, said: Json) -> Json:
        """A primitive of points or lines, whose arrays were carried along."""
        said["attributes"] = {
            n: self._array(r, target=VERTICES, bounds=n == "POSITION") for n, r in said["attributes"].items()
        }
        if "indices" in said:
            said["indices"] = self._array(said["indices"], target=INDICES)
        if "targets" in said:
            said["targets"] = [
                {n: self._array(r, target=VERTICES, bounds=n == "POSITION") for n, r in t.items()}
                for t in said["targets"]
            ]
        return said

    def _array(self, row: int, *, target: int | None = None, bounds: bool = False) -> int:
        a = self.asset.accessors[row]
        return self.pack.accessor(a.values, a.type, normalized=a.normalized, target=target, bounds=bounds, rest=a.gltf)

    def _carried(self) -> None:
        """Arrays of skins, animations and instances."""
        for skin in self.tree.get("skins", ()):
            if "inverseBindMatrices" in skin:
                skin["inverseBindMatrices"] = self._array(skin["inverseBindMatrices"])
        for animation in self.tree.get("animations", ()):
            for sampler in animation["samplers"]:
                sampler["input"] = self._array(sampler["input"], bounds=True)
                sampler["output"] = self._array(sampler["output"])
        for node in self.tree["nodes"]:
            instances = node.get("extensions", {}).get(INSTANCING, {}).get("attributes", {})
            for name in instances:
                instances[name] = self._array(instances[name])

    def _finish(self, buffer: Json) -> Json:
        """The tree with accessors, buffer and lists of extensions, and without empty arrays."""
        tree, pack = self.tree, self.pack
        tree["asset"] = {**tree.get("asset", {}), "version": "2.0", "generator": f"lodpipe {_own_version()}"}
        tree["accessors"], tree["bufferViews"], tree["buffers"] = pack.accessors, pack.views, [buffer]
        used = used_extensions(tree)
        required = tree.get("extensionsRequired", ())
        listed = dict.fromkeys([*tree.get("extensionsUsed", ()), *required, *sorted(used)])
        tree["extensionsUsed"] = [name for name in listed if name in used or not is_known(name)]
        tree["extensionsRequired"] = [name for name in required if name in tree["extensionsUsed"]]
        first = ("asset", "extensionsUsed", "extensionsRequired", "scene", "scenes", "nodes", "meshes")
        return {key: tree[key] for key in dict.fromkeys([*first, *tree]) if tree.get(key) not in (None, [], {})}


def _own_version() -> str:
    try:
        return version("lodpipe")
    except PackageNotFoundError:  # run from a source tree that is not installed
        return "(not installed)"


def _glb(tree: Json, data: bytes) -> bytes:
    text = _dump(tree)
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + len(data)
    if total > _MAX_GLB:
        raise OutputError(f"{total:,} bytes are more than a GLB can hold", advice="write gltf instead")
    head = struct.pack("<4sIIII", b"glTF", 2, total, len(text), 0x4E4F534A)
    return b"".join([head, text, struct.pack("<II", len(data), 0x004E4942), data])


def _dump(tree: Json, indent: int | None = None) -> bytes:
    spacing = (",", ":") if indent is None else (",", ": ")
    return json.dumps(tree, ensure_ascii=False, allow_nan=False, indent=indent, separators=spacing).encode()
