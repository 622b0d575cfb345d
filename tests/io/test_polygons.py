from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lodpipe.io import polygons
from lodpipe.io.polygons import triangulate, usable


def areas(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (points[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)[:, 2] / 2


def cut(*shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[str]]:
    said: list[str] = []
    faces, owner = triangulate(np.array([len(s) for s in shapes]), np.concatenate(shapes), "p", said.append)
    return faces, owner, said


def star(corners: int, inner: float = 0.3) -> np.ndarray:
    angle = np.arange(corners) * (2 * math.pi / corners)
    radius = np.where(np.arange(corners) % 2, inner, 1.0)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1)


@given(st.integers(3, 24), st.floats(0.05, 1.5), st.integers(0, 23))
def test_triangles_cover_the_polygon_once(corners: int, inner: float, turn: int) -> None:
    shape = np.roll(star(2 * corners, inner), turn, axis=0)
    faces, _, _ = cut(shape)
    signed = areas(shape, faces)
    outline = sum(np.cross(a, b)[2] for a, b in zip(shape, np.roll(shape, -1, axis=0), strict=True)) / 2
    assert len(faces) == len(shape) - 2
    assert (signed > -1e-9).all(), "a triangle is turned over: it lies outside"
    assert math.isclose(signed.sum(), outline, rel_tol=1e-9)


def test_a_concave_quadrilateral_is_cut_at_its_reflex_corner() -> None:
    dart = np.array([[0, 0, 0], [2, 1, 0], [0, 2, 0], [0.5, 1, 0]])
    for turn in range(4):
        shape = np.roll(dart, turn, axis=0)
        faces, _, _ = cut(shape)
        assert (areas(shape, faces) > 0).all()


def test_polygons_of_all_sizes_keep_their_order() -> None:
    square = star(4, 1.0)
    faces, owner, said = cut(star(6), square, square[:3], star(6), square)
    assert owner.tolist() == sorted(owner.tolist()) and np.bincount(owner).tolist() == [4, 2, 1, 4, 2]
    begin = np.array([0, 6, 10, 13, 19, 23])
    assert (faces >= begin[owner][:, None]).all() and (faces < begin[owner + 1][:, None]).all()
    assert said == []


def test_a_polygon_that_crosses_itself_or_has_no_area_still_ends() -> None:
    bow = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1, 0], [0.5, 2, 0]], float)
    assert len(cut(bow)[0]) == 3
    assert len(cut(np.zeros((7, 3)))[0]) == 5
    assert len(cut(np.full((5, 3), np.nan))[0]) == 3


def test_huge_concave_polygons_are_fans_with_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(polygons, "MAX_EARS", 10)
    faces, _, said = cut(star(12))
    assert len(faces) == 10 and len(said) == 1 and "12 corners" in said[0]


def test_unusable_polygons_are_counted() -> None:
    said: list[str] = []
    good = usable(np.array([3, 2, 4, 3]), np.array([0, 1, 2, 0, 1, 0, 1, 2, 9, -1, 0, 1]), 3, "m", said.append)
    assert good.tolist() == [True, False, False, False]
    assert said == [
        "m: 1 face with fewer than three corners left out",
        "m: 2 faces with an index out of range left out",
    ]


@pytest.mark.parametrize("corners", [7, 8, 9, 12, 101, 5000])
def test_corners_of_large_convex_polygons_have_few_triangles(corners: int) -> None:
    shape = star(corners, 1.0)
    faces, _, said = cut(shape)
    assert (areas(shape, faces) > 0).all() and not said
    assert math.isclose(areas(shape, faces).sum(), corners / 2 * math.sin(2 * math.pi / corners), rel_tol=1e-9)
    assert np.bincount(faces.ravel()).max() <= 2 * math.log2(corners)
