"""Lines, numbers and rows against plain Python."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lodpipe.core.errors import InvalidMesh
from lodpipe.kernel.tables import text_corners, text_lines, text_numbers, unique_rows


@given(st.lists(st.sampled_from([b"v", b"1", b" ", b"\t", b"\n", b"\r", b"\v", b"\f", b"longer-than-eight", b"\xff"])))
def test_lines_words_and_heads(pieces):
    text = b"".join(pieces)
    start, end, first, words, head = text_lines(text)
    lines = text.split(b"\n")
    assert [text[s:e] for s, e in zip(start, end, strict=True)] == lines
    assert words.tolist() == [len(line.split()) for line in lines]
    assert [text[f:e] for f, e in zip(first, end, strict=True)] == [line.lstrip(b" \t\r\v\f") for line in lines]
    assert [int(h).to_bytes(8, "little") for h in head] == [(text + b" " * 8)[f : f + 8] for f in first]


@given(st.lists(st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=5), max_size=20))
def test_numbers_to_the_last_bit(rows):
    text = "\n".join(" ".join(map(repr, row)) for row in rows).encode()
    start, end, *_ = text_lines(text)
    expected = [row[:3] + [np.nan] * (3 - len(row)) for row in rows] or [[np.nan] * 3]
    np.testing.assert_array_equal(text_numbers(text, start, end, 3), expected)


@pytest.mark.parametrize("word", ["+1", "-.5", "5.", "1e5", "1E-5", "+.5e+2", "007", "-0"])
def test_ways_to_write_a_number(word):
    start, end, *_ = text_lines(word.encode())
    assert text_numbers(word.encode(), start, end, 1)[0, 0] == float(word)


@pytest.mark.parametrize(
    "word",
    [
        "nan",
        "inf",
        "-inf",
        "1e400",
        "x",
        "1x",
        "1.0.0",
        "--",
        "+-1",
        "++1",
        "-",
        "+",
        ".",
        "e5",
        "1_0",
        "0x10",
        "1,0",
        "5v",
    ],
)
def test_words_that_are_left_to_others(word):
    start, end, *_ = text_lines(word.encode())
    assert text_numbers(word.encode(), start, end, 1) is None


def test_corners():
    text = b"1/2/3 -4//5\t6/7 8 9/ 10/11/\r\n+1\n"
    start, end, _, words, _ = text_lines(text)
    parts = text_corners(text, start, end, words.astype(np.int64))
    expected = [(1, 2, 3), (-4, 0, 5), (6, 7, 0), (8, 0, 0), (9, 0, 0), (10, 11, 0), (1, 0, 0)]
    assert list(zip(*(part.tolist() for part in parts), strict=True)) == expected


@given(st.text("12/-+x ", max_size=12))
def test_corners_are_what_the_pattern_says(text):
    word = r"[+-]?\d+(/([+-]?\d+)?(/([+-]?\d+)?)?)?"
    start, end, _, words, _ = text_lines(text.encode())
    good = all(re.fullmatch(word, w) for w in text.split())
    assert (text_corners(text.encode(), start, end, words.astype(np.int64)) is not None) == good


@pytest.mark.parametrize("word", ["2147483648", "99999999999999999999", "1/2/3/4", "/1", "1.5"])
def test_corners_that_are_left_to_others(word):
    start, end, _, words, _ = text_lines(word.encode())
    assert text_corners(word.encode(), start, end, words.astype(np.int64)) is None


def test_rows():
    rows = np.array([[1, 2], [2, 1], [1, 2], [0, 0]], np.uint32)
    first, inverse = unique_rows(rows)
    assert (first.tolist(), inverse.tolist()) == ([0, 1, 3], [0, 1, 0, 2])
    assert [len(part) for part in unique_rows(np.zeros((0, 3), np.uint32))] == [0, 0]


def test_what_is_refused():
    with pytest.raises(InvalidMesh, match="outside of the text"):
        text_numbers(b"1", np.array([0]), np.array([5]), 1)
    with pytest.raises(InvalidMesh, match="number of words"):
        text_corners(b"1", np.array([0]), np.array([1]), np.array([-1]))
    with pytest.raises(InvalidMesh, match="table"):
        unique_rows(np.zeros(3, np.uint32))
