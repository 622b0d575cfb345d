"""Joints and weights of skinned vertices, made valid."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.io.clean import Warn

#: How far a sum of weights may be from 1 before it is changed; glTF 2.0 asks for 2e-7 for each weight.
_TOLERANCE = 2e-7


def valid_skin(attributes: dict[str, NDArray[Any]], joints: int | None, place: str, warn: Warn) -> None:
    """Repair JOINTS_n (N, 4) and WEIGHTS_n (N, 4) of `attributes` in place.

    `joints` is the number of joints of the skin, None where no skin is known. A weight of a joint that is not
    there, and one that is negative or not finite, becomes 0; weights are scaled to a sum of 1; a vertex without any
    weight follows the first joint it names.
    """
    sets = [n for n in range(len(attributes)) if f"JOINTS_{n}" in attributes and f"WEIGHTS_{n}" in attributes]
    if not sets:
        return
    index = np.concatenate([attributes[f"JOINTS_{n}"] for n in sets], axis=1).astype(np.int64)
    given = np.concatenate([attributes[f"WEIGHTS_{n}"] for n in sets], axis=1).astype(np.float64)
    weight = given
    bad = ~(np.isfinite(given) & (given >= 0))
    if bad.any():
        warn(f"{place}: {int(bad.any(axis=1).sum()):,} vertices with weights that are negative or not finite; set to 0")
        weight = np.where(bad, 0.0, weight)
    outside = index >= joints if joints is not None else np.zeros(index.shape, bool)
    if outside.any():
        count = int(outside.any(axis=1).sum())
        warn(f"{place}: {count:,} vertices name a joint beyond the skin's {joints}; its weight is left out")
        index = np.where(outside, 0, index)
        weight = np.where(outside, 0.0, weight)
    total = weight.sum(axis=1)
    nothing = total <= 0
    if nothing.any():
        warn(f"{place}: {int(nothing.sum()):,} vertices without a weight; they follow their first joint")
        weight = weight.copy()
        weight[nothing, 0], total[nothing] = 1.0, 1.0
    uneven = np.abs(total - 1.0) > _TOLERANCE * (weight > 0).sum(axis=1)
    if uneven.any():
        far = int((np.abs(total - 1.0) > 0.01).sum())
        if far:
            warn(f"{place}: {far:,} vertices whose weights do not sum up to 1; scaled")
        weight = np.where(uneven[:, None], weight / total[:, None], weight)
    for k, n in enumerate(sets):
        attributes[f"JOINTS_{n}"] = index[:, 4 * k : 4 * k + 4]
        attributes[f"WEIGHTS_{n}"] = weight[:, 4 * k : 4 * k + 4]
