from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from lodpipe.io.weld import unique_rows


@given(hnp.arrays(np.int32, st.tuples(st.integers(0, 60), st.just(2)), elements=st.integers(-2, 2)))
def test_agrees_with_a_dictionary(rows: np.ndarray) -> None:
    first, inverse = unique_rows([rows[:, 0], rows[:, 1]])
    seen: dict[tuple[int, ...], int] = {}
    for i, row in enumerate(map(tuple, rows.tolist())):
        seen.setdefault(row, i)
    assert first.tolist() == list(seen.values())
    assert [first[k] for k in inverse] == [seen[tuple(row)] for row in rows.tolist()]


def test_zeros_of_both_signs_are_one_and_neighbours_are_not() -> None:
    tiny = np.float32(1e-45)
    first, inverse = unique_rows([np.array([0.0, -0.0, tiny, 1, np.nextafter(np.float32(1), 2)], np.float32)])
    assert first.tolist() == [0, 2, 3, 4]
    assert inverse.tolist() == [0, 0, 1, 2, 3]


def test_very_many_rows_of_few_kinds() -> None:
    values = np.random.default_rng(0).integers(0, 50, (100_000, 2))
    first, inverse = unique_rows([values[:, 0], values[:, 1].astype(np.int32)])
    assert np.array_equal(values[first][inverse], values) and len(first) == len(np.unique(values, axis=0)) <= 2500
    assert (np.diff(first) > 0).all()


def test_doubles_and_columns_of_different_types() -> None:
    a = np.array([1e-300, 1e-300, 2e-300])
    first, _ = unique_rows([a, np.array([1, 1, 1], np.int32)])
    assert first.tolist() == [0, 2]
    first, _ = unique_rows([a, np.array([1, 2, 1], np.int32)])
    assert first.tolist() == [0, 1, 2]
