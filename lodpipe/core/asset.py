"""An asset: meshes, materials, images and everything else that its file said."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.material import Image, Material, MaterialSet, renumbered
from lodpipe.core.mesh import F64, Mesh
from lodpipe.core.skeleton import Importance, Segments, Skeleton


@dataclass(frozen=True, eq=False)
class Accessor:
    """An array of the source file that no stage works on (animation, skin, a point cloud …), carried along.

    `values` has one row an element, in the stored component type; `type` is glTF's (SCALAR, VEC3, MAT4, …).
    """

    values: NDArray[Any]
    type: str
    normalized: bool = False
    gltf: Mapping[str, Any] = field(default_factory=dict)
    """What else the file said of it (name, extras)."""


@dataclass(frozen=True)
class Target:
    """What one level was asked for: exactly one of the four is set.

    ratio      share of the source's triangles, 0 < ratio ≤ 1
    triangles  number of triangles, ≥ 1
    error      largest distance to the source, in % of the source's bounding-box diagonal, ≥ 0
    pixels     with `screen`: at most so many pixels of visible error at that share of the screen's height
    """

    ratio: float | None = None
    triangles: int | None = None
    error: float | None = None
    pixels: float | None = None
    screen: float | None = None


@dataclass(frozen=True)
class ErrorFigures:
    """Distance to the source, both directions, in % of the source's bounding-box diagonal; angle in degrees."""

    mean: float
    rms: float
    max: float
    """Hausdorff distance, of the samples and the vertices."""
    normal_degrees: float | None = None
    """Mean angle between the surface normals at closest points."""

    @property
    def mean_square(self) -> float:
        """E_i of Garland & Heckbert 1997, section 6: the mean squared distance over both directions' samples."""
        return self.rms**2


