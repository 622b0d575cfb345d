from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.io.skins import valid_skin


def repaired(joints: Any, weights: Any, count: int | None = 4) -> tuple[NDArray[Any], NDArray[Any], list[str]]:
    said: list[str] = []
    table: dict[str, NDArray[Any]] = {
        "JOINTS_0": np.array(joints, np.uint8),
        "WEIGHTS_0": np.array(weights, np.float32),
    }
    valid_skin(table, count, "m", said.append)
    return table["JOINTS_0"], table["WEIGHTS_0"], said


def test_what_is_valid_is_left_bit_by_bit() -> None:
    weights = np.array([[0.1, 0.2, 0.3, 0.4], [1, 0, 0, 0], [1 / 3, 1 / 3, 1 / 3, 0]], np.float32)
    joints, after, said = repaired([[0, 1, 2, 3], [3, 0, 0, 0], [0, 1, 2, 0]], weights)
    assert said == [] and np.array_equal(after.astype(np.float32), weights)
    assert joints.tolist() == [[0, 1, 2, 3], [3, 0, 0, 0], [0, 1, 2, 0]]


def test_weights_of_joints_that_are_not_there_go_to_the_others() -> None:
    joints, weights, said = repaired([[9, 1, 2, 3], [9, 9, 9, 9]], [[0.5, 0.25, 0.25, 0], [0.25] * 4])
    assert joints.tolist() == [[0, 1, 2, 3], [0, 0, 0, 0]]
    assert weights.tolist() == [[0, 0.5, 0.5, 0], [1, 0, 0, 0]]
    assert "2 vertices name a joint beyond the skin's 4" in said[0] and "1 vertices without a weight" in said[1]
    assert repaired([[9, 0, 0, 0]], [[1, 0, 0, 0]], None)[0].tolist() == [[9, 0, 0, 0]]


def test_weights_that_make_no_sense() -> None:
    _, weights, said = repaired([[0, 1, 2, 3]] * 4, [[0] * 4, [np.nan, 1, 0, 0], [-1, 1, 0, 0], [2, 2, 0, 0]])
    assert weights.tolist() == [[1, 0, 0, 0], [0, 1, 0, 0], [0, 1, 0, 0], [0.5, 0.5, 0, 0]]
    assert [s.split()[1] for s in said] == ["2", "1", "1"]


def test_sums_run_over_all_sets() -> None:
    table: dict[str, NDArray[Any]] = {
        "JOINTS_0": np.zeros((1, 4), np.uint8),
        "WEIGHTS_0": np.full((1, 4), 0.25, np.float32),
        "JOINTS_1": np.ones((1, 4), np.uint8),
        "WEIGHTS_1": np.full((1, 4), 0.25, np.float32),
    }
    valid_skin(table, 2, "m", lambda text: None)
    assert table["WEIGHTS_0"].tolist() == table["WEIGHTS_1"].tolist() == [[0.125] * 4]
    assert table["JOINTS_1"].tolist() == [[1] * 4]
