"""Distances as colours."""

from __future__ import annotations

import numpy as np
import pytest

from lodpipe.core.asset import Asset
from lodpipe.core.mesh import Mesh
from lodpipe.geometry.flatten import flatten
from lodpipe.geometry.heat import RAMP, distance_to, place, ramp, value_at
from meshes import grid


def test_the_ramp_runs_through_its_colours():
    colours = ramp(np.linspace(0, 1, len(RAMP)))
    assert [f"#{bytes(colour).hex()}" for colour in colours] == list(RAMP)
    assert (ramp(np.array([-1.0, np.nan, 0.0])) == colours[0]).all()
    assert (ramp(np.array([2.0])) == colours[-1]).all()


def test_colours_grow_from_nothing_to_the_top():
    places = place(np.array([0.0, 0.001, 0.01, 0.1, 1.0, 5.0]), 1.0)
    assert places[0] == 0
    assert places[-1] == places[-2] == 1
    assert (np.diff(places[:-1]) > 0).all()
    assert places[2] == pytest.approx(1 / 3, abs=0.02)
    assert (place(np.ones(3), 0.0) == 0).all()
    assert [value_at(float(at), 2.0) for at in place(np.array([0.02, 2.0]), 2.0)] == pytest.approx([0.02, 2.0])


def test_the_distance_to_a_lifted_sheet():
    low, high = (flatten(Asset("sheet", (Mesh(*grid(4, height)),))) for height in (0.0, 0.25))
    distance = distance_to(low, high)
    assert distance == pytest.approx(np.full(len(low.positions), 100 * 0.25 / low.diagonal), rel=1e-4)
    assert distance_to(low, high, low.positions[:2]) == pytest.approx(distance[:2])
    assert distance_to(low, low) == pytest.approx(np.zeros(len(low.positions)), abs=1e-4)
    with pytest.raises(ValueError, match="no closest points"):
        distance_to(low, flatten(Asset("none", (Mesh(low.positions, np.zeros((0, 3), int)),))))
