"""What a ray sees where it meets a model: colour, opacity and normal, from materials, textures and attributes."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.asset import Asset
from lodpipe.core.material import Material, TextureRef, texture_ref
from lodpipe.core.mesh import F32, F64, I32, Mesh
from lodpipe.core.rays import Hits
from lodpipe.geometry.camera import Camera, bounding_sphere
from lodpipe.geometry.flatten import Soup, flatten
from lodpipe.geometry.normals import crease_normals
from lodpipe.geometry.tangents import corner_tangents
from lodpipe.geometry.texture import NEAREST, REPEAT, Texture, Textures, chequer, to_srgb, uv_matrix
from lodpipe.kernel.pictures import blended
from lodpipe.kernel.surfaces import face_normals, raster

if TYPE_CHECKING:
    from lodpipe.o3d import RayScene

CREASE = 60.0
"""Degrees between faces from which an edge without normals of its own looks sharp."""


@dataclass(frozen=True)
class Slot:
    """A material's use of a texture, as the renderer reads it."""

    texture: Texture
    uv_name: str = "TEXCOORD_0"
    uv_matrix: F64 | None = None
    """(2, 3), see `uv_matrix`; None: as they are."""
    wrap: tuple[int, int] = (REPEAT, REPEAT)
    nearest: bool = False


@dataclass(frozen=True)
class Look:
    """A material as the renderer reads it."""

    factor: F32
    """Linear RGBA (4,)."""
    base: Slot | None = None
    normal: Slot | None = None
    normal_scale: float = 1.0
    emission: F32 | None = None
    """Linear RGB (3,), None for what does not shine."""
    emission_map: Slot | None = None
    alpha_mode: str = "OPAQUE"
    cutoff: float = 0.5
    double_sided: bool = False
    unlit: bool = False


@dataclass(frozen=True)
class Spots:
    """N places on a model's surface that rays have met.

    faces (N,) int32, weights (N, 3) float32 barycentric, directions (N, 3) float32 of the rays, pixel (N,) float32, a
    pixel's width there in radii of the model, and flat (N, 3) float32, the faces' unit normals.
    """

    faces: I32
    weights: F32
    directions: F32
    pixel: F32
    flat: F32
    parted: list[tuple[int, NDArray[np.int64] | slice, Spots]] = field(default_factory=list)
    """By look, its row, the spots' rows and the spots; filled by the model when it first asks."""

    @cached_property
    def cosine(self) -> F32:
        """(N,) between the faces' normals and the rays: positive where the back is seen."""
        product: F32 = np.einsum("nd,nd->n", self.flat, self.directions)
        return product

    def take(self, rows: NDArray[np.int64]) -> Spots:
        """The spots of `rows`."""
        return Spots(self.faces[rows], self.weights[rows], self.directions[rows], self.pixel[rows], self.flat[rows])


