"""glTF 2.0 and GLB, read with the whole document kept."""

from __future__ import annotations

import dataclasses
import re
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.asset import Accessor, Asset
from lodpipe.core.errors import AssetError, LimitError
from lodpipe.core.material import Image, Material
from lodpipe.core.mesh import Mesh
from lodpipe.io import draco
from lodpipe.io.accessors import Buffers, as_floats, data_uri
from lodpipe.io.build import Part, build_mesh
from lodpipe.io.clean import Warn
from lodpipe.io.extensions import DECODED, settle
from lodpipe.io.gltf_schema import Json, check_shape, node_depth, parse_json
from lodpipe.io.images import find_image, read_image
from lodpipe.io.paths import Folder, stem
from lodpipe.io.skins import valid_skin

TRIANGLES, STRIP, FAN = 4, 5, 6
FLOAT = 5126
#: Vertex attributes that KHR_mesh_quantization allows as integers.
_QUANTISABLE = ("POSITION", "NORMAL", "TANGENT", "TEXCOORD_")
#: Components of the attributes that have a meaning, those of morph targets too.
_WIDTHS = {"POSITION": (3,), "NORMAL": (3,), "TANGENT": (4,), "TEXCOORD": (2,), "COLOR": (3, 4)}
INSTANCING = "EXT_mesh_gpu_instancing"
_LARGEST = 1e60  # times positions of up to 1e38, squared: still a float64
_GLB_MAGIC, _JSON, _BIN = b"glTF", 0x4E4F534A, 0x004E4942
#: What of the file's JSON is not kept in `Asset.document`, as meshes, materials and accessors hold it.
_ARRAYS = ("accessors", "bufferViews", "buffers", "materials")


def read_gltf(folder: Folder, warn: Warn) -> Asset:
    """A .glb, or a .gltf with the files beside it; which of the two is told by the content."""
    data = folder.read_asset()
    if not data:
        raise AssetError("the file is empty")
    binary = data.startswith(_GLB_MAGIC)
    text, chunk = _chunks(data, warn) if binary else (data, None)
    tree = parse_json(text, folder.limits)
    version = tree.get("asset", {}).get("version", "2.0") if isinstance(tree.get("asset"), dict) else "2.0"
    if not str(version).startswith("2."):
        raise AssetError(f"glTF {str(version)[:10]} is not supported", advice="convert it to glTF 2.0")
    check_shape(tree)
    if (depth := node_depth(tree)) > folder.limits.node_depth:
        raise LimitError(f"nodes lie {depth:,} deep, more than the limit of {folder.limits.node_depth:,}")
    settle(tree, warn)
    reader = _Reader(tree, Buffers(tree, folder, chunk), folder, warn)
    reader.check_counts()
    meshes = tuple(reader.mesh(i) for i in range(len(tree.get("meshes", ()))))
    images = tuple(reader.image(i) for i in range(len(tree.get("images", ()))))
    asset = Asset(
        name=stem(folder.path),
        meshes=meshes,
        materials=tuple(Material(m) for m in tree.get("materials", ())),
        images=images,
        document=reader.document(),
        accessors=tuple(reader.carried),
        format="glb" if binary else "gltf",
    )
    _check_placements(asset)
    return asset


def _check_placements(asset: Asset) -> None:
    """Raise AssetError where nodes place a mesh so far away, or so large, that lengths could not be computed."""
    with np.errstate(over="ignore", invalid="ignore"):
        for index, matrix in asset.instances():
            if not np.abs(matrix).max() < _LARGEST:  # NaN, too
                advice = "the transforms of its nodes multiply up; check them in a 3-D program"
                raise AssetError(f"it is placed beyond {_LARGEST:g} units", place=f"meshes[{index}]", advice=advice)


def _fits(name: str, width: int) -> bool:
    """Whether an attribute may have `width` components. A morph target's tangents have three."""
    morph = re.match(r"MORPH_\d+_", name)
    kind = name[morph.end() if morph else 0 :].partition("_")[0]
    return width in ((3,) if morph and kind == "TANGENT" else _WIDTHS.get(kind, (width,)))


def _chunks(data: bytes, warn: Warn) -> tuple[bytes, memoryview | None]:
    """The JSON and the binary chunk of a GLB."""
    if len(data) < 20:
        raise AssetError("it is cut off in its header")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise AssetError(f"GLB version {version} is not supported", advice="convert it to glTF 2.0")
    if length != len(data):
        warn(f"its header says {length:,} bytes, the file has {len(data):,}")
    data = data[:length] if length >= 20 else data
    chunks: dict[int, memoryview] = {}
    at = 12
    while at + 8 <= len(data):
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > len(data):
            raise AssetError(
                f"a chunk of {size:,} bytes begins at byte {at:,} of {len(data):,}",
                advice="the file is cut off: copy or export it again",
            )
        chunks.setdefault(kind, memoryview(data)[at + 8 : at + 8 + size])
        at += 8 + size + (-size % 4)
    if _JSON not in chunks:
        raise AssetError("it has no JSON chunk", advice="the file is damaged: copy or export it again")
    return bytes(chunks[_JSON]), chunks.get(_BIN)


