"""Tiny meshes with an appearance, as the similarity decimator takes them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lodpipe.kernel.similarity import Appearance, Look, LookImage
from meshes import Textured, bumpy, grid, seam_cylinder, terrain, uv_sphere


@dataclass(frozen=True)
class DressedMesh:
    """Positions, faces and what else the kernel's functions take by name."""

    positions: Any
    faces: Any
    appearance: Appearance
    arrays: dict[str, Any] = field(default_factory=dict)


def noise(size: int = 8, seed: int = 1, alpha: bool = False) -> LookImage:
    """Random smooth texels: nowhere flat, nowhere equal."""
    rng = np.random.default_rng(seed)
    texels = np.full((size, size, 2), 255, np.uint8)
    texels[..., 0] = rng.integers(60, 190, (size, size))
    if alpha:
        texels[..., 1] = rng.integers(0, 256, (size, size))
    return LookImage(texels)


def plain(positions, faces) -> DressedMesh:
    """White, lit by the faces' own normals."""
    return DressedMesh(positions, faces, Appearance(np.zeros(len(faces), np.int32), [Look()]))


def textured(mesh: Textured, image: LookImage | None = None, **look: Any) -> DressedMesh:
    """TEXCOORD_0 and NORMAL of the mesh (radial normals where it has none), an image for each primitive."""
    uv = mesh.attributes["TEXCOORD_0"]
    normal = mesh.attributes.get("NORMAL")
    if normal is None:
        at = np.empty((len(uv), 3))
        at[mesh.wedges] = mesh.positions[mesh.faces]
        normal = at / np.linalg.norm(at, axis=1, keepdims=True)
    rng = np.random.default_rng(7)
    tint = np.stack([rng.uniform(0.5, 1, len(uv)), np.ones(len(uv))], axis=1)
    values = np.concatenate([uv, normal, tint], axis=1).astype(np.float32)
    count = int(mesh.face_primitive.max(initial=0)) + 1
    images = [image or noise(seed=k) for k in range(count)]
    looks = [Look(image=k, luminance=0.9, uv_column=0, **look) for k in range(count)]
    appearance = Appearance(mesh.face_primitive, looks, images, shade_column=2, uv_column=0)
    weights = [0.3, 0.3, 0, 0, 0, 0, 0]
    return DressedMesh(
        mesh.positions, mesh.faces, appearance, {"wedges": mesh.wedges, "values": values, "column_weights": weights}
    )


def dented(mesh: Textured, height: float = 0.1, seed: int = 3) -> Textured:
    """The mesh with its vertices at random distances from the origin."""
    factor = 1 + height * np.random.default_rng(seed).random((len(mesh.positions), 1))
    return Textured(mesh.positions * factor, mesh.faces, mesh.wedges, mesh.attributes, mesh.face_primitive)


def sheet(n: int = 4) -> DressedMesh:
    """A hilly open patch, its UVs one to one."""
    positions, faces = terrain(n, 0.3)
    positions = positions + 0.03 * np.random.default_rng(5).normal(size=positions.shape)
    uv = grid(n)[0][:, :2].astype(np.float32)
    return textured(Textured(positions, faces, faces, {"TEXCOORD_0": uv}, np.zeros(len(faces), np.int32)))


def small() -> dict[str, DressedMesh]:
    """By name: everything that costs have to cope with."""
    return {
        "plain": plain(*bumpy(1, 0.4)),
        "ball": textured(dented(uv_sphere(4, 6))),
        "two materials": textured(dented(uv_sphere(4, 6, materials=2)), cutoff=None),
        "tube": textured(dented(seam_cylinder(7, 3))),
        "sheet": sheet(),
        "lace": textured(dented(uv_sphere(4, 6)), noise(alpha=True), cutoff=0.4),
        "glass": textured(dented(uv_sphere(4, 6)), noise(alpha=True), alpha=0.8),
    }
