"""Which vertices matter: from the skeleton and its segments, curvature, visibility and painted colours.

After the NSC report on perception-oriented metrics (P-QEM): region borders, terminal vertices of branches [C],
reservation triangles [D], volumetric points [E]. All view-independent: directions stand in for a viewer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lodpipe.core.asset import Asset
from lodpipe.core.errors import InvalidMesh
from lodpipe.core.mesh import F32, F64, Mesh
from lodpipe.core.skeleton import NODE_TYPES, PARTS, Importance, PartShare, Segments, Skeleton
from lodpipe.geometry.camera import views
from lodpipe.geometry.flatten import Soup, flatten_once
from lodpipe.geometry.parts import Bool, PartRule, part

BORDER, VOLUME, TERMINAL = 3.0, 10.0, 100.0
"""What multiplies the quadrics of vertices on borders of segments, of volumetric points, and of terminal vertices."""
DIRECTIONS = 14
"""From which joints are looked at, where no cameras are given."""
LEAST, MOST = 1e-2, 1e2
"""Bounds of a painted weight: 100 ** (red − blue)."""
SALIENCY_LEVELS = (2, 3, 4, 5, 6)
"""Scales of saliency in units of 0.3 % of the diagonal (Lee, Varshney & Jacobs 2005, section 3)."""


@dataclass(frozen=True)
class ImportanceOptions:
    """What counts, and how much; 0 leaves a part out."""

    strength: float | None = None
    """0…1: how much skeleton and locks count whatever the budget; None: they fade in where few triangles are left."""
    visibility: float = 0.0
    """0…1: how much vertices that few directions see lose: × (1 − visibility · (1 − seen share)), never below 0.1."""
    saliency: float = 0.0
    """0 or more: × (1 + saliency · s), s the mesh saliency of Lee et al. 2005, 0…1."""
    painted: str | None = None
    """Attribute with painted weights: a colour (red protects, blue reduces, grey is neutral) or a number (× itself)."""
    parts: Mapping[str, PartRule] = field(default_factory=dict)
    """What is asked of parts, by the names that `lodpipe.geometry.parts` knows."""
    cameras: tuple[tuple[float, float, float], ...] = ()
    """Directions from which the model will be looked at; volumetric points and visibility are theirs then."""


def importance(asset: Asset, options: ImportanceOptions | None = None) -> Importance:
    """The importance of every vertex of `asset.meshes`, from its skeleton and segments where it has them.

    `weight` is the product of painted weights, saliency and visibility and counts always; `extreme` is that of
    borders, terminal vertices and volumetric points and fades in with falling budgets. Raises InvalidMesh for options
    out of range, and if no mesh has the painted attribute.
    """
    options = options or ImportanceOptions()
    _check(options)
    soup = flatten_once(asset)
    counts = [len(mesh.positions) if len(mesh.faces) else 0 for mesh in asset.meshes]
    splits = np.cumsum(counts)[:-1]
    weight = np.ones(len(soup.positions))
    directions = np.asarray(options.cameras, np.float64).reshape(-1, 3)
    directions = (
        directions / np.linalg.norm(directions, axis=1, keepdims=True) if len(directions) else views(DIRECTIONS)
    )
    if options.visibility:
        weight *= np.maximum(1 - options.visibility * (1 - seen_share(soup, directions)), 0.1)
    if options.saliency:
        weight *= 1 + options.saliency * mesh_saliency(soup)
    of_mesh = [_filled(mesh, part) for mesh, part in zip(asset.meshes, np.split(weight, splits), strict=True)]
    if options.painted is not None:
        of_mesh = _painted(asset.meshes, of_mesh, options.painted)
    extreme = np.ones(len(soup.positions))
    reserved, owner = np.zeros((0, 3), np.int32), np.zeros(0, np.int32)
    if asset.skeleton is not None and asset.segments is not None and len(soup.faces):
        drawn = [i for i, mesh in enumerate(asset.meshes) if len(mesh.faces)]
        extreme[np.concatenate([asset.segments.border[i] for i in drawn])] = BORDER
        rows = _volumetric(soup, asset.skeleton, directions)
        extreme[rows] = np.maximum(extreme[rows], VOLUME)
        reserved, owner = _reserved(asset, soup, asset.skeleton, asset.segments)
        first = np.concatenate([[0], np.cumsum(counts)])
        extreme[reserved[:, 0] + first[owner]] = TERMINAL
    fading = [_filled(mesh, part) for mesh, part in zip(asset.meshes, np.split(extreme, splits), strict=True)]
    pinned, shares = _of_parts(asset, of_mesh, options.parts)
    return Importance(tuple(of_mesh), tuple(fading), reserved, owner, options.strength, pinned, shares)


ATTRIBUTE = "_IMPORTANCE"


def with_attribute(asset: Asset) -> Asset:
    """The asset whose meshes carry what `importance` says of them as the attribute `_IMPORTANCE`, one float a wedge:
    weight × extreme, what multiplies a vertex's quadric where few triangles are left. Levels made of it carry it on."""
    if asset.importance is None:
        return asset
    meshes = []
    for mesh, weight, extreme in zip(asset.meshes, asset.importance.weight, asset.importance.extreme, strict=True):
        if mesh.keep_reason or not len(mesh.faces):
            meshes.append(mesh)
            continue
        wedges = mesh.wedges if mesh.attributes else mesh.faces
        rows = max((len(v) for v in mesh.attributes.values()), default=len(mesh.positions))
        values = np.ones((rows, 1), np.float32)
        values[wedges.ravel(), 0] = (weight * extreme)[mesh.faces.ravel()]
        own = tuple(replace(p, attributes=(*dict.fromkeys([*p.attributes, ATTRIBUTE]),)) for p in mesh.primitives)
        attributes = {**mesh.attributes, ATTRIBUTE: values}
        meshes.append(replace(mesh, wedges=wedges, attributes=attributes, primitives=own))
    return replace(asset, meshes=tuple(meshes))


