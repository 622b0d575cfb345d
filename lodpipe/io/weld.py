"""Equal rows of arrays, found in linear time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Odd 64-bit constants with well-mixed bits (the finaliser of SplitMix64: Steele et al., OOPSLA 2014).
_MIX = (np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB))


def unique_rows(columns: Sequence[NDArray[Any]]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Equal rows of `columns`, each of shape (N,), of one or several 4- or 8-byte types.

    Returns `first` (U,), the row at which each distinct row appears first, ascending, and `inverse` (N,), for each
    row its place in `first`. Rows are equal when they are equal bit by bit, except that −0.0 equals 0.0.

    A hash table filled by array operations: each round scatters the open rows into a fresh table (last writer, that
    is the first of the rows, as they are written in reverse), and a row whose slot's owner equals it is settled.
    All copies of a row share their slot, so they are settled together. Each round settles about 80 % of the rows.
    """
    keys = [_bits(column) for column in columns]
    count = len(keys[0])
    owner = np.arange(count, dtype=np.int32)
    open_rows = owner.copy()
    seed = 1
    while len(open_rows):
        bits = max(8, len(open_rows).bit_length() + 1)
        slot = _hash(keys, open_rows, seed, bits)
        table = np.empty(1 << bits, np.int32)
        table[slot[::-1]] = open_rows[::-1]
        found = table[slot]
        same = np.ones(len(open_rows), bool)
        for key in keys:
            same &= key[found] == key[open_rows]
        owner[open_rows[same]] = found[same]
        open_rows = open_rows[~same]
        seed += 1
    is_first = owner == np.arange(count, dtype=np.int32)
    place = np.cumsum(is_first, dtype=np.int32) - np.int32(1)
    return np.flatnonzero(is_first).astype(np.int32), place[owner]


def _bits(column: NDArray[Any]) -> NDArray[Any]:
    if column.dtype.kind == "f":
        column = column + column.dtype.type(0)  # turns −0.0 into 0.0
    return np.ascontiguousarray(column).view(f"u{column.dtype.itemsize}")


def _hash(keys: list[NDArray[Any]], rows: NDArray[np.int32], seed: int, bits: int) -> NDArray[np.int64]:
    value = np.full(len(rows), (0x9E3779B97F4A7C15 * seed) & 0xFFFFFFFFFFFFFFFF, np.uint64)
    everything = len(rows) == len(keys[0])
    for key in keys:
        value ^= key if everything else key[rows]
        value *= _MIX[0]
        value ^= value >> np.uint64(29)
    value *= _MIX[1]
    return (value >> np.uint64(64 - bits)).astype(np.int64)
