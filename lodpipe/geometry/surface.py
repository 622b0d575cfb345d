"""What a ray sees where it meets a model: colour, opacity and normal, from materials, textures and attributes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.asset import Asset
from lodpipe.core.material import Material, TextureRef
from lodpipe.core.mesh import F32, F64, I32, Mesh
from lodpipe.geometry.camera import bounding_sphere
from lodpipe.geometry.flatten import Soup, flatten
from lodpipe.geometry.normals import crease_normals, face_normals
from lodpipe.geometry.texture import NEAREST, REPEAT, Texture, Textures, uv_matrix

CREASE = 60.0
"""Degrees between faces from which an edge without normals of its own looks sharp."""


@dataclass(frozen=True)
class Look:
    """A material as the renderer reads it."""

    factor: F32
    """Linear RGBA (4,)."""
    texture: Texture | None = None
    uv_name: str = "TEXCOORD_0"
    uv_matrix: F64 | None = None
    """(2, 3), see `uv_matrix`."""
    wrap: tuple[int, int] = (REPEAT, REPEAT)
    nearest: bool = False
    alpha_mode: str = "OPAQUE"
    cutoff: float = 0.5
    double_sided: bool = False
    unlit: bool = False


@dataclass(frozen=True)
class Spots:
    """N places on a model's surface that rays have met.

    faces (N,) int32, weights (N, 3) float32 barycentric, directions (N, 3) float32 of the rays, and pixel (N,)
    float32: a pixel's width there, in radii of the model.
    """

    faces: I32
    weights: F32
    directions: F32
    pixel: F32

    def take(self, rows: NDArray[np.int64]) -> Spots:
        """The spots of `rows`."""
        return Spots(self.faces[rows], self.weights[rows], self.directions[rows], self.pixel[rows])


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
        from lodpipe.o3d import RayScene

        self.soup: Soup = flatten(asset, meshes)
        self.centre, self.radius = bounding_sphere(self.soup)
        self.positions: F32 = ((self.soup.positions - self.centre) / self.radius).astype(np.float32)
        self.faces = self.soup.faces
        self.rays = RayScene(self.positions, self.faces, threads)
        images = Textures() if textures is None else textures
        self.looks = [_look(material, asset.document, images) for material in (*asset.materials, Material())]

    def corners(self, faces: I32) -> F32:
        """(N, 3, 3) float32: the corners of `faces`, about the origin and in radii."""
        return self.positions[self.faces[faces]]

    def geometric_normals(self, faces: I32) -> F32:
        """(N, 3) float32 unit normals of the triangles `faces`."""
        return self._face_normals[faces]

    def shading_normals(self, spots: Spots, own: bool = True) -> F32:
        """(N, 3) float32 unit normals on the viewer's side of the triangles.

        The file's where a face has them, else from the triangles, smooth but for creases; `own` = False: all from
        the triangles.
        """
        given = self._attribute("NORMAL") if own else None
        if given is None:
            corners = self._creased[spots.faces]
        else:
            values, has = given
            corners = values[self.soup.wedges[spots.faces]]
            missing = ~has[spots.faces] | ~np.all(np.any(corners, axis=2), axis=1)
            if missing.any():
                corners[missing] = self._creased[spots.faces[missing]]
        normals = _blend(corners, spots.weights)
        length = np.sqrt(np.einsum("nd,nd->n", normals, normals))
        flat = self.geometric_normals(spots.faces)
        normals = np.where(length[:, None] > 1e-6, normals / np.maximum(length, 1e-6)[:, None], flat)
        # the side of the triangle that is seen decides: a smooth normal may look past the silhouette
        seen_from_behind = np.einsum("nd,nd->n", flat, spots.directions) > 0
        against = np.einsum("nd,nd->n", normals, flat) < 0
        normals[seen_from_behind != against] *= -1
        return normals

    def colours(self, spots: Spots, only_alpha: bool = False, cull: bool = False) -> F32:
        """(N, 4) float32: linear base colour, and how much of it covers what lies behind.

        Alpha is 1 for an opaque material, 0 or 1 for a masked one, and 0 on the back of single-sided faces if
        `cull`. `only_alpha` saves the look-ups of opaque materials, whose colour is then undefined.
        """
        rgba = np.ones((len(spots.faces), 4), np.float32)
        material = self.soup.face_material[spots.faces]
        for index in np.unique(material):
            rows = np.flatnonzero(material == index)
            look = self.looks[index]  # the default material, −1, is the last
            if look.alpha_mode != "OPAQUE" or not only_alpha:
                rgba[rows] = self._base_colour(look, spots.take(rows))
            if look.alpha_mode == "OPAQUE":
                rgba[rows, 3] = 1.0
            elif look.alpha_mode == "MASK":
                rgba[rows, 3] = rgba[rows, 3] >= look.cutoff
            if cull and not look.double_sided:
                towards = np.einsum("nd,nd->n", self.geometric_normals(spots.faces[rows]), spots.directions[rows])
                rgba[rows[towards > 0], 3] = 0.0
        return rgba

    def unlit(self, spots: Spots) -> NDArray[np.bool_]:
        """(N,) bool: whether the material asks for its colour without light (KHR_materials_unlit)."""
        return np.array([look.unlit for look in self.looks])[self.soup.face_material[spots.faces]]

    def _base_colour(self, look: Look, spots: Spots) -> F32:
        rgba = np.broadcast_to(look.factor, (len(spots.faces), 4)).copy()
        coordinates = self._attribute(look.uv_name) if look.texture is not None else None
        if look.texture is not None and coordinates is not None:
            values, has = coordinates
            corners = values[self.soup.wedges[spots.faces]][:, :, :2]
            if look.uv_matrix is not None:
                corners = (corners @ look.uv_matrix[:, :2].T + look.uv_matrix[:, 2]).astype(np.float32)
            texels = self._footprint(look.texture, corners, spots)
            uv = _blend(corners, spots.weights)
            with_uv = has[spots.faces]
            seen = look.texture.sample(uv, texels, look.wrap, look.nearest)
            rgba *= np.where(with_uv[:, None], seen, np.float32(1.0))
        colours = self._attribute("COLOR_0")
        if colours is not None:
            values, has = colours
            blended = _blend(values[self.soup.wedges[spots.faces]], spots.weights)
            blended[~has[spots.faces]] = 1.0
            rgba[:, : blended.shape[1]] *= np.clip(blended, 0.0, 1.0)
        return rgba

    def _footprint(self, texture: Texture, uv: F32, spots: Spots) -> F32:
        """(N,) float32: a pixel's width on the texture, in texels, the mean over its directions."""
        across = (uv[:, 1:] - uv[:, :1]) * np.array([texture.width, texture.height], np.float32)
        texels = np.abs(across[:, 0, 0] * across[:, 1, 1] - across[:, 0, 1] * across[:, 1, 0])
        corners = self.corners(spots.faces)
        edges = corners[:, 1:] - corners[:, :1]
        normals = np.cross(edges[:, 0], edges[:, 1])
        # the area that the face shows to the ray: its own, times the cosine, which may not vanish
        seen = np.abs(np.einsum("nd,nd->n", normals, spots.directions))
        area = np.maximum(seen, 0.05 * np.sqrt(np.einsum("nd,nd->n", normals, normals)))
        footprint: F32 = spots.pixel * np.sqrt(texels / np.maximum(area, np.float32(1e-30)))
        return footprint

    def _attribute(self, name: str) -> tuple[F32, NDArray[np.bool_]] | None:
        if name not in self._attributes:
            self._attributes[name] = self.soup.attribute(name)
        return self._attributes[name]

    @cached_property
    def _attributes(self) -> dict[str, tuple[F32, NDArray[np.bool_]] | None]:
        return {}

    @cached_property
    def _face_normals(self) -> F32:
        return face_normals(self.positions, self.faces).astype(np.float32)

    @cached_property
    def _creased(self) -> F32:
        return crease_normals(self.positions, self.faces, CREASE)