class Model:
    """An asset, or one of its levels, made ready for rendering: the default scene with all instances placed.

    `meshes` (a level's) stands in for `asset.meshes`; `textures` holds the decoded images, and is shared between the
    levels of an asset. A texture that it lacks is left out: the factor colour stands in.
    """

    def __init__(
        self,
        asset: Asset,
        meshes: Sequence[Mesh] | None = None,
        textures: Textures | None = None,
        threads: int = 0,
    ) -> None:
        self.soup: Soup = flatten(asset, meshes)
        self.centre, self.radius = bounding_sphere(self.soup)
        self.positions: F32 = ((self.soup.positions - self.centre) / self.radius).astype(np.float32)
        self.faces = self.soup.faces
        self._threads = threads
        self._rays: RayScene | None = None
        images = Textures() if textures is None else textures
        self.looks, self._look_of = _looks([*asset.materials, Material()], asset.document, images)

    def prepare(self) -> None:
        """Make all that pictures need: afterwards several threads may take them at once."""
        if not len(self.faces):
            return
        for look in self.looks:
            for slot in (look.base, look.normal, look.emission_map):
                if slot is not None:
                    self._attribute(slot.uv_name) and self._density(slot.uv_name)
            if look.normal is not None:
                self._tangents(look.normal.uv_name)
        self._attribute("COLOR_0")
        _ = self._normals
        self.geometric_normals(np.zeros(1, np.int32))

    def first_hits(self, camera: Camera, width: int, height: int, rows: slice, behind: F32 | None = None) -> Hits:
        """What the rays through the pixels of `rows` meet first beyond `behind` (N,) float32, if that is given; it is
        infinite for rays that have ended. Distances are in radii."""
        axes = camera.axes
        eye = (camera.position - self.centre) / self.radius
        size = camera.height / 2 / self.radius if camera.fov is None else float(np.tan(np.radians(camera.fov / 2)))
        view = (eye, axes[0], axes[1], -axes[2])
        hits = raster(
            self.positions, self.faces, view, size, camera.fov is not None, (height, width), rows, behind=behind
        )
        return self._cast(camera, width, height, rows, behind) if hits is None else hits

    def _cast(self, camera: Camera, width: int, height: int, rows: slice, behind: F32 | None) -> Hits:
        """The same by rays, for a camera inside the model."""
        from lodpipe.o3d import RayScene

        if self._rays is None:
            self._rays = RayScene(self.positions, self.faces, self._threads)
        origins, directions = camera.rays(width, height, rows, self.centre, self.radius)
        if behind is None:
            return self._rays.cast(origins, directions)
        going = np.flatnonzero(np.isfinite(behind))
        start = origins[going] + directions[going] * behind[going, None]
        found = self._rays.cast(start, directions[going])
        hits = Hits(
            np.full(len(behind), np.inf, np.float32),
            np.full(len(behind), -1, np.int32),
            np.zeros((len(behind), 2), np.float32),
        )
        hits.distance[going] = found.distance + behind[going]
        hits.faces[going] = found.faces
        hits.uv[going] = found.uv
        return hits

    def corners(self, faces: I32) -> F32:
        """(N, 3, 3) float32: the corners of `faces`, about the origin and in radii."""
        return self.positions[self.faces[faces]]

    def geometric_normals(self, faces: I32) -> F32:
        """(N, 3) float32 unit normals of the triangles `faces`."""
        if "_face_normals" not in self.__dict__ and 8 * len(faces) < len(self.faces):  # not worth making all
            return face_normals(self.positions, self.faces[faces]).astype(np.float32)
        return self._face_normals[faces]

    def facing_normals(self, spots: Spots) -> F32:
        """(N, 3) float32 unit normals of the triangles, on the viewer's side."""
        return np.where((spots.cosine > 0)[:, None], -spots.flat, spots.flat)

    def shading_normals(self, spots: Spots, own: bool = True, mapped: bool = True) -> F32:
        """(N, 3) float32 unit normals on the viewer's side of the triangles.

        The file's where a face has them, else from the triangles, smooth but for creases; with normal maps if
        `mapped`. `own` = False: all from the triangles.
        """
        values, corners = self._normals if own else (self._creased.reshape(-1, 3), None)
        normals = blended(values, corners, spots.faces, spots.weights)
        length = np.sqrt(np.einsum("nd,nd->n", normals, normals))
        normals /= np.maximum(length, np.float32(1e-6))[:, None]
        none = length <= 1e-6
        if none.any():
            normals[none] = spots.flat[none]
        # the side of the triangle that is seen decides: a smooth normal may look past the silhouette
        seen_from_behind = spots.cosine > 0
        against = np.einsum("nd,nd->n", normals, spots.flat) < 0
        if own and mapped:
            self._perturb(spots, normals)
        normals[seen_from_behind != against] *= -1
        return normals

    def colours(self, spots: Spots, only_alpha: bool = False, cull: bool = False) -> F32:
        """(N, 4) float32: linear base colour, and how much of it covers what lies behind.

        Alpha is 1 for an opaque material, 0 or 1 for a masked one, and 0 on the back of single-sided faces if
        `cull`. `only_alpha` saves the look-ups of opaque materials, whose colour is then undefined.
        """
        rgba = np.ones((len(spots.faces), 4), np.float32)
        for look, rows, own in self._by_material(spots):
            if look.alpha_mode != "OPAQUE" or not only_alpha:
                rgba[rows] = self._base_colour(look, own)
            if look.alpha_mode == "OPAQUE":
                rgba[rows, 3] = 1.0
            elif look.alpha_mode == "MASK":
                rgba[rows, 3] = rgba[rows, 3] >= look.cutoff
            if cull and not look.double_sided:
                rgba[rows, 3] *= own.cosine <= 0
        return rgba

    def unlit(self, spots: Spots) -> NDArray[np.bool_]:
        """(N,) bool: whether the material asks for its colour without light (KHR_materials_unlit)."""
        return np.array([look.unlit for look in self.looks])[self._look_of[self.soup.face_material[spots.faces]]]

    def add_emission(self, spots: Spots, lit: F32) -> None:
        """Add to `lit` (N, 3), linear, what the materials shine with by themselves."""
        if all(look.emission is None for look in self.looks):
            return
        for look, rows, own in self._by_material(spots):
            if look.emission is not None:
                seen = None if look.emission_map is None else self._sampled(look.emission_map, own)
                lit[rows] += look.emission if seen is None else look.emission * seen[:, :3]

    def chequer(self, spots: Spots) -> F32:
        """(N, 3) float32 sRGB: a numbered chequer laid out by TEXCOORD_0; grey where a face has none."""
        seen = self._sampled(Slot(chequer()), spots, missing=0.2)
        return np.full((len(spots.faces), 3), 0.5, np.float32) if seen is None else to_srgb(seen[:, :3])

    def _base_colour(self, look: Look, spots: Spots) -> F32:
        rgba = np.broadcast_to(look.factor, (len(spots.faces), 4)).copy()
        seen = None if look.base is None else self._sampled(look.base, spots)
        if seen is not None:
            rgba *= seen
        colours = self._attribute("COLOR_0")
        if colours is not None:
            values, has = colours
            seen = blended(values, self.soup.wedges, spots.faces, spots.weights)
            seen[~has[spots.faces]] = 1.0
            rgba[:, : seen.shape[1]] *= np.clip(seen, 0.0, 1.0)
        return rgba

    def _sampled(self, slot: Slot, spots: Spots, missing: float = 1.0) -> F32 | None:
        """(N, 4) float32 of the texture, `missing` where a face has no such UVs; None if none of the model has."""
        coordinates = self._attribute(slot.uv_name)
        if coordinates is None:
            return None
        values, has = coordinates
        uv = blended(values, self.soup.wedges, spots.faces, spots.weights)[:, :2]
        turned = 1.0
        if slot.uv_matrix is not None:
            uv = (uv @ slot.uv_matrix[:, :2].T + slot.uv_matrix[:, 2]).astype(np.float32)
            turned = abs(float(np.linalg.det(slot.uv_matrix[:, :2])))
        texels = np.sqrt(turned * slot.texture.width * slot.texture.height) * self._footprint(slot.uv_name, spots)
        seen = slot.texture.sample(uv, texels, slot.wrap, slot.nearest)
        without = ~has[spots.faces]
        if without.any():
            seen[without] = missing
        return seen

    def _perturb(self, spots: Spots, normals: F32) -> None:
        """Turn `normals` (N, 3), in place, as the materials' normal maps say."""
        if all(look.normal is None for look in self.looks):
            return
        for look, rows, own in self._by_material(spots):
            if look.normal is None:
                continue
            tangents = self._tangents(look.normal.uv_name)
            seen = self._sampled(look.normal, own)
            if tangents is None or seen is None:
                continue
            turned = blended(tangents.reshape(-1, 4), None, own.faces, own.weights)
            n, t, side = normals[rows], turned[:, :3], turned[:, 3]
            t = t - np.einsum("nd,nd->n", n, t)[:, None] * n
            length = np.sqrt(np.einsum("nd,nd->n", t, t))
            t /= np.maximum(length, np.float32(1e-20))[:, None]
            b = np.cross(n, t) * np.where(side < 0, np.float32(-1), np.float32(1))[:, None]
            x, y, z = (seen[:, k, None] * np.float32(2) - np.float32(1) for k in range(3))
            scale = np.float32(look.normal_scale)
            turned = x * scale * t + y * scale * b + np.maximum(z, np.float32(1e-3)) * n
            turned /= np.sqrt(np.einsum("nd,nd->n", turned, turned))[:, None]
            usable = (length > 1e-6) & np.isfinite(turned).all(axis=1)  # no tangent, no map
            normals[rows] = np.where(usable[:, None], turned, n)

    @cached_property
    def _normals(self) -> tuple[F32, I32 | None]:
        """The file's normals, or, where a corner has none, those made from the triangles; as `blended` takes them."""
        given = self._attribute("NORMAL")
        if given is None:
            return self._creased.reshape(-1, 3), None
        values, has = given
        if has.all() and values.any(axis=1).all():
            return values, self.soup.wedges
        corners = values[self.soup.wedges]
        missing = ~has | ~np.all(np.any(corners, axis=2), axis=1)
        if missing.any():
            corners[missing] = self._creased[missing]
        return corners.reshape(-1, 3), None

    def _tangents(self, uv_name: str) -> F32 | None:
        """(F, 3, 4) float32: see `corner_tangents`; the file's where it has them. None if no face has such UVs."""
        if uv_name not in self._made_tangents:
            coordinates = self._attribute(uv_name)
            made = None
            if coordinates is not None:
                uv = coordinates[0][self.soup.wedges][:, :, :2]
                stored = self._attribute("TANGENT")
                without = coordinates[1] if stored is None else coordinates[1] & ~stored[1]
                rows = np.flatnonzero(without)
                normals, corners = self._normals
                normals = normals.reshape(-1, 3, 3) if corners is None else normals
                made = np.zeros((len(self.faces), 3, 4), np.float32)
                made[rows] = corner_tangents(
                    self.positions,
                    self.faces[rows],
                    normals[rows] if corners is None else normals[corners[rows]],
                    np.nan_to_num(uv[rows], posinf=0.0, neginf=0.0),
                )
                if stored is not None:
                    made[stored[1]] = stored[0][self.soup.wedges[stored[1]]]
            self._made_tangents[uv_name] = made
        return self._made_tangents[uv_name]

    def _footprint(self, uv_name: str, spots: Spots) -> F32:
        """(N,) float32: a pixel's width in UV space, the mean over its directions."""
        # the more a face is turned away the more of it a pixel covers, but not without end
        few = uv_name not in self._densities and 8 * len(spots.faces) < len(self.faces)
        density = self._density_of(uv_name, spots.faces) if few else self._density(uv_name)[spots.faces]
        steep = np.sqrt(np.maximum(np.abs(spots.cosine), np.float32(0.05))).astype(np.float32)
        return spots.pixel * density / steep

    def _density(self, uv_name: str) -> F32:
        """(F,) float32: a face's size in UV space over its size in radii, as lengths."""
        if uv_name not in self._densities:
            self._densities[uv_name] = self._density_of(uv_name, slice(None))
        return self._densities[uv_name]

    def _density_of(self, uv_name: str, faces: I32 | slice) -> F32:
        """The same of some faces."""
        coordinates = self._attribute(uv_name)
        if coordinates is None:
            raise KeyError(uv_name)
        uv, corners = coordinates[0][self.soup.wedges[faces]], self.positions[self.faces[faces]]
        d, e = uv[:, 1, :2] - uv[:, 0, :2], uv[:, 2, :2] - uv[:, 0, :2]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.sqrt(np.einsum("nd,nd->n", normals, normals))
        flat = np.abs(d[:, 0] * e[:, 1] - d[:, 1] * e[:, 0])
        density: F32 = np.sqrt(flat / np.maximum(area, np.float32(1e-30)))
        return density

    def _by_material(self, spots: Spots) -> Iterator[tuple[Look, NDArray[np.int64] | slice, Spots]]:
        """Each look that `spots` have, the spots' rows, and the spots."""
        if not spots.parted:
            kind = self._look_of[self.soup.face_material[spots.faces]]
            kinds = np.flatnonzero(np.bincount(kind))
            if len(kinds) == 1:
                spots.parted.append((int(kinds[0]), slice(None), spots))
            else:
                order = np.argsort(kind.astype(np.int16 if len(self.looks) < 30_000 else np.int64), kind="stable")
                for rows in np.split(order, np.flatnonzero(np.diff(kind[order])) + 1):
                    spots.parted.append((int(kind[rows[0]]), rows, spots.take(rows)))
        for row, own_rows, own in spots.parted:
            yield self.looks[row], own_rows, own

    def _attribute(self, name: str) -> tuple[F32, NDArray[np.bool_]] | None:
        if name not in self._attributes:
            self._attributes[name] = self.soup.attribute(name)
        return self._attributes[name]

    @cached_property
    def _attributes(self) -> dict[str, tuple[F32, NDArray[np.bool_]] | None]:
        return {}

    @cached_property
    def _made_tangents(self) -> dict[str, F32 | None]:
        return {}

    @cached_property
    def _densities(self) -> dict[str, F32]:
        return {}

    @cached_property
    def _face_normals(self) -> F32:
        return face_normals(self.positions, self.faces)

    @cached_property
    def _creased(self) -> F32:
        return crease_normals(self.positions, self.faces, CREASE)


