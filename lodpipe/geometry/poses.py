"""How a mesh moves: the poses that its animations, joints and morph targets put it into.

A vertex that lies still in a flat patch may be the one that an elbow needs. What the decimator has to know of it is how
far each vertex is carried by the poses, beyond what the whole mesh does (Mohr & Gleicher, Deformation sensitive
decimation, 2003, sum the quadrics of sampled poses; here the poses' displacements are attributes of the rest pose, as
in Hoppe 1999, compressed to their principal directions).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.asset import Accessor, Asset, node_matrix
from lodpipe.core.mesh import F32, F64, Mesh

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

POSES = 24
"""At most so many poses are sampled, over all animations."""
SPREAD = 1_500_000
"""Vertices × poses, at most (but no fewer than four poses)."""
COLUMNS = 6
"""Principal directions kept of the poses, and as many of the morph targets."""
ENERGY = 0.98
"""Share of the motion that is enough."""
BEND = np.radians(45)
"""Largest turn of a joint where no animation tells."""

_PATHS = {"translation": 3, "rotation": 4, "scale": 3}
"""What of a node an animation moves, and its number of components."""

Json = Mapping[str, Any]
Locals = dict[int, dict[str, NDArray[Any]]]
"""Of a pose: node -> translation, rotation and scale where they differ from the file's."""


def motion(asset: Asset, row: int, positions: F64) -> F32:
    """How the vertices of a mesh are moved, as attributes of its rest pose.

    row        of `asset.meshes`
    positions  (V, 3) float64: the mesh at rest, in the space in which it is simplified

    Returns (V, K) float32 in the unit of `positions`, K ≤ 2 · COLUMNS: the squared distance of two rows is about the
    mean over the poses of the squared difference of the two displacements, after the affine map that suits all
    vertices best; of T morph targets, the sum over √T of them. K is 0 for a mesh that nothing moves.
    """
    mesh = asset.meshes[row]
    corner = np.zeros(len(mesh.positions), np.int64)
    corner[mesh.faces] = mesh.wedges
    parts = [np.zeros((len(positions), 0), np.float32)]
    node = next((n for n in asset.document.get("nodes", ()) if n.get("mesh") == row and "skin" in n), None)
    if node is not None and "JOINTS_0" in mesh.attributes:
        parts.append(_skinned(asset, mesh, asset.document["skins"][node["skin"]], corner, positions))
    names = [n for n in mesh.attributes if n.startswith("MORPH_") and n.endswith("_POSITION")]
    if names:
        deltas = [mesh.attributes[name][corner] for name in names]
        parts.append(_principal(_in_space(np.stack(deltas, 1), mesh.positions, positions), len(names) ** -0.25))
    return np.concatenate(parts, axis=1)


