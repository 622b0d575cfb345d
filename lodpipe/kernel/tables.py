"""Lines and numbers of text files, equal rows of tables: checked wrappers over the compiled module."""

from __future__ import annotations

import os
from typing import cast

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.errors import InvalidMesh
from lodpipe.core.mesh import F64, I32
from lodpipe.kernel import _native

I64 = NDArray[np.int64]


def text_lines(text: bytes) -> tuple[I64, I64, I64, I32, NDArray[np.uint64]]:
    """The lines of `text`, which \\n separates: start, end, first, words, head, each (L,).

    start, end   byte offsets, without the \\n
    first        offset of the first word; the end where there is none
    words        number of words, which white space separates (tab to carriage return, and the space)
    head         the eight bytes from `first` on as one number, the first byte lowest; spaces after the text's end
    """
    return cast("tuple[I64, I64, I64, I32, NDArray[np.uint64]]", _native.text_lines(text))


def text_numbers(text: bytes, at: I64, end: I64, columns: int, threads: int = 0) -> F64 | None:
    """(N, columns) float64: the first numbers of each piece `at[i]` … `end[i]` of `text`, NaN where it has fewer.

    None if one of them is not a plain decimal number that float64 can hold (nan, inf, 1e400 or something else).
    """
    _pieces(text, at, end)
    return cast("F64 | None", _native.text_numbers(text, at, end, columns, threads or os.cpu_count() or 1))


def text_corners(text: bytes, at: I64, end: I64, words: I64, threads: int = 0) -> tuple[I32, I32, I32] | None:
    """What the words v, v/t, v//n and v/t/n of each piece `at[i]` … `end[i]` of `text` name, `words[i]` of them each:
    v, t and n (sum of words,), 0 where a word names none. None if a word is something else, or beyond 32 bits."""
    _pieces(text, at, end)
    if words.shape != at.shape or (words < 0).any():
        raise InvalidMesh("each piece needs its number of words")
    until = np.cumsum(words, dtype=np.int64)
    begin, total = until - words, int(until[-1]) if len(until) else 0
    return cast(
        "tuple[I32, I32, I32] | None",
        _native.text_corners(text, at, end, begin, total, threads or os.cpu_count() or 1),
    )


def unique_rows(rows: NDArray[np.uint32]) -> tuple[I32, I32]:
    """Equal rows of `rows` (N, K): `first` (U,), where each distinct row appears first, ascending, and `inverse` (N,),
    for each row its place in `first`."""
    if rows.ndim != 2:
        raise InvalidMesh(f"rows must be a table (got the shape {rows.shape})")
    return cast("tuple[I32, I32]", _native.unique_rows(np.ascontiguousarray(rows, np.uint32)))


def _pieces(text: bytes, at: I64, end: I64) -> None:
    if at.shape != end.shape or (len(at) and (at.min() < 0 or (at > end).any() or end.max() > len(text))):
        raise InvalidMesh("pieces lie outside of the text")