def _look(material: Material, document: Mapping[str, Any], images: Textures) -> Look:
    factor = np.array(material.base_color_factor, np.float32)
    ref = material.base_color_texture
    texture, sampler = (None, {}) if ref is None else _texture(ref, document, images)
    moved = ref is not None and (ref.offset, ref.scale, ref.rotation) != ((0.0, 0.0), (1.0, 1.0), 0.0)
    return Look(
        factor=factor,
        texture=texture,
        uv_name=f"TEXCOORD_{0 if ref is None else ref.texcoord}",
        uv_matrix=uv_matrix(ref) if ref is not None and moved else None,
        wrap=(sampler.get("wrapS", REPEAT), sampler.get("wrapT", REPEAT)),
        nearest=sampler.get("magFilter") == NEAREST,
        alpha_mode=material.alpha_mode,
        cutoff=material.alpha_cutoff,
        double_sided=material.double_sided,
        unlit="KHR_materials_unlit" in material.gltf.get("extensions", {}),
    )


def _texture(
    ref: TextureRef, document: Mapping[str, Any], images: Textures
) -> tuple[Texture | None, Mapping[str, Any]]:
    """The texture that `ref` means and its sampler's settings."""
    texture: Mapping[str, Any] = document.get("textures", ())[ref.texture]
    image = image_index(texture)
    sampler = document["samplers"][texture["sampler"]] if "sampler" in texture else {}
    return (None if image is None else images.get(image)), sampler


def image_index(texture: Mapping[str, Any]) -> int | None:
    """The image of a glTF texture object: an extension's (WebP, AVIF, …) before the fallback that it stands for."""
    for extension in texture.get("extensions", {}).values():
        if isinstance(extension, Mapping) and "source" in extension:
            return int(extension["source"])
    return int(texture["source"]) if "source" in texture else None


def _blend(corners: F32, weights: F32) -> F32:
    """(N, K): values at three corners (N, 3, K), weighted (N, 3)."""
    blended: F32 = corners[:, 0] * weights[:, :1] + corners[:, 1] * weights[:, 1:2] + corners[:, 2] * weights[:, 2:3]
    return blended