def _skinned(asset: Asset, mesh: Mesh, skin: Json, corner: NDArray[Any], positions: F64) -> F32:
    joints: list[int] = skin["joints"]
    bones = Bones.of(asset.document["nodes"], joints)
    inverse = np.tile(np.eye(4), (len(joints), 1, 1))
    if "inverseBindMatrices" in skin:
        said = asset.accessors[skin["inverseBindMatrices"]].values.reshape(-1, 4, 4)[: len(joints)]
        inverse[: len(said)] = said.swapaxes(1, 2)
    weights = skin_weights(mesh, corner, len(joints))
    count = int(np.clip(SPREAD // max(len(positions), 1), 4, POSES))
    home = np.column_stack([positions, np.ones(len(positions))])
    normal = np.linalg.pinv(np.einsum("vi,vj->ij", home, home))
    rest = np.column_stack([mesh.positions, np.ones(len(positions))])
    moved = np.empty((len(positions), 0, 3), np.float32)
    fields = []
    for pose in _poses(asset, bones, count):
        matrices = bones.matrices(pose) @ inverse
        blended = (weights @ matrices[:, :3].reshape(len(joints), 12)).reshape(-1, 3, 4)
        posed = np.einsum("vij,vj->vi", blended, rest)
        affine = normal @ np.einsum("vi,vj->ij", home, posed)
        size = abs(np.linalg.det(affine[:3])) ** (1 / 3)
        if np.isfinite(posed).all() and size > 1e-12:
            fields.append(((posed - home @ affine) / size).astype(np.float32))
    if fields:
        moved = np.stack(fields, axis=1)
    return _principal(moved, max(len(fields), 1) ** -0.5)


def skin_weights(mesh: Mesh, corner: NDArray[Any], joints: int) -> csr_matrix:
    """(V, joints) float64: the weights of the vertices, whose wedges are `corner` (V,)."""
    sets = [n for n in range(8) if f"JOINTS_{n}" in mesh.attributes and f"WEIGHTS_{n}" in mesh.attributes]
    index = np.concatenate([mesh.attributes[f"JOINTS_{n}"][corner] for n in sets], axis=1).astype(np.int64)
    weight = np.concatenate([mesh.attributes[f"WEIGHTS_{n}"][corner] for n in sets], axis=1).astype(np.float64)
    rows = np.repeat(np.arange(len(corner)), index.shape[1])
    inside = index.ravel() < joints
    entries = (weight.ravel()[inside], (rows[inside], index.ravel()[inside]))
    from scipy.sparse import csr_matrix  # takes as long to load as a small model to process

    return csr_matrix(entries, shape=(len(corner), joints))


def _in_space(deltas: F32, own: F64, positions: F64) -> F32:
    """Displacements (V, N, 3) of a mesh in the space of `positions`, by the affine map that leads there."""
    home = np.column_stack([own, np.ones(len(own))])
    affine = np.linalg.pinv(np.einsum("vi,vj->ij", home, home)) @ np.einsum("vi,vj->ij", home, positions)
    placed: F32 = (deltas.astype(np.float64) @ affine[:3]).astype(np.float32)
    return placed


def _principal(fields: F32, scale: float) -> F32:
    """Fields (V, N, 3) by their principal directions (V, K), from evenly spread vertices, times `scale`."""
    flat = fields.reshape(len(fields), -1)
    if not flat.size or not np.abs(flat).max() > 0:
        return np.zeros((len(fields), 0), np.float32)
    some = flat[np.linspace(0, len(flat) - 1, min(len(flat), 4096)).astype(np.int64)].astype(np.float64)
    values, vectors = np.linalg.eigh(np.einsum("vi,vj->ij", some, some))
    share = np.cumsum(values[::-1]) / max(values.sum(), 1e-300)
    kept = min(int(np.searchsorted(share, ENERGY)) + 1, COLUMNS, flat.shape[1])
    columns = flat @ (vectors[:, ::-1][:, :kept] * scale).astype(np.float32)
    step = np.float32(2.0**-16 * np.abs(columns).max())  # the last bits may depend on the machine's linear algebra
    rounded: F32 = (np.rint(columns / step) * step).astype(np.float32) if step > 0 else columns[:, :0]
    return rounded


@dataclass(frozen=True)
class Bones:
    """The joints of a skin and the nodes above them."""

    nodes: Sequence[Json]
    joints: Sequence[int]
    parent: dict[int, int]
    """Of each of them, parents first; −1 for a root."""

    @staticmethod
    def of(nodes: Sequence[Json], joints: Sequence[int]) -> Bones:
        above = {child: i for i, node in enumerate(nodes) for child in node.get("children", ())}
        parent: dict[int, int] = {}
        for joint in joints:
            chain = [joint]
            while chain[-1] not in parent and chain[-1] in above:
                chain.append(above[chain[-1]])
            for node in reversed(chain):
                parent.setdefault(node, above.get(node, -1))
        return Bones(nodes, joints, parent)

    def matrices(self, pose: Locals) -> F64:
        """The joints' world matrices (J, 4, 4) in a pose."""
        world = {-1: np.eye(4)}
        for index, above in self.parent.items():
            node = self.nodes[index]
            if index in pose:
                node = {**{key: value for key, value in node.items() if key != "matrix"}, **pose[index]}
            world[index] = world[above] @ node_matrix(node)
        return np.stack([world[joint] for joint in self.joints])


def _poses(asset: Asset, bones: Bones, count: int) -> list[Locals]:
    """Up to `count` poses of the joints: of the animations that move them or, if there is none, of bent joints."""
    poses = []
    moving = [a for a in asset.document.get("animations", ()) if _moves(a, bones)]
    for animation in moving[:: max(-(-len(moving) // count), 1)]:
        each = max(count // len(moving), 1)
        end = max(float(asset.accessors[s["input"]].values.max(initial=0)) for s in animation["samplers"])
        for time in (np.arange(each) + 0.5) / each * end:
            poses.append(_sampled(asset.accessors, animation, float(time)))
    return poses or _bent(bones, count)


def _moves(animation: Json, bones: Bones) -> bool:
    return any(c["target"].get("node") in bones.parent and c["target"]["path"] in _PATHS for c in animation["channels"])


def _bent(bones: Bones, count: int) -> list[Locals]:
    """Poses in which every joint is turned about an axis of its own, by up to BEND."""
    random = np.random.default_rng(0)
    nodes = bones.nodes
    poses: list[Locals] = []
    for _ in range(count):
        pose: Locals = {}
        for joint in bones.joints:
            axis = random.normal(size=3)
            half = random.uniform(-BEND, BEND) / 2
            turn = np.append(np.sin(half) * axis / np.linalg.norm(axis), np.cos(half))
            if "matrix" not in nodes[joint]:
                pose[joint] = {"rotation": _product(np.array(nodes[joint].get("rotation", (0, 0, 0, 1.0))), turn)}
        poses.append(pose)
    return poses


def _product(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    """Of two quaternions (x, y, z, w): first b, then a."""
    vector = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.append(vector, a[3] * b[3] - a[:3] @ b[:3])


def _sampled(accessors: Sequence[Accessor], animation: Json, time: float) -> Locals:
    """An animation at a time in seconds (glTF 2.0, section 3.11 and appendix C)."""
    pose: Locals = {}
    for channel in animation["channels"]:
        node, path = channel["target"].get("node"), channel["target"]["path"]
        if node is None or path not in _PATHS:
            continue
        sampler = animation["samplers"][channel["sampler"]]
        times = accessors[sampler["input"]].values.astype(np.float64).ravel()
        values = _floats(accessors[sampler["output"]])
        how = sampler.get("interpolation", "LINEAR")
        if len(times) and values.size == len(times) * _PATHS[path] * (3 if how == "CUBICSPLINE" else 1):
            pose.setdefault(node, {})[path] = _interpolated(times, values, time, how, path)
    return pose


def _floats(accessor: Accessor) -> F64:
    values = accessor.values.astype(np.float64)
    if accessor.values.dtype.kind in "iu" and accessor.normalized:
        return np.maximum(values / np.iinfo(accessor.values.dtype).max, -1.0)
    return values


def _interpolated(times: F64, values: F64, time: float, how: str, path: str) -> NDArray[Any]:
    spline = how == "CUBICSPLINE"
    keys = values.reshape(len(times), 3, -1) if spline else values.reshape(len(times), 1, -1)
    after = int(np.clip(np.searchsorted(times, time, side="right"), 1, max(len(times) - 1, 1)))
    before = after - 1
    if len(times) == 1 or time <= times[before]:
        result = keys[before, 1 if spline else 0]
    elif time >= times[after]:
        result = keys[after, 1 if spline else 0]
    elif how == "STEP":
        result = keys[before, 0]
    else:
        span = times[after] - times[before]
        t = (time - times[before]) / span
        if spline:
            a, b = keys[before], keys[after]
            result = (2 * t**3 - 3 * t**2 + 1) * a[1] + (t**3 - 2 * t**2 + t) * span * a[2]
            result = result + (3 * t**2 - 2 * t**3) * b[1] + (t**3 - t**2) * span * b[0]
        else:
            a, b = keys[before, 0], keys[after, 0]
            if path == "rotation" and a @ b < 0:
                b = -b
            result = (1 - t) * a + t * b  # of close quaternions, as good as the arc between them once it is normalized
    if path == "rotation":
        length = np.linalg.norm(result)
        result = result / length if length > 1e-12 else np.array([0.0, 0.0, 0.0, 1.0])
    return np.asarray(result)