def _of_parts(
    asset: Asset, weights: list[F32], rules: Mapping[str, PartRule]
) -> tuple[tuple[Bool, ...], tuple[PartShare, ...]]:
    """Pins and shares of parts; weights are multiplied in place of `weights`' entries."""
    pinned = [np.zeros(len(mesh.positions), bool) for mesh in asset.meshes]
    shares = []
    for name, rule in rules.items():
        found = part(asset, name)
        for index, inside in enumerate(found.vertices):
            if rule.weight != 1:
                weights[index] = np.where(inside, weights[index] * rule.weight, weights[index]).astype(np.float32)
            if rule.pin or rule.keep == 1:
                pinned[index] |= inside
        if rule.keep is not None and 0 < rule.keep < 1:
            shares.append(PartShare(name, rule.keep, found.faces))
    return (tuple(pinned) if any(p.any() for p in pinned) else ()), tuple(shares)


def seen_share(soup: Soup, directions: F64) -> F64:
    """(V,) share of `directions` from which each vertex is seen: it faces them, and nothing is in between."""
    from lodpipe.o3d import RayScene

    points, normals = _unit(soup), _vertex_normals(soup)
    scene = RayScene(points.astype(np.float32), soup.faces)
    seen = np.zeros(len(points))
    for direction in directions:
        facing = np.flatnonzero(normals @ direction > 0)
        start = points[facing] + 1e-4 * normals[facing]
        rays = np.broadcast_to(direction, start.shape).astype(np.float32)
        seen[facing] += scene.cast(start.astype(np.float32), rays).faces < 0
    return seen / max(len(directions), 1)


def mesh_saliency(soup: Soup) -> F64:
    """(V,) 0…1: how much mean curvature differs between scales (Lee, Varshney & Jacobs 2005).

    Their Gaussian averages are approximated by steps of diffusion along edges; each scale is normalised by their
    non-linear rule before the scales are summed.
    """
    points, faces = _unit(soup), soup.faces
    curvature = np.abs(_mean_curvature(points, faces))
    curvature = np.minimum(curvature, np.quantile(curvature, 0.99)) if len(curvature) else curvature
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    a, b = np.concatenate([edges, edges[:, ::-1]]).T
    degree = np.maximum(np.bincount(a, minlength=len(points)), 1)
    length = float(np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1).mean()) if len(edges) else 1.0
    steps = [max(1, round((0.003 * k / length) ** 2)) for k in (*SALIENCY_LEVELS, *(2 * k for k in SALIENCY_LEVELS))]
    smooth, made = curvature, {0: curvature}
    for step in range(1, min(max(steps), 60) + 1):
        smooth = (smooth + np.bincount(a, smooth[b], len(points)) / degree) / 2
        made[step] = smooth
    total = np.zeros(len(points))
    half = len(SALIENCY_LEVELS)
    for fine, coarse in zip(steps[:half], steps[half:], strict=True):
        scale = np.abs(made[min(fine, 60)] - made[min(coarse, 60)])
        top = scale.max(initial=0.0)
        if top > 0:
            scale = scale / top
            total += scale * (1 - scale.mean()) ** 2
    top = total.max(initial=0.0)
    return total / top if top > 0 else total


def _mean_curvature(points: F64, faces: np.ndarray) -> F64:
    """(V,) mean curvature by the cotangent formula (Meyer et al. 2003), area by thirds of the faces."""
    total = np.zeros_like(points)
    area = np.zeros(len(points))
    corner = points[faces]
    for k in range(3):
        i, j = faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        u, v = corner[:, (k + 1) % 3] - corner[:, k], corner[:, (k + 2) % 3] - corner[:, k]
        cross = np.linalg.norm(np.cross(u, v), axis=1)
        cot = np.clip(np.einsum("ij,ij->i", u, v) / np.maximum(cross, 1e-18), -20, 20)
        pull = cot[:, None] * (points[i] - points[j])
        for axis in range(3):
            total[:, axis] += np.bincount(i, pull[:, axis], len(points)) - np.bincount(j, pull[:, axis], len(points))
        area += np.bincount(faces[:, k], cross / 6, len(points))
    return np.asarray(np.linalg.norm(total, axis=1) / np.maximum(4 * area, 1e-12))


