"""Options of the similarity decimator, and how a mesh looks to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.errors import InvalidMesh
from lodpipe.core.mesh import I32

Metric = Literal["ray", "texture_deviation", "image"]

METRICS: tuple[Metric, ...] = ("ray", "texture_deviation", "image")
WRAPS = ("repeat", "mirror", "clamp")
CHOICES = {
    "metric": METRICS,
    "collapse": ("half", "full"),
    "reference": ("original", "previous"),
    "correspondence": ("uv", "scene"),
    "penalty": ("constant", "view"),
}
"""In the order of the native numbers."""
SIMILARITY_RANGES = {"views": (1, 256), "spacing": (0.05, 100), "image_size": (16, 4096), "flip_degrees": (0, 90)}


@dataclass(frozen=True)
class SimilarityOptions:
    """How the similarity decimator prices and guards collapses; see docs/thesis.md."""

    metric: Metric = "ray"
    """`ray`: Liao 2004, what rays from round the region see. `texture_deviation`: Cohen et al. 1998. `image`:
    Lindstrom & Turk 2000, 20 pictures from round the model."""
    collapse: Literal["half", "full"] = "half"
    """`half` keeps vertices of the input; `full` merges both ends at the place of Garland & Heckbert 1998."""
    reference: Literal["original", "previous"] = "original"
    """What the result is compared with: the input (global cost), or the mesh just before (local cost). `image`
    compares with the input always."""
    correspondence: Literal["scene", "uv"] = "scene"
    """Which triangles of the input a ray can meet: those near the region, or those that have its UVs (one-to-one
    atlas)."""
    views: int = 8
    """Viewpoints on the hemisphere over a region, 1…256."""
    spacing: float = 1.0
    """Of the scan lines, in √(2 · mean area of the input's triangles), 0.05…100."""
    penalty: Literal["constant", "view"] = "constant"
    """What a ray costs that meets one of the two meshes only: its difference to mid grey; or ½ at the horizon up to 1
    at the top of the hemisphere."""
    image_size: int = 256
    """Width and height of the pictures of `image`, 16…4096."""
    flip_degrees: float = 90.0
    """Largest turn of a face's normal in one collapse, 0…90."""
    keep_topology: bool = False
    """Refuse collapses that would change the topology (link condition). Edges of more than two faces are never made."""
    may_relax: bool = True
    """Give both up when the target cannot be reached otherwise."""
    cross_seams: bool = True
    """Let half-edges leave a UV seam; the charts they leave are extended, at the price of what is then seen."""
    keep_last: bool = False
    """Leave the last triangles, whatever the target."""
    record: bool = False
    """Keep the sequence of collapses, from which `rebuild` makes any level between."""


@dataclass(frozen=True)
class Look:
    """What a material looks like: luminance and alpha, 0…1, times its image's at the texture coordinates.

    matrix (2, 3) in rows takes (u, v, 1) of the columns `uv_column` and the next of the values to the image's
    coordinates. Alpha below `cutoff` is not there; without a cutoff alpha blends with mid grey.
    """

    image: int | None = None
    luminance: float = 1.0
    alpha: float = 1.0
    uv_column: int | None = None
    matrix: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    cutoff: float | None = None


@dataclass(frozen=True, eq=False)
class LookImage:
    """texels (H, W, 2) uint8, luminance and alpha, v = 0 at the top; how it goes on beyond its edges (WRAPS)."""

    texels: NDArray[np.uint8]
    wrap: tuple[str, str] = ("repeat", "repeat")
    nearest: bool = False


@dataclass(frozen=True, eq=False)
class Appearance:
    """What a mesh looks like.

    face_look     (F,) int32, rows of `looks`
    shade_column  column of the values from which a unit normal (3), and luminance and alpha of the vertex colour
                  stand; None: smooth normals are the faces', vertices white
    uv_column     column of u, with v after it: for `correspondence`, `texture_deviation` and the placement
    """

    face_look: I32
    looks: Sequence[Look]
    images: Sequence[LookImage] = ()
    shade_column: int | None = None
    uv_column: int | None = None


def native_appearance(
    look: Appearance, options: SimilarityOptions, faces: int, columns: int
) -> tuple[Any, Any, Any, Any, Any, Any]:
    """The appearance as the native functions take it."""
    face_look = np.ascontiguousarray(look.face_look, np.int32)
    if face_look.shape != (faces,):
        raise InvalidMesh(f"face_look must have {faces} values (got the shape {face_look.shape})")
    if faces and not 0 <= int(face_look.min()) <= int(face_look.max()) < len(look.looks):
        raise InvalidMesh(f"face_look points outside the {len(look.looks)} looks")

    def column(start: int | None, width: int, name: str) -> int:
        if start is not None and not 0 <= start <= columns - width:
            raise InvalidMesh(f"{name} {start} needs {width} of the {columns} columns from there on")
        return -1 if start is None else start

    rows = np.zeros((len(look.looks), 11), np.float32)
    for row, one in zip(rows, look.looks, strict=True):
        if one.image is not None and not 0 <= one.image < len(look.images):
            raise InvalidMesh(f"a look names image {one.image} of {len(look.images)}")
        uv = column(one.uv_column, 2, "uv_column of a look")
        image = -1 if one.image is None or uv < 0 else one.image
        row[:] = (image, one.luminance, one.alpha, uv, *one.matrix, -1 if one.cutoff is None else one.cutoff)
    if not np.isfinite(rows).all():
        raise InvalidMesh("looks must be finite")
    images, wraps = [], np.zeros((len(look.images), 3), np.int32)
    for wrap, picture in zip(wraps, look.images, strict=True):
        texels = np.ascontiguousarray(picture.texels, np.uint8)
        if texels.ndim != 3 or texels.shape[2] != 2 or not texels.size:
            raise InvalidMesh(f"texels must have the shape (height, width, 2) (got {texels.shape})")
        images.append(texels)
        wrap[:] = (*(WRAPS.index(mode) for mode in picture.wrap), picture.nearest)
    shade = column(look.shade_column, 5, "shade_column")
    uv = column(look.uv_column, 2, "uv_column")
    if uv < 0 and options.metric == "texture_deviation":
        raise InvalidMesh("texture deviation needs UVs, and there are none")
    if uv < 0 and options.metric == "ray" and (options.reference, options.correspondence) == ("original", "uv"):
        raise InvalidMesh("the correspondence 'uv' needs UVs, and there are none; 'scene' does not")
    return face_look, rows, images, wraps, shade, uv


def native_options(options: SimilarityOptions) -> dict[str, Any]:
    """The options by the native struct's names and numbers; `threads` is left to the caller."""
    for name, allowed in CHOICES.items():
        if getattr(options, name) not in allowed:
            raise InvalidMesh(f"{name} is one of {', '.join(allowed)} (got {getattr(options, name)!r})")
    values: dict[str, Any] = {
        name: CHOICES[name].index(getattr(options, name))
        for name in ("metric", "reference", "correspondence", "penalty")
    }
    values["full"] = options.collapse == "full"
    values["flip_cos"] = float(np.cos(np.radians(options.flip_degrees))) if options.flip_degrees < 90 else 0.0
    plain = ("views", "spacing", "image_size", "keep_topology", "may_relax", "cross_seams", "keep_last", "record")
    return values | {name: getattr(options, name) for name in plain}
