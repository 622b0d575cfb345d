"""Pairs without an edge between them (Garland & Heckbert 1997, section 4)."""

from __future__ import annotations

import numpy as np
import pytest

from lodpipe.kernel import PLACEMENTS, decimate
from measures import components
from meshes import bumpy, cubes
from options import options


@pytest.mark.parametrize("keep_topology", [True, False])
def test_cubes_become_one_slab(keep_topology):
    """10 × 10 cubes of side 0.8 with gaps of 0.2 (figure 3): with pairs across the gaps they become one flat block."""
    setting = options(pair_distance=0.3, keep_topology=keep_topology)
    levels = decimate(*cubes(), [1200, 800, 400, 200], setting).levels
    assert [level.stop for level in levels] == ["triangles"] * 4
    assert [len(level.faces) <= level.target for level in levels] == [True] * 4
    assert [components(level.faces) for level in levels[1:]] == [1, 1, 1]
    for level in levels[:3]:
        low, high = level.positions.min(axis=0), level.positions.max(axis=0)
        assert low[:2] == pytest.approx([-0.4, -0.4], abs=0.05) and high[:2] == pytest.approx([9.4, 9.4], abs=0.05)
    alone = decimate(*cubes(), [200], options(keep_topology=keep_topology)).levels[0]
    assert components(alone.faces) > 50


def test_every_vertex_may_be_linked_to_every_other():
    """41,000 links among 288 vertices: lists of hundreds of corners, which once took 15 seconds."""
    positions, faces = cubes(6)
    assert len(positions) == 288
    levels = decimate(positions, faces, [200, 40, 0], options(pair_distance=100.0)).levels
    assert [level.stop for level in levels] == ["triangles"] * 3
    assert [len(level.faces) <= level.target for level in levels] == [True] * 3
    assert len(levels[0].faces) > 190 and len(levels[2].faces) == 0


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_links_alone_are_progress(placement):
    """Two balls that nearly touch grow together before a single triangle of them is gone."""
    positions, faces = bumpy(2, 0.01)
    both = np.concatenate([positions, positions * [-1, 1, 1] + [2.05, 0, 0]])
    mesh = both, np.concatenate([faces, faces[:, ::-1] + len(positions)]).astype(np.int32)
    setting = options(placement=placement, pair_distance=0.1, keep_topology=False)
    assert components(decimate(*mesh, [256], setting).levels[0].faces) == 2  # nothing to do yet
    level = decimate(*mesh, [100], setting).levels[0]
    assert level.stop == "triangles" and len(level.faces) <= 100 and components(level.faces) == 1


def test_a_link_is_no_hole():
    """Vertices near each other but not connected do not stand in the way of collapses along edges."""
    positions, faces = bumpy(3, 0.02)
    linked = decimate(positions, faces, [40], options(pair_distance=0.05, may_relax=False)).levels[0]
    assert linked.stop == "triangles" and len(linked.faces) <= 40
