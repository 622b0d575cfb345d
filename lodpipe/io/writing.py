"""The ways out: `save` writes one level, `save_combined` all levels into one file."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from lodpipe.core.asset import Asset
from lodpipe.core.errors import InvalidMesh, LodpipeError, OutputError
from lodpipe.core.mesh import Mesh
from lodpipe.io.clean import Warn
from lodpipe.io.obj_write import obj_files, texture_source
from lodpipe.io.off import write_off
from lodpipe.io.placed import Placed, one_surface, one_vertex_list, placements
from lodpipe.io.ply import write_ply
from lodpipe.io.stl import write_stl
from lodpipe.io.textures import file_names

_LOG = logging.getLogger("lodpipe")


def save(asset: Asset, path: Path, meshes: Sequence[Mesh] | None = None, *, warn: Warn = _LOG.warning) -> list[Path]:
    """Write one level to `path`, in the format of its extension, with the files that belong to it beside it.

    `meshes` stands in for `asset.meshes`, row for row. `warn` is told what the format cannot hold. Returns the
    files written, the model itself first. Raises OutputError when they cannot be written.
    """
    path = Path(path)
    level = asset.meshes if meshes is None else tuple(meshes)
    suffix = path.suffix.lower()
    try:
        if len(level) != len(asset.meshes):
            raise InvalidMesh(f"{len(level)} meshes are given for an asset of {len(asset.meshes)}")
        if not any(len(mesh.faces) for mesh in level):
            raise OutputError("the level has no triangles", advice="ask for more of them")
        if suffix in (".glb", ".gltf"):
            from lodpipe.io.gltf_write import gltf_files

            files = gltf_files(asset, path, [level], (), warn)
        elif suffix == ".obj":
            _tell_losses(asset, suffix, warn)
            files = obj_files(asset, path, level, warn)
        elif suffix in (".ply", ".stl", ".off"):
            _tell_losses(asset, suffix, warn)
            files = _plain_files(asset, path, list(placements(asset, level)), warn)
        else:
            raise OutputError(f"'{path.suffix}' is not a model format", advice="use glb, gltf, obj, ply, stl or off")
    except LodpipeError as error:
        raise error.at(path.name) from error
    return write_files(path.parent, files)


def save_combined(
    asset: Asset,
    path: Path,
    levels: Sequence[Sequence[Mesh]],
    coverages: Sequence[float],
    *,
    warn: Warn = _LOG.warning,
) -> list[Path]:
    """Write all `levels`, finest first, into one GLB with MSFT_lod.

    `coverages` are the screen coverages, 0…1 and descending, below which each level is left for the next, the last
    of them for nothing at all: one for each level. Raises OutputError, and ValueError for other coverages.
    """
    path = Path(path)
    if len(coverages) != len(levels) or any(a <= b for a, b in pairwise(coverages)):
        raise ValueError(f"{len(levels)} levels need as many coverages, descending (got {list(coverages)})")
    from lodpipe.io.gltf_write import gltf_files

    try:
        files = gltf_files(asset, path.with_suffix(".glb"), levels, coverages, warn)
    except LodpipeError as error:
        raise error.at(path.name) from error
    return write_files(path.parent, [(path.name, files[0][1])])


def _plain_files(asset: Asset, path: Path, parts: list[Placed], warn: Warn) -> list[tuple[str, bytes]]:
    """A PLY with its texture, an STL or an OFF."""
    if path.suffix.lower() == ".stl":
        return [(path.name, b"".join(write_stl(*one_surface(parts))))]
    there = {name for part in parts for name in part.mesh.attributes}
    if path.suffix.lower() == ".off":
        if "COLOR_0" not in there:
            return [(path.name, b"".join(write_off(*one_surface(parts), None)))]
        points, faces, columns = one_vertex_list(parts, ["COLOR_0"])
        return [(path.name, b"".join(write_off(points, faces, columns["COLOR_0"])))]
    names = [name for name in ("NORMAL", "TEXCOORD_0", "COLOR_0") if name in there]
    points, faces, columns = one_vertex_list(parts, names)
    textures = _base_textures(asset, parts) if "TEXCOORD_0" in there else []
    files: list[tuple[str, bytes]] = []
    if len(textures) == 1:
        image = asset.images[textures[0]]
        files = [(file_names([image], [path.name])[0], image.data)]
    elif textures:
        warn(f"PLY has room for one texture, the model has {len(textures)}; left out")
    return [(path.name, b"".join(write_ply(points, faces, columns, [name for name, _ in files]))), *files]


def _base_textures(asset: Asset, parts: Iterable[Placed]) -> list[int]:
    """The image rows of the base colours of the materials that the parts use."""
    rows = {p.material for part in parts for p in part.mesh.primitives if p.material is not None}
    refs = [asset.materials[row].base_color_texture for row in sorted(rows)]
    sources = {texture_source(asset.document, ref.texture) for ref in refs if ref is not None}
    return sorted(s for s in sources if s is not None and asset.images[s].data)


def _tell_losses(asset: Asset, suffix: str, warn: Warn) -> None:
    """What the format has no place for, in one line."""
    lost = []
    if suffix in (".stl", ".off") and asset.materials:
        lost.append("materials")
    if suffix in (".stl", ".off") and asset.images:
        lost.append("textures")
    if suffix == ".ply" and len(asset.materials) > 1:
        lost.append("materials")
    if len(asset.instances()) > 1:
        lost.append("the node tree (meshes are written where it places them)")
    keys = {"skins": "skins", "animations": "animations", "cameras": "cameras", "extensions": "extensions"}
    lost += [title for key, title in keys.items() if asset.document.get(key)]
    slots = {slot for material in asset.materials for slot in _slots(material.gltf)}
    if suffix == ".obj" and (further := slots - {"baseColorTexture", "normalTexture", "emissiveTexture"}):
        lost.append(", ".join(sorted(further)))
    attributes = {name for mesh in asset.meshes for name in mesh.attributes}
    if suffix == ".stl" and attributes:
        lost.append("normals, UVs and colours")
    elif suffix == ".off" and attributes - {"COLOR_0"}:
        lost.append("normals and UVs")
    elif suffix == ".ply" and attributes - {"COLOR_0", "NORMAL", "TEXCOORD_0"}:
        lost.append("further vertex attributes")
    if lost:
        warn(f"{suffix[1:].upper()} has no place for {', '.join(lost)}; left out")


def _slots(tree: Any) -> Iterator[str]:
    """The names of the texture slots of a material."""
    for key, value in tree.items() if isinstance(tree, Mapping) else ():
        if key.endswith("Texture"):
            yield key
        elif key != "extras":
            yield from _slots(value)


def write_files(folder: Path, files: Iterable[tuple[str, bytes]]) -> list[Path]:
    """Write files of the given names and contents into `folder`, which is made if need be; their paths.

    Raises OutputError when that is not possible.
    """
    written = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"the folder cannot be made ({error.strerror or error})", place=str(folder)) from error
    for name, data in files:
        target = folder / name
        try:
            target.write_bytes(data)
        except OSError as error:
            raise OutputError(f"{name} cannot be written ({error.strerror or error})", place=str(folder)) from error
        written.append(target)
    return written