def _volumetric(soup: Soup, skeleton: Skeleton, directions: F64) -> np.ndarray:
    """Rows of the vertices nearest to where rays from the directions to each joint meet the surface [E]."""
    from lodpipe.o3d import RayScene

    joints = skeleton.positions[skeleton.node_type == NODE_TYPES.index("joint")]
    if not len(joints) or not len(soup.faces):
        return np.zeros(0, np.int64)
    low, scale = soup.bounds[0], soup.diagonal or 1.0
    scene = RayScene(_unit(soup).astype(np.float32), soup.faces)
    targets = np.repeat((joints - low) / scale, len(directions), axis=0)
    along = np.tile(directions, (len(joints), 1))
    hits = scene.cast((targets + 2 * along).astype(np.float32), -along.astype(np.float32))
    met = np.flatnonzero((hits.faces >= 0) & (hits.distance < 2))
    weights = np.column_stack([1 - hits.uv[met].sum(axis=1), hits.uv[met]])
    return np.unique(soup.faces[hits.faces[met], weights.argmax(axis=1)])


def _reserved(asset: Asset, soup: Soup, skeleton: Skeleton, segments: Segments) -> tuple[np.ndarray, np.ndarray]:
    """A triangle for each end, longest branch first: the terminal vertex, and the pair on the branch's border that is
    farthest apart [D]; the terminal vertex three times where the branch has no border in its mesh."""
    ends = np.flatnonzero(skeleton.tip >= 0)
    branch = segments.kind[segments.node_segment[ends]] == PARTS.index("branch")
    rows, owners, lengths = [], [], []
    for node in ends[branch]:
        mesh, tip, segment = int(skeleton.tip_mesh[node]), int(skeleton.tip[node]), segments.node_segment[node]
        positions = asset.meshes[mesh].positions
        rim = np.flatnonzero(segments.border[mesh] & (segments.vertex_segment[mesh] == segment))
        pair = [tip, tip]
        if len(rim) > 1:
            first = rim[np.linalg.norm(positions[rim] - positions[rim].mean(axis=0), axis=1).argmax()]
            second = rim[np.linalg.norm(positions[rim] - positions[first], axis=1).argmax()]
            pair = [int(first), int(second)]
        members = skeleton.positions[segments.node_segment == segment]
        lengths.append(float(np.linalg.norm(np.ptp(members, axis=0))))
        rows.append([tip, *pair])
        owners.append(mesh)
    order = np.argsort(-np.array(lengths), kind="stable")
    return np.array(rows, np.int32).reshape(-1, 3)[order], np.array(owners, np.int32)[order]


def _painted(meshes: Sequence[Mesh], weights: list[F32], name: str) -> list[F32]:
    if not any(name in mesh.attributes for mesh in meshes):
        known = sorted({key for mesh in meshes for key in mesh.attributes})
        raise InvalidMesh(
            f"no mesh has the attribute '{name}' for painted weights", advice=f"there are: {', '.join(known) or 'none'}"
        )
    out = []
    for mesh, weight in zip(meshes, weights, strict=True):
        values = mesh.attributes.get(name)
        if values is None:
            out.append(weight)
            continue
        if values.shape[1] >= 3:
            own = 100.0 ** (values[:, 0].astype(np.float64) - values[:, 2])
        else:
            own = values[:, 0].astype(np.float64)
        own = np.clip(np.where(np.isfinite(own), own, 1.0), LEAST, MOST)
        of_vertex = np.full(len(mesh.positions), -np.inf)
        np.maximum.at(of_vertex, mesh.faces.ravel(), own[mesh.wedges.ravel()])  # at a seam the stronger one
        out.append((weight * np.where(np.isfinite(of_vertex), of_vertex, 1.0)).astype(np.float32))
    return out


def _filled(mesh: Mesh, values: F64) -> F32:
    return values.astype(np.float32) if len(values) else np.ones(len(mesh.positions), np.float32)


def _unit(soup: Soup) -> F64:
    return np.asarray((soup.positions - soup.bounds[0]) / (soup.diagonal or 1.0))


def _vertex_normals(soup: Soup) -> F64:
    points = _unit(soup)
    corner = points[soup.faces]
    face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normals = np.stack(
        [np.bincount(soup.faces.ravel(), np.repeat(face[:, k], 3), len(points)) for k in range(3)], axis=1
    )
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))


def _check(options: ImportanceOptions) -> None:
    if options.strength is not None and not 0 <= options.strength <= 1:
        raise InvalidMesh(f"strength lies from 0 to 1 (got {options.strength:g})")
    if not 0 <= options.visibility <= 1:
        raise InvalidMesh(f"visibility lies from 0 to 1 (got {options.visibility:g})")
    if not options.saliency >= 0:
        raise InvalidMesh(f"saliency must not be negative (got {options.saliency:g})")
    for name, rule in options.parts.items():
        if not rule.weight > 0 or (rule.keep is not None and not 0 <= rule.keep <= 1):
            raise InvalidMesh(f"part '{name}': weight must be positive, keep lie from 0 to 1")
    if any(not any(direction) for direction in options.cameras):
        raise InvalidMesh("a camera's direction must not be zero")
