from __future__ import annotations

import numpy as np
import pytest

from lodpipe.core.errors import AssetError
from lodpipe.io.text import Lines, decode_name, numbers, plain_text, strip_comments


def test_lines_are_found_by_their_first_word() -> None:
    lines = Lines(b"v 1 2 3\n\n  v\t4 5 6  \nvn 0 0 1\nv")
    assert lines.starting(b"v").tolist() == [0, 2, 4]
    assert lines.starting(b"vn").tolist() == [3]
    assert lines.words.tolist() == [4, 0, 4, 4, 1]
    assert lines.text(np.array([0, 2, 3])) == b"v 1 2 3\n  v\t4 5 6  \nvn 0 0 1\n"
    assert lines.rest(3, b"vn") == b"0 0 1"


def test_a_table_has_nan_where_a_line_is_short() -> None:
    lines = Lines(b"v 1 2 3 9\nv 4 5\nv 7 8 x\n")
    table, count = lines.table(lines.starting(b"v"), b"v", 3)
    assert np.array_equal(table, [[1, 2, 3], [4, 5, np.nan], [7, 8, np.nan]], equal_nan=True)
    assert count.tolist() == [4, 2, 3]


def test_a_keyword_inside_a_line_is_a_word_like_others() -> None:
    lines = Lines(b"v 1 v 3\nv 4 5v 6\n")
    table, _ = lines.table(lines.starting(b"v"), b"v", 3)
    assert np.array_equal(table, [[1, np.nan, 3], [4, np.nan, 6]], equal_nan=True)


@pytest.mark.parametrize("text", [b"1 -2.5e3 .5 nan -inf", b"1\t-2.5e3\r\n.5 NaN -Infinity"])
def test_numbers(text: bytes) -> None:
    assert np.array_equal(numbers(text, 5), [1, -2500, 0.5, np.nan, -np.inf], equal_nan=True)


@pytest.mark.parametrize("text", [b"1 x 3", b"1 2,0 3", b"1 -- 3", b"1 e 3"])
def test_words_that_are_no_numbers_become_nan(text: bytes) -> None:
    assert np.array_equal(numbers(text, 3), [1, np.nan, 3], equal_nan=True)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
def test_encodings(encoding: str) -> None:
    assert plain_text("v 1 2 3\no Ö\n".encode(encoding)) == "v 1 2 3\no Ö\n".encode()


def test_other_line_ends_and_binary_data() -> None:
    assert plain_text(b"a\rb\r") == b"a\nb\n"
    with pytest.raises(AssetError, match="binary data"):
        plain_text(b"v 1 2 3\n" * 20 + b"\0\1")
    with pytest.raises(AssetError, match="utf-16"):
        plain_text(b"\xff\xfe\x00\xd8")
    assert decode_name("Körper".encode("latin-1")) == "Körper" == decode_name("Körper".encode())


def test_comments_go_from_lines_of_numbers_only() -> None:
    assert strip_comments(b"v 1 2 3 # v 9\nusemtl wood #2\n# f\n", b"v|f") == b"v 1 2 3 \nusemtl wood #2\n# f\n"
    many = b"# one # two\n" * 2000 + b"f 1 2 3#x\n"
    assert strip_comments(many, b"v|f").endswith(b"# two\nf 1 2 3\n")
