"""Equal rows of arrays, found in linear time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.kernel import tables


def unique_rows(columns: Sequence[NDArray[Any]]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Equal rows of `columns`, each of shape (N,), of one or several 4- or 8-byte types.

    Returns `first` (U,), the row at which each distinct row appears first, ascending, and `inverse` (N,), for each
    row its place in `first`. Rows are equal when they are equal bit by bit, except that −0.0 equals 0.0.
    """
    words = [_bits(column) for column in columns]
    rows = np.concatenate(words, axis=1) if len(words) > 1 else words[0]
    return tables.unique_rows(rows)


def _bits(column: NDArray[Any]) -> NDArray[np.uint32]:
    """(N, 1 or 2): the bits of 4- or 8-byte values."""
    if column.dtype.kind == "f":
        column = column + column.dtype.type(0)  # turns −0.0 into 0.0
    return np.ascontiguousarray(column).view(np.uint32).reshape(len(column), column.dtype.itemsize // 4)
