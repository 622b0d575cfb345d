"""Baking: the look of a source, put into new textures of a coarser level."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from lodpipe.core.asset import Asset, Lod
from lodpipe.core.errors import Cancelled
from lodpipe.core.material import Material, texture_ref
from lodpipe.core.mesh import F32, F64, I32, Mesh
from lodpipe.geometry.atlas import pack, unfold
from lodpipe.geometry.bake_mesh import Corners, rebuilt
from lodpipe.geometry.bake_source import Found, SourceMesh
from lodpipe.geometry.charts import borders_of
from lodpipe.geometry.fill import fill_gaps, spread_colour
from lodpipe.geometry.normals import unit
from lodpipe.geometry.occlusion import Occlusion
from lodpipe.geometry.slots import (
    BASE_COLOR,
    EMISSIVE,
    METALLIC_ROUGHNESS,
    NORMAL,
    OCCLUSION,
    Path,
    Slot,
    SlotTextures,
    is_colour,
    is_normal,
    map_name,
    slots,
)
from lodpipe.geometry.texture import U8, to_srgb
from lodpipe.kernel import layout

TILE = 1 << 20
"""Texels worked on at once, which bounds the memory of a bake to about 400 MB beside its textures."""
OUTSIDE = 1.5
"""Texels beyond a chart's border that are copied with it."""
FARTHEST = 30.0
"""Barycentric coordinates beyond that are those of a needle, whose UVs lead anywhere."""
CORE = (BASE_COLOR, METALLIC_ROUGHNESS, OCCLUSION, EMISSIVE, NORMAL)


@dataclass(frozen=True)
class BakeOptions:
    """How levels are baked; see the parameters of the stage."""

    maps: tuple[str, ...] | None = None
    """Names of the maps that are made; None: all that the materials have, and normals."""
    padding: float | None = None
    """Texels between two charts; None: see `padding_for`."""
    merge: bool = False
    seconds: float = 60.0
    threads: int = 0
    samples: int = 0
    """Samples along a texel's side; 0: two up to 1024², else one."""
    same_surface: bool = False
    """The level is the source itself with other UVs: nothing is looked for, only the maps that there are are made, and
    vertex colours stay where they are."""

    def wants(self, path: Path) -> bool:
        """Whether the map in a slot is made."""
        return self.maps is None or map_name(path) in self.maps


@dataclass(eq=False)
class Group:
    """Materials of the source that share a new texture, and the faces of a level that have them."""

    materials: list[int]
    """Rows of `Asset.materials`, −1 for the default one."""
    parts: list[tuple[int, I32]] = field(default_factory=list)
    """Mesh and rows of its faces."""
    side: int = 0
    """Width and height of the texture, in texels."""


@dataclass(eq=False)
class BakedMaterial:
    """A material without textures, and the pixels (H, W, 3 or 4) of the maps that go into its slots."""

    gltf: dict[str, Any]
    maps: dict[Path, U8]
    shared: dict[Path, Path] = field(default_factory=dict)
    """Slots that read the image of another slot."""


@dataclass(eq=False)
class Baked:
    """A level with new UVs; its meshes' primitives name rows of `materials`, then of `kept`."""

    meshes: tuple[Mesh, ...]
    materials: list[BakedMaterial]
    kept: list[int] = field(default_factory=list)
    """Rows of `Asset.materials` that some faces still have: they come after `materials`."""
    texels: int = 0
    missed: int = 0
    problems: list[str] = field(default_factory=list)


def padding_for(side: int) -> float:
    """Texels that keep charts apart up to mip 3 of a texture of 1024²; in proportion, up to 64, for others."""
    return min(max(4.0, side / 42), 64.0)


def groups_of(asset: Asset, meshes: Sequence[Mesh], merge: bool) -> list[Group]:
    """The materials of the meshes that are baked (those that may be simplified), each alone or with its likes."""
    found: dict[Any, Group] = {}
    for mesh in meshes:
        if mesh.keep_reason or not len(mesh.faces):
            continue
        for row in np.unique(mesh.face_material).tolist():
            key = _likeness(asset, row) if merge else row
            group = found.setdefault(key, Group([]))
            if row not in group.materials:
                group.materials.append(row)
    for group in found.values():
        for number, mesh in enumerate(meshes):
            if not mesh.keep_reason and len(mesh.faces):
                rows = np.flatnonzero(np.isin(mesh.face_material, group.materials)).astype(np.int32)
                if len(rows):
                    group.parts.append((number, rows))
    return list(found.values())


