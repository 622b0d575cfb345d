import numpy as np
import pytest

import limbs
import meshes
from lodpipe.core.mesh import Mesh
from lodpipe.geometry.skeleton_field import far_ends, mean_distance
from lodpipe.geometry.skeleton_rays import Rays
from lodpipe.geometry.skeleton_surface import Surface
from lodpipe.geometry.skeleton_tips import peaks, tips


def by_flooding(surface, field):
    """Rises of all maxima, by adding one vertex after another from the top: the definition, slow."""
    near = [[] for _ in field]
    for a, b in surface.edges.tolist():
        near[a].append(b)
        near[b].append(a)
    owner, rises = {}, {}
    for v in np.argsort(-field):
        tops = sorted({_root(owner, owner[n]) for n in near[v] if n in owner}, key=lambda t: -field[t])
        owner[int(v)] = tops[0] if tops else int(v)
        for lower in tops[1:]:
            rises[lower] = field[lower] - field[v]
            owner[lower] = tops[0]
    return rises


def _root(owner, top):
    while owner[top] != top:
        top = owner[top]
    return top


@pytest.mark.parametrize(
    "mesh", [limbs.star(3), Mesh(*meshes.torus()), Mesh(*meshes.bumpy())], ids=["star", "torus", "bumpy"]
)
def test_rises_are_exact(mesh):
    surface = Surface.of(limbs.asset(mesh))
    field = surface.points @ [0.3, 0.5, 0.8] + 0.2 * np.random.default_rng(0).random(len(surface.points))
    exact = {t: r for t, r in by_flooding(surface, field).items() if r > 1e-3}
    found = {t.vertex: t.rise for t in peaks(surface, field, np.full(1, 1e-3))}
    assert len(exact) > 1
    found.pop(int(field.argmax()))  # the highest has no pass of its own
    assert found == pytest.approx(exact)


def test_tips_are_the_ends_of_arms_and_limbs_do_not_overlap():
    mesh = limbs.star(5, hub=0.3)
    surface = Surface.of(limbs.asset(mesh))
    field = mean_distance(surface, far_ends(surface))
    found = tips(surface, Rays(surface), field, 0.05 * surface.diagonals)
    out = np.linalg.norm(surface.unplaced(surface.points), axis=1)
    assert len(found) == 5
    assert all(out[t.vertex] > 1.05 for t in found)
    limb = np.concatenate([t.region for t in found])
    assert len(np.unique(limb)) == len(limb)


@pytest.mark.parametrize("sides", [(1, 1, 1), (1, 1.5, 1), (1, 1.4, 1.2)])
def test_a_ball_has_no_tips(sides):
    positions, faces = meshes.sphere()
    surface = Surface.of(limbs.asset(Mesh(positions * sides, faces)))
    field = mean_distance(surface, far_ends(surface))
    assert not tips(surface, Rays(surface), field, 0.05 * surface.diagonals)