@dataclass(frozen=True)
class VisualFigures:
    """How different a level looks from the source, over pictures of both from `views` directions; docs/measuring.md.

    A figure that does not exist is None, and `reasons` says why under its name; there it is also said of a figure that
    is only a bound.
    """

    luminance_rms: float
    """Root mean square difference of luma over all pixels, 0…255."""
    psnr: float | None
    """dB, over the pixels that either shows; None for pictures without a difference."""
    ssim: float | None
    """Structural similarity, up to 1 (the same)."""
    ms_ssim: float | None
    """The same over five scales, 0…1."""
    flip: float | None
    """0 (the same) … 1."""
    silhouette_iou: float | None
    """Overlap of the silhouettes, 0…1 (the same)."""
    normal_degrees: float | None
    """Mean angle between the facing normals where both are seen."""
    unseen_height: float | None
    """Pixels that the source's bounding-box diagonal takes up on the screen, up to which no difference of more than a
    pixel is seen."""
    views: int
    size: int
    """Pixels along a side of the pictures."""
    reasons: Mapping[str, str] = field(default_factory=dict)

    def data(self) -> dict[str, Any]:
        """As reports hold it: the reasons stand beside their figures, as ``<figure>_reason``."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "reasons"}
        return values | {f"{name}_reason": reason for name, reason in self.reasons.items()}


@dataclass(frozen=True)
class Switch:
    """Where a level takes over from the finer one before it.

    screen_coverage  share of the screen's height that the model fills, 0…1: the level is used below it
    distance         the same from a camera with a vertical field of view of 60°, in the model's unit
    """

    screen_coverage: float
    distance: float


@dataclass(frozen=True)
class GpuSize:
    """Bytes on a graphics card: vertex buffers, index buffers, and the textures with all their mip levels."""

    vertex_bytes: int
    index_bytes: int
    texture_bytes: int


@dataclass(frozen=True, eq=False)
class Lod:
    """One level: a mesh for each of `Asset.meshes`, what it was asked for, what stopped it, how far off it is."""

    meshes: tuple[Mesh, ...]
    target: Target | None = None
    stop_reason: str = "source"
    estimate: float = 0.0
    """The decimator's own estimate of the deviation, in % of the source's bounding-box diagonal."""
    error: ErrorFigures | None = None
    """Measured; None until a stage has measured it."""
    visual: VisualFigures | None = None
    """The same, of what is seen."""
    switch: Switch | None = None
    """None until a stage has settled it."""
    gpu: GpuSize | None = None
    """None until a stage has counted it."""
    relaxed: bool = False
    """Whether holes or handles had to be given up to reach the target."""
    own: MaterialSet | None = None
    """Materials and textures made for this level, which its meshes' primitives then name; None: the asset's."""

    @property
    def triangles(self) -> int:
        """Triangles stored (a mesh that is placed several times counts once)."""
        return sum(len(mesh.faces) for mesh in self.meshes)

    @property
    def vertices(self) -> int:
        """Vertices stored as a GPU sees them (wedges)."""
        return sum(mesh.wedge_count for mesh in self.meshes)


@dataclass(frozen=True, eq=False)
class Asset:
    """A model as a whole.

    `meshes`, `materials` and `images` are what stages work on. `document` is the rest of the glTF JSON tree
    (scenes, nodes, textures, samplers, skins, animations, cameras, extensions, extras); other formats are read
    into the same form. Its mesh indices are rows of `meshes`, its image indices rows of `images`, and where it
    names an accessor (skins, animations) the number is a row of `accessors`.
    `lods[0]` is the source's level; without levels the tuple is empty.
    """

    name: str
    meshes: tuple[Mesh, ...]
    materials: tuple[Material, ...] = ()
    images: tuple[Image, ...] = ()
    document: Mapping[str, Any] = field(default_factory=dict)
    accessors: tuple[Accessor, ...] = ()
    lods: tuple[Lod, ...] = ()
    skeleton: Skeleton | None = None
    """None until a stage has made it; the same holds for the next two. All three speak of `meshes`."""
    segments: Segments | None = None
    importance: Importance | None = None
    path: Path | None = None
    """The file that it was read from."""
    members: tuple[Path, ...] = ()
    """Every file that was read, the asset's own first (buffers, images, material libraries)."""
    missing: tuple[str, ...] = ()
    """Files that it names and that were not there, relative to its folder: when one turns up, the asset is another."""
    format: str = ""
    """glb, gltf, obj, ply, stl or off."""
    warnings: tuple[str, ...] = ()
    """What the reader repaired, left out or could not find."""

    @property
    def triangles(self) -> int:
        """Triangles stored in `meshes` (a mesh that is placed several times counts once)."""
        return sum(len(mesh.faces) for mesh in self.meshes)

    @property
    def vertices(self) -> int:
        """Vertices stored as a GPU sees them (wedges)."""
        return sum(mesh.wedge_count for mesh in self.meshes)

    def at(self, level: Lod) -> Asset:
        """The asset with `level`'s meshes and materials in the place of its own, and without levels."""
        asset = replace(self, meshes=level.meshes, lods=())
        if level.own is None:
            return asset
        named = {"textures": list(level.own.textures), "samplers": list(level.own.samplers)}
        document = {key: value for key, value in self.document.items() if key not in ("images", *named)}
        return replace(
            asset,
            materials=level.own.materials,
            images=level.own.images,
            document=document | {key: value for key, value in named.items() if value},
        )

    def with_one_material_set(self) -> Asset:
        """The same levels, with the materials and textures of all of them in the asset's own lists: for one file."""
        materials, images = list(self.materials), list(self.images)
        textures, samplers = (list(self.document.get(key, ())) for key in ("textures", "samplers"))
        levels = []
        for level in self.lods:
            own, first = level.own, len(materials)
            if own is not None:
                shift = {"texture": len(textures), "source": len(images), "sampler": len(samplers)}
                materials += [Material(renumbered(dict(m.gltf), shift)) for m in own.materials]
                textures += renumbered(own.textures, shift)
                images += own.images
                samplers += own.samplers
                level = replace(level, meshes=tuple(_shifted(m, first) for m in level.meshes), own=None)
            levels.append(level)
        lists = {"textures": textures, "samplers": samplers}
        document = {**self.document, **{key: value for key, value in lists.items() if value}}
        return replace(self, materials=tuple(materials), images=tuple(images), document=document, lods=tuple(levels))

    def instances(self) -> list[tuple[int, F64]]:
        """(mesh index, 4×4 float64 world matrix) for each placement of a mesh in the default scene.

        A mesh that no node of the scene uses has no entry; a document without scenes places each mesh once.
        """
        nodes: list[Mapping[str, Any]] = list(self.document.get("nodes", ()))
        scenes = self.document.get("scenes", ())
        if not scenes or not nodes:
            return [(i, np.eye(4)) for i in range(len(self.meshes))]
        stack = [(i, np.eye(4)) for i in reversed(scenes[self.document.get("scene", 0)].get("nodes", ()))]
        found = []
        while stack:  # the reader has refused cycles
            index, parent = stack.pop()
            world = parent @ node_matrix(nodes[index])
            if "mesh" in nodes[index]:
                found.append((int(nodes[index]["mesh"]), world))
            stack.extend((child, world) for child in reversed(nodes[index].get("children", ())))
        return found

    def fingerprint(self) -> str:
        """Hex digest of the content (meshes, materials, images, document, skeleton …), for caches and tests."""
        digest = hashlib.sha256()
        for mesh in self.meshes:
            digest.update(mesh.fingerprint().encode())
        for level in self.lods:
            digest.update("".join(mesh.fingerprint() for mesh in level.meshes).encode())
            if level.own is not None:
                digest.update(self.at(level).fingerprint().encode())
        for image in self.images:
            digest.update(image.data + repr((image.name, image.uri, image.problem)).encode())
        for accessor in self.accessors:
            digest.update(np.ascontiguousarray(accessor.values).tobytes())
        for shape in (self.skeleton, self.segments, self.importance):
            digest.update(shape.fingerprint().encode() if shape else b"-")
        tree = [dict(self.document), [dict(m.gltf) for m in self.materials], self.name]
        digest.update(json.dumps(tree, sort_keys=True, default=str).encode())
        return digest.hexdigest()


def _shifted(mesh: Mesh, first: int) -> Mesh:
    """`mesh` with `first` added to the materials of its primitives."""
    moved = tuple(p if p.material is None else replace(p, material=p.material + first) for p in mesh.primitives)
    return replace(mesh, primitives=moved)


def node_matrix(node: Mapping[str, Any]) -> F64:
    """The 4×4 float64 local matrix of a glTF node (matrix, or translation · rotation · scale; column vectors)."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * np.array(node.get("scale", (1.0, 1.0, 1.0)), np.float64)
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix
