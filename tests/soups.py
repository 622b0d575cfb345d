"""Triangle soups for fuzzing, as hypothesis draws them."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from meshes import book, bow_tie, box, bumpy, cubes, folded, grid, hourglass, messy, moebius, terrain, torus

NAMED = [bumpy, terrain, torus, moebius, messy, book, bow_tie, box, grid, folded, hourglass, lambda: cubes(3, 0.0)]


@st.composite
def soups(draw):
    """Positions and faces with everything that goes wrong: doubled, turned, collapsed, coplanar, welded at random."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    kind = draw(st.sampled_from(["named", "random", "lattice", "welded", "holes", "doubled", "flat", "scaled"]))
    if kind in ("random", "lattice"):
        count = draw(st.integers(1, 40))
        faces = rng.integers(0, count, (draw(st.integers(0, 80)), 3)).astype(np.int32)
        return rng.normal(size=(count, 3)) if kind == "random" else rng.integers(0, 3, (count, 3)).astype(float), faces
    positions, faces = (a.copy() for a in draw(st.sampled_from(NAMED))())
    if kind == "welded":
        onto = np.where(rng.random(len(positions)) < 0.05, rng.permutation(len(positions)), np.arange(len(positions)))
        faces = onto[faces].astype(np.int32)
    if kind == "holes":
        faces = faces[rng.random(len(faces)) < 0.7]
    if kind == "doubled":
        faces = np.concatenate([faces, faces[rng.random(len(faces)) < 0.3][:, ::-1]])
    if kind == "flat":
        positions[:, draw(st.integers(0, 2))] = 0
    if kind == "scaled":
        positions = positions * 10.0 ** draw(st.integers(-30, 30)) + draw(st.sampled_from([0.0, 1e3, -3e7]))
    return positions, faces
