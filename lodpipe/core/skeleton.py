"""What is known of an asset's shape: its skeleton, its segments, and which vertices matter. Plain data.

Arrays for each vertex come as one array for each of `Asset.meshes`, with a value for each of the mesh's positions.
Places and lengths are in world space, each mesh in the largest of its placements.
"""

from __future__ import annotations

import dataclasses
import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.mesh import F32, F64, I32

NODE_TYPES = ("end", "connection", "joint", "single")
"""By the number of links: 1, 2, more, none. A node of one link is a joint too if it is the model's whole trunk."""

PARTS = ("main", "branch")
"""Kinds of segments. The main body holds the fattest joint and those joined to it by a trunk about as fat, or all of a
component without joints; a branch leads from a joint to an end, or to another joint."""


@dataclass(frozen=True)
class SkeletonComponent:
    """Figures of one connected component of the surface."""

    cycle_rank: int
    """Independent loops of the skeleton."""
    genus: int | None
    """Handles of the surface; None where it is open or not a manifold."""
    inside_share: float | None
    """Share of the skeleton's length that runs inside the surface, 0…1; None where there is no inside or no length."""
    notes: tuple[str, ...] = ()
    """What could not be done, and why."""


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A curve skeleton: nodes, links between them, and the node and level of every vertex.

    positions     (N, 3) float64
    radius        (N,) float64: distance to the surface across the skeleton
    node_type     (N,) int8, rows of NODE_TYPES
    component     (N,) int32, rows of `components`
    edges         (E, 2) int32, rows of the nodes
    tip           (N,) int32 of `tip_mesh`'s positions, (N,) `tip_mesh`: an end's terminal vertex; −1 for other nodes
    vertex_node   for each mesh (V,) int32: the node in whose domain the vertex lies, −1 where there is none
    vertex_level  for each mesh (V,) int32: the level set that the vertex lies on or after, −1 where there is none
    on_level      for each mesh (V,) bool: whether a level set's curve touches the vertex (the papers' G; the rest is M)
    """

    method: str
    positions: F64
    radius: F64
    node_type: NDArray[np.int8]
    component: I32
    edges: I32
    tip: I32
    tip_mesh: I32
    vertex_node: tuple[I32, ...]
    vertex_level: tuple[I32, ...]
    on_level: tuple[NDArray[np.bool_], ...]
    components: tuple[SkeletonComponent, ...] = ()

    def count(self, node_type: str, component: int | None = None) -> int:
        """Number of nodes of a type, in one component or in all."""
        same = self.node_type == NODE_TYPES.index(node_type)
        return int((same if component is None else same & (self.component == component)).sum())

    def fingerprint(self) -> str:
        """Hex digest of everything in it."""
        return _digest(self)


@dataclass(frozen=True, eq=False)
class Segments:
    """The surface cut into main bodies and branches along the skeleton.

    names           (S) a name for each segment, unique
    kind            (S,) int8, rows of PARTS
    component       (S,) int32, rows of the skeleton's components
    node_segment    (N,) int32: the segment of each node of the skeleton
    vertex_segment  for each mesh (V,) int32, −1 where there is none
    vertex_part     for each mesh (V,) int8, rows of NODE_TYPES, −1 where there is none: joint parts are the main bodies
                    and joints, end parts the outer third of branches that end, connection parts the rest
    border          for each mesh (V,) bool: whether an edge leads to a vertex of another segment
    """

    names: tuple[str, ...]
    kind: NDArray[np.int8]
    component: I32
    node_segment: I32
    vertex_segment: tuple[I32, ...]
    vertex_part: tuple[NDArray[np.int8], ...]
    border: tuple[NDArray[np.bool_], ...]

    def fingerprint(self) -> str:
        """Hex digest of everything in it."""
        return _digest(self)


@dataclass(frozen=True, eq=False)
class PartShare:
    """A part of the asset that keeps a share of its triangles: `faces` for each mesh (F,) bool, 0 < `keep` < 1."""

    name: str
    keep: float
    faces: tuple[NDArray[np.bool_], ...]


@dataclass(frozen=True, eq=False)
class Importance:
    """How much each vertex matters to the decimator.

    weight    for each mesh (V,) float32 > 0: multiplies the vertex's quadric at every budget
    extreme   for each mesh (V,) float32 ≥ 1: what multiplies it too where few triangles are left for each branch
    reserved  (R, 3) int32 rows of `reserved_mesh`'s positions: a triangle for each branch, terminal vertex first, that
              is kept as long as the budget allows; longest branch first. `reserved_mesh` (R,) int32
    pinned    for each mesh (V,) bool: vertices that are neither moved nor removed; empty: none are
    shares    parts that keep a share of their triangles at every level that has room for them
    strength  0: `extreme` and `reserved` have no effect; 1: all; None: they fade in as the budget falls
    """

    weight: tuple[F32, ...]
    extreme: tuple[F32, ...]
    reserved: I32
    reserved_mesh: I32
    strength: float | None = None
    pinned: tuple[NDArray[np.bool_], ...] = ()
    shares: tuple[PartShare, ...] = ()

    def fingerprint(self) -> str:
        """Hex digest of everything in it."""
        return _digest(self)


def _digest(data: Any) -> str:
    digest = hashlib.sha256()
    for field in dataclasses.fields(data):
        value = getattr(data, field.name)
        digest.update(field.name.encode())
        for item in value if isinstance(value, tuple) else (value,):
            if isinstance(item, PartShare):
                digest.update(_digest(item).encode())
            elif isinstance(item, np.ndarray):
                digest.update(f"{item.dtype}{item.shape}".encode() + np.ascontiguousarray(item).tobytes())
            else:
                digest.update(repr(item).encode())
    return digest.hexdigest()
