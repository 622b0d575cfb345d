"""What an asset looks like, as the similarity decimator reads it, and its run over the asset's joined meshes.

The kernel works on luminance alone: of textures, factors and vertex colours, each from its sRGB-encoded values by the
weights of Rec. 601, multiplied. That product is exact for greys and whites, and near for the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from lodpipe import kernel
from lodpipe.core.asset import Asset
from lodpipe.core.errors import InvalidMesh
from lodpipe.core.material import Material
from lodpipe.core.mesh import F32, F64, I32
from lodpipe.geometry.flatten import turned_normals
from lodpipe.geometry.normals import crease_normals
from lodpipe.geometry.surface import image_index
from lodpipe.geometry.texture import CLAMP, MIRROR, NEAREST, REPEAT, U8, to_srgb, uv_matrix
from lodpipe.kernel import Similarity
from lodpipe.kernel.similarity import Appearance, Look, LookImage, SimilarityOptions

if TYPE_CHECKING:
    from lodpipe.geometry.joined import Joined

LUMA = np.array([0.299, 0.587, 0.114])
"""Rec. 601: luminance of R, G and B."""
SHADE_COLUMNS = 5
"""Columns that the kernel is given besides the attributes: a normal in world space, luminance and alpha."""
WRAPS = {REPEAT: "repeat", MIRROR: "mirror", CLAMP: "clamp"}


@dataclass(frozen=True, eq=False)
class Dressed:
    """Joined meshes with their looks.

    values          (W, K + 5) float32: the attributes, then the SHADE_COLUMNS
    column_weights  K + 5: what UVs are worth in the placement of full-edge collapses
    turned          (F,) bool: faces that are wound the other way round, because their mesh is mirrored
    """

    values: F32
    column_weights: list[float]
    faces: I32
    wedges: I32
    turned: Any
    appearance: Appearance


def decimate_joined(
    asset: Asset,
    joined: Joined,
    targets: list[int],
    options: SimilarityOptions,
    pixels: Mapping[int, U8],
    threads: int,
    progress: Callable[[int, int], bool],
) -> Similarity:
    """All levels of the joined meshes; `pixels` holds the decoded images by their row, those that could be."""
    dressed = dress(asset, joined, pixels)
    needs_uv = options.metric == "texture_deviation" or (
        options.metric == "ray" and (options.reference, options.correspondence) == ("original", "uv")
    )
    if needs_uv:
        _require_uvs(asset, joined, options)
    result = kernel.similarity_decimate(
        joined.positions,
        dressed.faces,
        targets,
        dressed.appearance,
        options,
        wedges=dressed.wedges,
        values=dressed.values,
        column_weights=dressed.column_weights,
        importance=joined.importance,
        threads=threads,
        progress=progress,
    )
    levels = []
    for level in result.levels:
        back = dressed.turned[level.face_source]
        faces, wedges = level.faces.copy(), level.wedges.copy()
        faces[back], wedges[back] = faces[back, ::-1], wedges[back, ::-1]
        levels.append(replace(level, faces=faces, wedges=wedges))
    record = result.record
    if record is not None:  # as `rebuild` takes it: of the attributes alone
        record = replace(record, wedge_values=record.wedge_values[:, : joined.values.shape[1]])
    return replace(result, levels=levels, record=record)


def dress(asset: Asset, joined: Joined, pixels: Mapping[int, U8]) -> Dressed:
    """What the joined meshes look like. An image that `pixels` lacks is left out: its factor colour stands in."""
    starts = dict(zip(joined.names, np.cumsum([0, *joined.widths[:-1]]).tolist(), strict=True)) if joined.names else {}
    rows = len(joined.values)
    shade = np.zeros((rows, SHADE_COLUMNS), np.float32)
    shade[:, 3:] = 1.0
    faces, wedges = joined.faces.copy(), joined.wedges.copy()
    turned = np.zeros(len(faces), bool)
    face_look = np.zeros(len(faces), np.int32)
    looks: list[Look] = []
    known: dict[tuple[int | None, frozenset[str]], int] = {}
    images: list[LookImage] = []
    used: dict[tuple[Any, ...], int] = {}
    for number, index in enumerate(joined.used):
        mesh, matrix = asset.meshes[index], joined.matrices[number]
        part = slice(joined.face_start[number], joined.face_start[number + 1])
        if np.linalg.det(matrix[:3, :3]) < 0:
            turned[part] = True
        primitive_look = []
        for primitive in mesh.primitives:
            key = (primitive.material, frozenset(primitive.attributes))
            if key not in known:
                known_material = primitive.material is not None and primitive.material < len(asset.materials)
                material = asset.materials[primitive.material or 0] if known_material else Material()
                known[key] = len(looks)
                looks.append(_look(asset, material, primitive.attributes, starts, pixels, images, used))
            primitive_look.append(known[key])
        face_look[part] = np.array(primitive_look, np.int32)[mesh.face_primitive]
        for row, primitive in enumerate(mesh.primitives):
            own = np.unique(joined.wedges[part][mesh.face_primitive == row])
            if "NORMAL" in primitive.attributes and "NORMAL" in starts:
                at = starts["NORMAL"]
                shade[own, :3] = turned_normals(joined.values[own, at : at + 3], matrix)
            if "COLOR_0" in primitive.attributes and "COLOR_0" in starts:
                width = mesh.attributes["COLOR_0"].shape[1]
                at = starts["COLOR_0"]
                colour = np.clip(joined.values[own, at : at + width], 0, 1)
                shade[own, 3] = to_srgb(colour[:, :3]) @ LUMA
                shade[own, 4] = colour[:, 3] if width > 3 else 1.0
    faces[turned], wedges[turned] = faces[turned, ::-1], wedges[turned, ::-1]
    _fill_normals(joined.positions, faces, wedges, shade)
    uv = starts.get("TEXCOORD_0")
    weights = [0.0] * (joined.values.shape[1] + SHADE_COLUMNS)
    if uv is not None:
        weights[uv] = weights[uv + 1] = _uv_worth(
            joined.positions, joined.faces, joined.values[joined.wedges, uv : uv + 2]
        )
    return Dressed(
        values=np.concatenate([joined.values, shade], axis=1),
        column_weights=weights,
        faces=faces,
        wedges=wedges,
        turned=turned,
        appearance=Appearance(face_look, looks, images, joined.values.shape[1], uv),
    )


def luminance_image(pixels: U8) -> U8:
    """(H, W, 2) uint8: luminance and alpha of an image (H, W, 1…4) with sRGB values."""
    channels = pixels.shape[2]
    texels = np.full((*pixels.shape[:2], 2), 255, np.uint8)
    texels[..., 0] = pixels[..., 0] if channels < 3 else np.rint(pixels[..., :3] @ LUMA.astype(np.float32))
    if channels in (2, 4):
        texels[..., 1] = pixels[..., -1]
    return texels


def _look(
    asset: Asset,
    material: Material,
    attributes: tuple[str, ...],
    starts: Mapping[str, int],
    pixels: Mapping[int, U8],
    images: list[LookImage],
    used: dict[tuple[Any, ...], int],
) -> Look:
    factor = np.array(material.base_color_factor)
    look = Look(
        luminance=float(to_srgb(factor[:3]) @ LUMA),
        alpha=1.0 if material.alpha_mode == "OPAQUE" else float(factor[3]),
        cutoff=material.alpha_cutoff if material.alpha_mode == "MASK" else None,
    )
    ref = material.base_color_texture
    name = "" if ref is None else f"TEXCOORD_{ref.texcoord}"
    if ref is None or name not in attributes or name not in starts:
        return look
    texture = asset.document["textures"][ref.texture]
    image = image_index(texture)
    if image is None or image not in pixels:
        return look
    sampler = asset.document["samplers"][texture["sampler"]] if "sampler" in texture else {}
    wrap = WRAPS[sampler.get("wrapS", REPEAT)], WRAPS[sampler.get("wrapT", REPEAT)]
    nearest = sampler.get("magFilter") == NEAREST
    opaque = material.alpha_mode == "OPAQUE"
    key = (image, wrap, nearest, opaque)
    if key not in used:
        texels = luminance_image(pixels[image])
        if opaque:
            texels[..., 1] = 255
        used[key] = len(images)
        images.append(LookImage(texels, wrap, nearest))
    matrix = tuple(float(x) for x in uv_matrix(ref).ravel())
    return replace(look, image=used[key], uv_column=starts[name], matrix=matrix)


def _fill_normals(positions: F64, faces: I32, wedges: I32, shade: F32) -> None:
    """Smooth normals, but for creases, from the triangles where there are none."""
    if not len(faces) or shade[wedges, :3].any(axis=2).all():
        return
    corners = crease_normals(positions, faces).reshape(-1, 3)
    sums = np.stack([np.bincount(wedges.ravel(), corners[:, k], minlength=len(shade)) for k in range(3)], axis=1)
    length = np.linalg.norm(sums, axis=1)
    missing = ~shade[:, :3].any(axis=1) & (length > 0)
    shade[missing, :3] = sums[missing] / length[missing, None]


def _uv_worth(positions: F64, faces: I32, uv: F32) -> float:
    """Object units that a unit of UV is worth in GH98's five dimensions.

    The paper scales the model to the unit cube, where UVs lie too. Tiled UVs cover less of the surface a unit: they
    are worth what they are long.
    """
    if not len(faces):
        return 0.0
    corners, flat = positions[faces], uv.astype(np.float64)
    side = float((corners.max(axis=(0, 1)) - corners.min(axis=(0, 1))).max())
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    a, b = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    covered = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    has = covered > 0
    if not has.any():
        return 0.0
    worth = min(side, float(np.sqrt(area[has].sum() / covered[has].sum())))
    return worth if np.isfinite(worth) else 0.0


def _require_uvs(asset: Asset, joined: Joined, options: SimilarityOptions) -> None:
    for index in joined.used:
        mesh = asset.meshes[index]
        if any("TEXCOORD_0" not in primitive.attributes for primitive in mesh.primitives):
            what = "metric: texture_deviation" if options.metric == "texture_deviation" else "correspondence: uv"
            raise InvalidMesh(
                f"{what} needs UVs, and mesh '{mesh.name}' has none",
                advice="repair the UVs first, or choose metric: ray with correspondence: scene",
            )