class _Reader:
    """One file while it is read; `carried` collects the accessors that no mesh holds."""

    def __init__(self, tree: Json, buffers: Buffers, folder: Folder, warn: Warn) -> None:
        self.tree = tree
        self.buffers = buffers
        self.folder = folder
        self.warn = warn
        self.carried: list[Accessor] = []
        self._carried_rows: dict[tuple[int, bool], int] = {}
        self._skin_joints: dict[int, int] = {}
        for node in tree.get("nodes", ()):
            if "mesh" in node and "skin" in node:
                joints = len(tree["skins"][node["skin"]]["joints"])
                self._skin_joints[node["mesh"]] = min(joints, self._skin_joints.get(node["mesh"], joints))

    def check_counts(self) -> None:
        """Raise LimitError, before any array is read, if the file says that it has too many triangles."""
        total = 0
        for mesh in self.tree.get("meshes", ()):
            for said in mesh["primitives"]:
                row = said.get("indices", said["attributes"].get("POSITION"))
                mode = said.get("mode", TRIANGLES)
                if row is not None and mode >= TRIANGLES:
                    count = self._declared(row)
                    total += count // 3 if mode == TRIANGLES else count
        self.folder.limits.check_triangles(total)

    def _declared(self, row: int) -> int:
        """The count of an accessor, which has at least a byte for each element."""
        said = self.tree["accessors"][row]
        view = said.get("bufferView")
        if view is not None and said["count"] > self.tree["bufferViews"][view]["byteLength"]:
            held = self.tree["bufferViews"][view]["byteLength"]
            raise AssetError(
                f"{said['count']:,} elements in the {held:,} bytes of bufferViews[{view}]",
                place=f"accessors[{row}]",
                advice="the file is damaged: copy or export it again",
            )
        return int(said["count"])

    def mesh(self, row: int) -> Mesh:
        """All triangle primitives of a mesh as one; the other primitives are carried in `document`."""
        said = self.tree["meshes"][row]
        parts = []
        for i, primitive in enumerate(said["primitives"]):
            place = f"meshes[{row}].primitives[{i}]"
            if primitive.get("mode", TRIANGLES) < TRIANGLES:
                continue
            if primitive.get("mode", TRIANGLES) > FAN:
                raise AssetError(f"mode {primitive['mode']} is none of glTF 2.0", place=place)
            if "POSITION" not in primitive["attributes"]:
                self.warn(f"{place} has no POSITION; left out")
                continue
            try:
                parts.append(self._part(primitive, self._skin_joints.get(row), place))
            except (AssetError, LimitError) as error:
                raise (error if error.place.startswith("buffer") else error.at(place)) from error
        title = str(said.get("name", ""))
        return build_mesh(parts, f"meshes[{row}]", self.warn, name=title)

    def _part(self, said: Json, joints: int | None, place: str) -> Part:
        squeezed = said.get("extensions", {}).get(draco.EXTENSION)
        faces, columns = self._draco(squeezed) if squeezed is not None else (None, {})
        raw: dict[str, NDArray[Any]] = {}
        for name, row in said["attributes"].items():
            accessor = self.tree["accessors"][row]
            if name in columns:
                raw[name] = as_floats(columns[name], bool(accessor.get("normalized")))
            elif name.startswith("JOINTS_"):
                raw[name] = self.buffers.accessor(row)
            else:
                raw[name] = self.buffers.floats(row)
        for i, target in enumerate(said.get("targets", ())):
            for name, row in target.items():
                raw[f"MORPH_{i}_{name}"] = self.buffers.floats(row)
        points = raw.pop("POSITION")
        if points.shape[1] != 3:
            raise AssetError("POSITION is not VEC3")
        for name in [n for n, values in raw.items() if not _fits(n, values.shape[1])]:
            self.warn(f"{place}: {name} has {raw[name].shape[1]} components, which glTF does not know; left out")
            del raw[name]
        for name in [n for n, values in raw.items() if len(values) < len(points)]:
            self.warn(f"{place}: {name} has {len(raw[name]):,} rows for {len(points):,} positions; left out")
            del raw[name]
        attributes = {name: values[: len(points)] for name, values in raw.items()}
        valid_skin(attributes, joints, place, self.warn)
        if faces is None:
            faces = self._faces(said, len(points), place)
        gone = ("attributes", "indices", "material", "mode", "targets")
        rest = {key: value for key, value in said.items() if key not in gone}
        return Part(points, faces, attributes, said.get("material"), without_decoded(rest))

    def _draco(self, said: Json) -> tuple[NDArray[Any], dict[str, NDArray[Any]]]:
        view, names = said.get("bufferView"), said.get("attributes")
        if not isinstance(view, int) or not 0 <= view < len(self.tree.get("bufferViews", ())):
            raise AssetError(f"{draco.EXTENSION} names no buffer view")
        if not isinstance(names, dict) or not all(isinstance(key, int) for key in names.values()):
            raise AssetError(f"{draco.EXTENSION} names no attributes")
        return draco.decode(bytes(self.buffers.view(view)), names)

    def _faces(self, said: Json, count: int, place: str) -> NDArray[Any]:
        """Triangles (F, 3) of a list, a strip or a fan."""
        if "indices" in said:
            index = self.buffers.accessor(said["indices"])
            if index.shape[1] != 1 or index.dtype.kind == "f":
                raise AssetError("indices are not whole numbers")
            index = index[:, 0]
        else:
            index = np.arange(count, dtype=np.uint32)
        mode = said.get("mode", TRIANGLES)
        if mode == TRIANGLES:
            if rest := len(index) % 3:
                self.warn(f"{place}: {len(index):,} indices are not threes; the last {rest} left out")
                index = index[: len(index) - rest]
            return index.reshape(-1, 3)
        a, b, c = index[:-2], index[1:-1], index[2:]
        if mode == STRIP:
            odd = np.arange(len(a)) % 2 == 1
            faces = np.stack([a, np.where(odd, c, b), np.where(odd, b, c)], axis=1)
        else:
            faces = np.stack([np.broadcast_to(index[:1], a.shape), b, c], axis=1)
        # two equal corners only lead from one part of a strip to the next
        real = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
        kept: NDArray[Any] = faces[real]
        return kept

    def image(self, row: int) -> Image:
        """An image; one that cannot be read becomes `Image.problem`."""
        said = self.tree["images"][row]
        name = str(said.get("name", ""))
        uri = said.get("uri")
        place = f"images[{row}]"
        try:
            if uri is not None and not uri.startswith("data:"):
                return dataclasses.replace(find_image(self.folder, uri, uri=True), name=name)
            if uri is None and "bufferView" not in said:
                raise AssetError("it has neither a URI nor a buffer view")
            data = data_uri(uri) if uri is not None else bytes(self.buffers.view(said["bufferView"]))
            return read_image(data, self.folder.limits, name=name)
        except AssetError as error:
            return Image(name=name, problem=f"{place}: {error.cause}")
        except LimitError as error:
            raise error.at(place) from error

    def document(self) -> Json:
        """The JSON without what meshes, materials, images and accessors hold; array numbers are rows of `carried`."""
        tree = {key: value for key, value in self.tree.items() if key not in _ARRAYS}
        if "meshes" in tree:
            tree["meshes"] = [self._mesh_rest(mesh) for mesh in tree["meshes"]]
        if "images" in tree:
            gone = ("uri", "bufferView", "mimeType")
            tree["images"] = [{k: v for k, v in image.items() if k not in gone} for image in tree["images"]]
        for skin in tree.get("skins", ()):
            if "inverseBindMatrices" in skin:
                skin["inverseBindMatrices"] = self._carry(skin["inverseBindMatrices"])
        for animation in tree.get("animations", ()):
            for sampler in animation["samplers"]:
                sampler.update(input=self._carry(sampler["input"]), output=self._carry(sampler["output"]))
        for i, node in enumerate(tree.get("nodes", ())):
            instances = node.get("extensions", {}).get(INSTANCING, {}).get("attributes", {})
            for name, row in instances.items():
                if not isinstance(row, int) or not 0 <= row < len(self.tree.get("accessors", ())):
                    raise AssetError(f"{INSTANCING} names no accessor", place=f"nodes[{i}]")
                instances[name] = self._carry(row)
        return tree

    def _mesh_rest(self, mesh: Json) -> Json:
        """A mesh without its triangles: name, weights, extras, extensions, and its points and lines."""
        rest = {key: value for key, value in mesh.items() if key != "primitives"}
        lines = []
        for said in mesh["primitives"]:
            if said.get("mode", TRIANGLES) < TRIANGLES:
                kept = without_decoded(said)
                kept["attributes"] = {n: self._carry(r, plain=n) for n, r in said["attributes"].items()}
                if "targets" in said:
                    kept["targets"] = [{n: self._carry(r, plain=n) for n, r in t.items()} for t in said["targets"]]
                if "indices" in said:
                    kept["indices"] = self._carry(said["indices"])
                lines.append(kept)
        return {**rest, "primitives": lines} if lines else rest

    def _carry(self, row: int, *, plain: str = "") -> int:
        """The row in `carried` of an accessor. `plain`: the vertex attribute that it is; quantised ones are undone."""
        said = self.tree["accessors"][row]
        undo = plain.startswith(_QUANTISABLE) and said["componentType"] != FLOAT
        key = (row, undo)
        if key not in self._carried_rows:
            values = self.buffers.floats(row) if undo else self.buffers.accessor(row)
            rest = {k: said[k] for k in ("name", "extras") if k in said}
            normalized = bool(said.get("normalized")) and not undo
            self._carried_rows[key] = len(self.carried)
            self.carried.append(Accessor(np.ascontiguousarray(values), said["type"], normalized, rest))
        return self._carried_rows[key]


def without_decoded(said: Json) -> Json:
    """A copy without the extensions that only said how arrays were stored."""
    kept = {name: value for name, value in said.get("extensions", {}).items() if name not in DECODED}
    rest = {key: value for key, value in said.items() if key != "extensions"}
    return {**rest, "extensions": kept} if kept else rest
