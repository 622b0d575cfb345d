"""Meshes without what hangs on their textures."""

from __future__ import annotations

from dataclasses import replace

from lodpipe.core.asset import Asset, Lod
from lodpipe.core.mesh import Mesh

GONE = ("TEXCOORD_", "COLOR_", "TANGENT")


def without_uvs(asset: Asset, *, normals: bool = False) -> Asset:
    """`asset` whose meshes have neither UVs nor tangents and vertex colours, nor normals unless `normals` says so: no
    seams, borders of materials alone. Meshes with a `keep_reason` stay as they are; its only level is the source."""
    gone = GONE if normals else (*GONE, "NORMAL")
    meshes = tuple(mesh if mesh.keep_reason else _stripped(mesh, gone) for mesh in asset.meshes)
    return replace(asset, meshes=meshes, lods=(Lod(meshes),))


def _stripped(mesh: Mesh, gone: tuple[str, ...]) -> Mesh:
    attributes = {name: values for name, values in mesh.attributes.items() if not name.startswith(gone)}
    primitives = tuple(
        replace(p, attributes=tuple(name for name in p.attributes if name in attributes)) for p in mesh.primitives
    )
    wedges = mesh.wedges if attributes else mesh.faces
    return replace(mesh, wedges=wedges, attributes=attributes, primitives=primitives)