def bake_level(
    asset: Asset,
    level: Lod,
    groups: Sequence[Group],
    sources: Mapping[int, SourceMesh],
    textures: SlotTextures,
    reach: float,
    options: BakeOptions,
    *,
    sky: Occlusion | None = None,
    layouts: Sequence[F64] | None = None,
    progress: Callable[[float], None] = lambda share: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> Baked:
    """New UVs and textures for `level`, sampled from `asset`'s meshes.

    `groups` are those of `groups_of` with their sizes; `sources` has a SourceMesh for each mesh that they name; `reach`
    is how far in the scene's unit the source may lie from the level, each mesh at its largest placement. With `sky` the
    occlusion map is made from it instead of the source's. `layouts` has UVs (F, 3, 2) in texels for each group's faces,
    part after part; left out, the level is unfolded. Raises Cancelled, InvalidMesh where a texture is too small for its
    charts.
    """
    baked = Baked(level.meshes, [])
    sizes = _placed_sizes(asset)
    corners = {number: Corners(level.meshes[number]) for number, _ in _parts(groups)}
    texels_uv = list(layouts or ())
    for group in groups[len(texels_uv) :]:
        positions, faces = _joined(level.meshes, group, sizes)
        unfolded = unfold(positions, faces, seconds=options.seconds, cancelled=cancelled)
        if unfolded.problem and unfolded.problem not in baked.problems:
            baked.problems.append(unfolded.problem)
        side = group.side, group.side
        texels_uv.append(pack(unfolded.uv, unfolded.label, side, options.padding or padding_for(group.side)))
    for group, packed in zip(groups, texels_uv, strict=True):
        start = 0
        for number, rows in group.parts:
            corners[number].put_uv(rows, packed[start : start + len(rows)] / group.side)
            start += len(rows)
    reaches = {number: reach / sizes.get(number, 1.0) for number in corners}
    jobs = [_Job(asset, level.meshes, group, corners, sources, textures, reaches, options, sky) for group in groups]
    bent = {number for job in jobs if any(map(is_normal, job.paths)) for number, _ in job.group.parts}
    for number, part in corners.items():
        part.finish(number in bent, sources[number].corner_normals if options.same_surface else None)
    for index, job in enumerate(jobs):
        baked.materials.append(job.run(texels_uv[index], _share(progress, index, len(groups)), cancelled))
        baked.texels += job.texels
        baked.missed += job.missed
    material_of = {row: index for index, group in enumerate(groups) for row in group.materials}
    baked.kept = _kept(level.meshes, corners, material_of)
    kept_as = {row: len(groups) + index for index, row in enumerate(baked.kept)}
    meshes = [_with_materials(mesh, kept_as) for mesh in level.meshes]
    for number, part in corners.items():
        read = {slot.uv_name for job in jobs for slot in job.slots.values() if number in dict(job.group.parts)}
        for row in baked.kept:
            read -= {
                f"TEXCOORD_{ref.texcoord}" for ref in map(texture_ref, slots(asset.materials[row]).values()) if ref
            }
        gone = read if options.same_surface else read | {"COLOR_0"}
        meshes[number] = rebuilt(level.meshes[number], part, material_of, kept_as, gone)
    baked.meshes = tuple(meshes)
    return baked


def _kept(meshes: Sequence[Mesh], baked: Mapping[int, Corners], material_of: Mapping[int, int]) -> list[int]:
    """Rows of materials that are still named: by meshes that are not baked, and by their faces that are not."""
    rows = set()
    for number, mesh in enumerate(meshes):
        named = {p.material for p in mesh.primitives if p.material is not None}
        rows |= {row for row in named if number not in baked or row not in material_of}
    return sorted(rows)


def _with_materials(mesh: Mesh, rows: Mapping[int, int]) -> Mesh:
    moved = tuple(p if p.material is None else replace(p, material=rows.get(p.material)) for p in mesh.primitives)
    return mesh if moved == mesh.primitives else replace(mesh, primitives=moved)


def _share(progress: Callable[[float], None], index: int, count: int) -> Callable[[float], None]:
    return lambda share: progress((index + share) / count)


class _Job:
    """One texture set: the maps of a group."""

    def __init__(
        self,
        asset: Asset,
        meshes: Sequence[Mesh],
        group: Group,
        corners: Mapping[int, Corners],
        sources: Mapping[int, SourceMesh],
        textures: SlotTextures,
        reach: Mapping[int, float],
        options: BakeOptions,
        sky: Occlusion | None,
    ) -> None:
        self.group, self.corners, self.sources, self.reach, self.options = group, corners, sources, reach, options
        self.meshes = meshes
        default = Material()
        self.materials = {row: asset.materials[row] if row >= 0 else default for row in group.materials}
        self.infos = {row: slots(material) for row, material in self.materials.items()}
        self.slots: dict[tuple[int, Path], Slot] = {}
        for row, infos in self.infos.items():
            for path, info in infos.items():
                clear = path == BASE_COLOR and self.materials[row].alpha_mode != "OPAQUE" and not options.same_surface
                slot = textures.slot(path, info, spread=clear) if options.wants(path) else None
                if slot is not None:
                    self.slots[row, path] = slot
        self.merged = len(group.materials) > 1
        self.sky = sky
        self.segments = {
            number: np.full(len(meshes[number].faces), -1, np.int32)
            if options.same_surface
            else sources[number].segments_of(meshes[number])
            for number, _ in group.parts
        }
        self.paths = self._paths()
        self.texels = self.missed = 0

    def _paths(self) -> list[Path]:
        paths = dict.fromkeys(path for _, path in self.slots)
        if self.options.same_surface and not self.merged:
            return list(paths)
        wants = self.options.wants
        coloured = any("COLOR_0" in self.sources[number].mesh.attributes for number, _ in self.group.parts)
        if wants(BASE_COLOR) and (self.merged or coloured):
            paths[BASE_COLOR] = None
        if self.merged and wants(METALLIC_ROUGHNESS) and self._differ("metallicFactor", "roughnessFactor"):
            paths[METALLIC_ROUGHNESS] = None
        emissive = {json.dumps(material.gltf.get("emissiveFactor")) for material in self.materials.values()}
        if self.merged and wants(EMISSIVE) and len(emissive) > 1:
            paths[EMISSIVE] = None
        unlit = any("KHR_materials_unlit" in m.gltf.get("extensions", {}) for m in self.materials.values())
        if wants(NORMAL) and not unlit and not self.options.same_surface:
            paths[NORMAL] = None
        if wants(OCCLUSION) and self.sky is not None:
            paths[OCCLUSION] = None
        return list(paths)

    def _differ(self, *names: str) -> bool:
        said = {tuple(m.gltf.get("pbrMetallicRoughness", {}).get(n) for n in names) for m in self.materials.values()}
        return len(said) > 1

    def run(self, uv: F64, progress: Callable[[float], None], cancelled: Callable[[], bool]) -> BakedMaterial:
        """Fill the maps, tile by tile."""
        side = self.group.side
        alpha = any(m.alpha_mode != "OPAQUE" for m in self.materials.values())
        images = {p: np.zeros((side, side, 4 if p == BASE_COLOR and alpha else 3), np.uint8) for p in self.paths}
        known = np.zeros((side, side), bool)
        samples = self.options.samples or (2 if side <= 1024 else 1)
        edges = borders_of(self._numbers())
        reach = self.options.padding or padding_for(side)
        lines = max(1, TILE // (side * samples**2))
        for top in range(0, side, lines):
            if cancelled():
                raise Cancelled("cancelled")
            count = min(lines, side - top)
            window = (0, top * samples, side * samples, count * samples)
            seen = layout.uv_raster(uv * samples, edges, window, reach * samples, self.options.threads)
            if self.options.same_surface:
                _continue_outside(seen, uv * samples, top * samples)
            weight = np.where(seen.inside, np.float32(1), np.where(seen.faces >= 0, np.float32(1e-4), np.float32(0)))
            total = _boxes(weight[..., None], samples)[..., 0]
            known[top : top + count] = total > 0
            for path, values in self._look(seen, uv, samples):
                channels = images[path].shape[2]
                images[path][top : top + count] = _encoded(_means(values[..., :channels], weight, samples), path)
            progress((top + count) / side)
        for image in images.values():
            fill_gaps(image, known)
            if image.shape[2] == 4 and not self.options.same_surface:
                spread_colour(image)
        return self._material(images)

    def _numbers(self) -> I32:
        """(F, 3) numbers of UV vertices, so that borders of charts are known."""
        start, parts = 0, []
        for number, rows in self.group.parts:
            own = self.corners[number].uv_number[rows]
            parts.append(own + start)
            start += int(self.corners[number].uv_number.max(initial=-1)) + 1
        return np.concatenate(parts).astype(np.int32)

    def _look(self, seen: layout.UvRaster, uv: F64, samples: int) -> Iterator[tuple[Path, F32]]:
        """(path, linear values (h, w, 4)) of each map for the texels of a tile; normals are in tangent space, 0…1."""
        shape = seen.faces.shape
        flat_faces, flat_weights = seen.faces.ravel(), seen.weights.reshape(-1, 3)
        results = {path: np.zeros((flat_faces.size, 4), np.float32) for path in self.paths}
        first = 0
        for number, rows in self.group.parts:
            mine = np.flatnonzero((flat_faces >= first) & (flat_faces < first + len(rows)))
            faces = rows[flat_faces[mine] - first]
            own_uv = uv[flat_faces[mine]]
            first += len(rows)
            if not len(mine):
                continue
            part, mesh, source = self.corners[number], self.meshes[number], self.sources[number]
            weights = flat_weights[mine]
            points = np.einsum("nkd,nk->nd", mesh.positions[mesh.faces[faces]], weights)
            normals = unit(np.einsum("nkd,nk->nd", part.smooth[faces], weights).astype(np.float64))
            texel = _texel_width(mesh.positions[mesh.faces[faces]], own_uv) / samples
            kinds = np.stack([mesh.face_material[faces], self.segments[number][faces]], axis=1)
            for row, segment in np.unique(kinds, axis=0).tolist():
                chosen = np.flatnonzero((kinds == (row, segment)).all(axis=1))
                if self.options.same_surface:
                    found = Found(faces[chosen], weights[chosen], np.zeros(len(chosen), bool))
                else:
                    allowed = source.allowed(row, segment)
                    found = source.find(points[chosen], normals[chosen], self.reach[number], allowed)
                inside = seen.inside.ravel()[mine[chosen]]
                self.texels += int(inside.sum())
                self.missed += int((found.missed & inside).sum())
                at = mine[chosen]
                for path in self.paths:
                    if is_normal(path):
                        slot = self.slots.get((row, path))
                        bent = source.normals(found, slot, texel[chosen])
                        results[path][at, :3] = part.encoded(faces[chosen], weights[chosen], bent)
                    elif path == OCCLUSION and self.sky is not None:
                        up = source.normals(found, None, texel[chosen]).astype(np.float64)
                        results[path][at] = self.sky.at(number, source.points(found), up)[:, None]
                    else:
                        results[path][at] = self._values(row, path, source, found, texel[chosen])
        for path, values in results.items():
            yield path, values.reshape(*shape, 4)

    def _values(self, row: int, path: Path, source: SourceMesh, found: Found, texel: F64) -> F32:
        """Linear RGBA (N, 4) of a map of colours or numbers."""
        slot = self.slots.get((row, path))
        seen = None if slot is None else source.sample(slot, found, texel)
        values = np.ones((len(found.faces), 4), np.float32) if seen is None else seen
        if self.merged:
            values = values * _factor(self.materials[row], path)
            if path == OCCLUSION:
                strength = self.infos[row].get(OCCLUSION, {}).get("strength", 1.0)
                values = 1 + (values - 1) * np.float32(strength)
        if path == BASE_COLOR and not self.options.same_surface:
            colours = source.blended("COLOR_0", found)
            if colours is not None:
                has = np.array(["COLOR_0" in p.attributes for p in source.mesh.primitives])
                tint = np.clip(colours, 0, 1)
                tint[~has[source.mesh.face_primitive[found.faces]]] = 1
                values[:, : tint.shape[1]] *= tint
        return values

    def _material(self, images: dict[Path, U8]) -> BakedMaterial:
        """The material with its new slots still empty; occlusion goes into the red of metal and roughness."""
        gltf = _without_textures(self.materials[self.group.materials[0]].gltf)
        pbr = gltf.setdefault("pbrMetallicRoughness", {})
        shared: dict[Path, Path] = {}
        if self.merged:
            names = [m.name for m in self.materials.values() if m.name]
            gltf["name"] = "+".join(names)[:60] or "merged"
            for path, keys in _FACTORS.items():
                if path in images:
                    for key in keys:
                        (gltf if path == EMISSIVE else pbr).pop(key, None)
            if EMISSIVE in images:
                gltf["emissiveFactor"] = [1.0, 1.0, 1.0]
        if OCCLUSION in images and METALLIC_ROUGHNESS in images:
            images[METALLIC_ROUGHNESS][..., 0] = images.pop(OCCLUSION)[..., 0]
            shared[OCCLUSION] = METALLIC_ROUGHNESS
        if not self.merged and OCCLUSION in [*images, *shared] and self.sky is None:
            (row,) = self.group.materials
            strength = self.infos[row][OCCLUSION].get("strength")
            if strength is not None:
                gltf["occlusionTexture"] = {"strength": strength}
        if not pbr:
            del gltf["pbrMetallicRoughness"]
        return BakedMaterial(gltf, images, shared)


_FACTORS: dict[Path, tuple[str, ...]] = {
    BASE_COLOR: ("baseColorFactor",),
    METALLIC_ROUGHNESS: ("metallicFactor", "roughnessFactor"),
    EMISSIVE: ("emissiveFactor",),
}


def _factor(material: Material, path: Path) -> F32:
    """(4,) what a material multiplies the texture in a slot with."""
    pbr = material.gltf.get("pbrMetallicRoughness", {})
    if path == BASE_COLOR:
        return np.array(material.base_color_factor, np.float32)
    if path == METALLIC_ROUGHNESS:
        return np.array([1, pbr.get("roughnessFactor", 1.0), pbr.get("metallicFactor", 1.0), 1], np.float32)
    if path == EMISSIVE:
        return np.array([*material.gltf.get("emissiveFactor", (0.0, 0.0, 0.0)), 1], np.float32)
    return np.ones(4, np.float32)


def _likeness(asset: Asset, row: int) -> Any:
    """Equal for materials that can share a draw call: the same but for what a texture can hold."""
    material = asset.materials[row] if row >= 0 else Material()
    if any(path not in CORE for path in slots(material)):
        return row  # textures of extensions have no common place
    rest = {k: v for k, v in material.gltf.items() if k in ("alphaMode", "alphaCutoff", "doubleSided", "extensions")}
    return json.dumps({"alphaMode": "OPAQUE", "doubleSided": False, "extensions": {}} | rest, sort_keys=True)


def _without_textures(tree: Mapping[str, Any]) -> dict[str, Any]:
    """A glTF material without its texture slots."""
    result: dict[str, Any] = {}
    for key, value in tree.items():
        if key != "extras" and isinstance(value, Mapping):
            if key.lower().endswith("texture") and isinstance(value.get("index"), int):
                continue
            result[key] = _without_textures(value)
        else:
            result[key] = value
    return result


def _parts(groups: Sequence[Group]) -> Iterator[tuple[int, I32]]:
    for group in groups:
        yield from group.parts


def _placed_sizes(asset: Asset) -> dict[int, float]:
    """Mesh -> how much larger than itself its largest placement is."""
    sizes: dict[int, float] = {}
    for number, matrix in asset.instances():
        grown = abs(float(np.linalg.det(matrix[:3, :3]))) ** (1 / 3)
        sizes[number] = max(sizes.get(number, 0.0), grown)
    return {number: size if 0 < size < np.inf else 1.0 for number, size in sizes.items()}


def _joined(meshes: Sequence[Mesh], group: Group, sizes: Mapping[int, float]) -> tuple[F64, I32]:
    """Positions and faces of a group's parts as one, each part at the size at which it is placed."""
    positions, faces, start = [], [], 0
    for number, rows in group.parts:
        mesh = meshes[number]
        positions.append((mesh.positions - mesh.positions.mean(axis=0)) * sizes.get(number, 1.0))
        faces.append(mesh.faces[rows] + np.int32(start))
        start += len(mesh.positions)
    return np.concatenate(positions), np.concatenate(faces)


def _texel_width(corners: F64, uv: F64) -> F64:
    """(N,) the width of a texel in space, on faces (N, 3, 3) whose UVs are in texels."""
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    texels = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    width: F64 = np.sqrt(area / np.maximum(texels, 1e-12))
    return width


def _continue_outside(seen: layout.UvRaster, uv: F64, top: int) -> None:
    """Let the faces go on, in `seen.weights`, for the texels outside a chart that bilinear filters reach from inside.

    There the old texture's texels beyond the old border belong, so that the border looks as it did.
    """
    rows, columns = np.nonzero((seen.faces >= 0) & ~seen.inside)
    corners = uv[seen.faces[rows, columns]]
    centre = np.stack([columns + 0.5, rows + (top + 0.5)], axis=1)
    away = centre - np.einsum("nkd,nk->nd", corners, seen.weights[rows, columns])
    a, b, p = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], centre - corners[:, 0]
    area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    safe = np.where(np.abs(area) > 1e-9, area, 1.0)
    v = (p[:, 0] * b[:, 1] - p[:, 1] * b[:, 0]) / safe
    w = (a[:, 0] * p[:, 1] - a[:, 1] * p[:, 0]) / safe
    weights = np.stack([1 - v - w, v, w], axis=1)
    near = (np.abs(away).max(axis=1) <= OUTSIDE) & (np.abs(area) > 1e-9) & (np.abs(weights).max(axis=1) <= FARTHEST)
    seen.weights[rows[near], columns[near]] = weights[near]


def _means(values: F32, weight: F32, samples: int) -> F32:
    """Means by `weight` (h, w) over squares of `samples`² of (h, w, C); colours count by their alpha, if there is one,
    so that what is not seen does not tint what is."""
    tiny = np.float32(1e-12)
    total = np.maximum(_boxes(weight[..., None], samples), tiny)
    plain = _boxes(values * weight[..., None], samples) / total
    if values.shape[2] < 4:
        return plain.astype(np.float32)
    opaque = weight * values[..., 3]
    seen = _boxes(opaque[..., None], samples)
    colour = _boxes(values[..., :3] * opaque[..., None], samples) / np.maximum(seen, tiny)
    means: F32 = np.concatenate([np.where(seen > tiny, colour, plain[..., :3]), plain[..., 3:]], axis=2)
    return means


def _boxes(values: F32, samples: int) -> F32:
    """Sums over squares of `samples`² of (h, w, C)."""
    if samples == 1:
        return values
    height, width, channels = values.shape
    sums: F32 = values.reshape(height // samples, samples, width // samples, samples, channels).sum(axis=(1, 3))
    return sums


def _encoded(values: F32, path: Path) -> U8:
    """Linear means as bytes: sRGB for colours; normals back to unit length."""
    if is_normal(path):
        vectors = values[..., :3] * 2 - 1
        vectors /= np.maximum(np.linalg.norm(vectors, axis=2, keepdims=True), np.float32(1e-6))
        values = vectors * np.float32(0.5) + np.float32(0.5)
    elif is_colour(path):
        values = np.concatenate([to_srgb(values[..., :3]), values[..., 3:]], axis=2)
    encoded: U8 = np.rint(np.clip(values, 0, 1) * 255).astype(np.uint8)
    return encoded
