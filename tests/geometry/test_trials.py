"""Several ways to make a level: the one that looks best is kept."""

from __future__ import annotations

import numpy as np
import pytest

from lodpipe.core.asset import Asset, Target
from lodpipe.core.errors import Cancelled
from lodpipe.core.mesh import Mesh
from lodpipe.geometry.decimate import decimate_asset
from lodpipe.geometry.texture import Textures
from lodpipe.geometry.trials import WAYS, Jury
from meshes import bumpy

GOALS = [Target(triangles=80)]


@pytest.fixture(scope="module")
def source() -> Asset:
    positions, faces = bumpy(2, 0.3)
    white = np.where((positions[:, 2] > 0.2)[:, None], 1.0, 0.1).repeat(3, axis=1).astype(np.float32)
    return Asset(name="two halves", meshes=(Mesh(positions, faces, attributes={"COLOR_0": white}),))


def test_what_is_kept_looks_no_worse_than_the_first_way(source):
    jury = Jury(source, Textures())
    once, tried = (decimate_asset(source, GOALS, metric="visual", trials=t) for t in (1, len(WAYS)))
    errors = [[jury.error(source.at(lod)) for lod in lods[1:]] for lods in (once, tried)]
    assert all(b <= a for a, b in zip(*errors, strict=True)) and errors[0] != errors[1]
    assert [lod.triangles for lod in tried[1:]] == [80]
    assert jury.error(source) == 0


def test_the_same_bytes_for_any_number_of_threads(source):
    one, two = (decimate_asset(source, GOALS, metric="visual", trials=2, threads=t) for t in (1, 2))
    assert [m.fingerprint() for lod in one for m in lod.meshes] == [m.fingerprint() for lod in two for m in lod.meshes]


def test_it_stops_between_the_trials(source):
    asked = iter(range(1000))
    with pytest.raises(Cancelled):
        decimate_asset(source, GOALS, metric="visual", trials=6, cancelled=lambda: next(asked) > 40)