def _looks(
    materials: Sequence[Material], document: Mapping[str, Any], images: Textures
) -> tuple[list[Look], NDArray[np.intp]]:
    """The different looks of `materials`, and of each material the row of its look. −1 stands for the last material."""
    row_of: dict[str, int] = {}
    looks: list[Look] = []
    rows = []
    for material in materials:
        seen = {key: value for key, value in material.gltf.items() if key not in ("name", "extras")}
        key = json.dumps(seen, sort_keys=True, default=str)
        if key not in row_of:
            row_of[key] = len(looks)
            looks.append(_look(material, document, images))
        rows.append(row_of[key])
    return looks, np.array(rows)


def _look(material: Material, document: Mapping[str, Any], images: Textures) -> Look:
    gltf = material.gltf
    extensions: Mapping[str, Any] = gltf.get("extensions", {})
    factor, base = material.base_color_factor, material.base_color_texture
    older: Mapping[str, Any] | None = extensions.get("KHR_materials_pbrSpecularGlossiness")
    if older is not None and "pbrMetallicRoughness" not in gltf:
        factor, base = older.get("diffuseFactor", factor), texture_ref(older.get("diffuseTexture"))
    strength = extensions.get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0)
    emission = np.array(gltf.get("emissiveFactor", (0.0, 0.0, 0.0)), np.float32) * np.float32(strength)
    return Look(
        factor=np.array(factor, np.float32),
        base=_slot(base, document, images),
        normal=_slot(material.normal_texture, document, images, plain=True),
        normal_scale=float(gltf.get("normalTexture", {}).get("scale", 1.0)),
        emission=emission if emission.any() else None,
        emission_map=_slot(texture_ref(gltf.get("emissiveTexture")), document, images) if emission.any() else None,
        alpha_mode=material.alpha_mode,
        cutoff=material.alpha_cutoff,
        double_sided=material.double_sided,
        unlit="KHR_materials_unlit" in extensions,
    )


def _slot(ref: TextureRef | None, document: Mapping[str, Any], images: Textures, plain: bool = False) -> Slot | None:
    """What `ref` means; None where there is no texture, or its image is missing."""
    if ref is None:
        return None
    texture: Mapping[str, Any] = document.get("textures", ())[ref.texture]
    pixels = images.get(image_index(texture), plain)
    if pixels is None:
        return None
    sampler = document["samplers"][texture["sampler"]] if "sampler" in texture else {}
    moved = (ref.offset, ref.scale, ref.rotation) != ((0.0, 0.0), (1.0, 1.0), 0.0)
    return Slot(
        pixels,
        uv_name=f"TEXCOORD_{ref.texcoord}",
        uv_matrix=uv_matrix(ref) if moved else None,
        wrap=(sampler.get("wrapS", REPEAT), sampler.get("wrapT", REPEAT)),
        nearest=sampler.get("magFilter") == NEAREST,
    )


def image_index(texture: Mapping[str, Any]) -> int | None:
    """The image of a glTF texture object: an extension's (WebP, AVIF, …) before the fallback that it stands for."""
    for extension in texture.get("extensions", {}).values():
        if isinstance(extension, Mapping) and "source" in extension:
            return int(extension["source"])
    return int(texture["source"]) if "source" in texture else None
