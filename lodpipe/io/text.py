"""Lines and numbers of large text files by array operations, without a Python step for each line."""

from __future__ import annotations

import codecs
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.errors import AssetError
from lodpipe.kernel import tables

_SPACES = np.zeros(256, bool)
_SPACES[[9, 10, 11, 12, 13, 32]] = True
_UTF16 = {codecs.BOM_UTF16_LE: "utf-16-le", codecs.BOM_UTF16_BE: "utf-16-be"}


def plain_text(data: bytes) -> bytes:
    """Text as bytes with \\n between lines; UTF-16 becomes UTF-8, a byte-order mark goes. AssetError: binary data."""
    encoding = _UTF16.get(data[:2])
    if encoding is None and len(data) >= 4 and b"\0" in data[:64]:
        # without a mark: Latin text in UTF-16 has a zero in every other byte
        half = data[: min(len(data), 64) & ~1]
        encoding = "utf-16-be" if not any(half[0::2]) else "utf-16-le" if not any(half[1::2]) else None
    if encoding is not None:
        try:
            data = data.decode(encoding).lstrip("\ufeff").encode()
        except UnicodeDecodeError as error:
            raise AssetError(f"it looks like {encoding} text but is not valid", advice="save it as UTF-8") from error
    data = data.removeprefix(codecs.BOM_UTF8)
    if b"\0" in data:
        raise AssetError("it holds binary data where text is expected", advice="check the file and its extension")
    if b"\r" in data and b"\n" not in data:
        data = data.replace(b"\r", b"\n")
    return data


def decode_name(data: bytes) -> str:
    """A name of a text file: UTF-8, or Latin-1 where it is not valid UTF-8."""
    try:
        return data.decode().strip()
    except UnicodeDecodeError:
        return data.decode("latin-1").strip()


def numbers(text: bytes, count: int) -> NDArray[np.float64]:
    """The `count` numbers that white space separates in `text`; NaN for each word that is none."""
    text = text.strip()
    if not text:
        return np.zeros(0)
    try:
        values = np.fromstring(text, np.float64, sep=" ") if _is_numeric(text) else np.zeros(0)
    except (ValueError, DeprecationWarning):
        values = np.zeros(0)
    if len(values) != count:
        values = np.array([_number(word) for word in text.split()])
    return values


def integers(text: bytes) -> NDArray[np.int64]:
    """The integers that white space separates in `text`, which holds digits and signs only."""
    text = text.strip()
    return np.fromstring(text, np.int64, sep=" ") if text else np.zeros(0, np.int64)


def _is_numeric(text: bytes) -> bool:
    """Whether only characters of numbers, nan and inf occur: np.fromstring stops at others."""
    return not text.translate(None, b"0123456789+-.eE \t\r\n\v\fnaNAiIfFtyTY")


def _number(word: bytes) -> float:
    try:
        return float(word)
    except ValueError:
        return float("nan")


class Lines:
    """A text cut into lines and words.

    start, end   (L,) byte offsets of each line, without its \\n
    words        (L,) number of words in each line
    first        (L,) byte offset of each line's first word; where there is none, of the line's end
    """

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.start, self.end, self.first, self.words, self._head = tables.text_lines(data)

    def __len__(self) -> int:
        return len(self.start)

    def starting(self, keyword: bytes) -> NDArray[np.intp]:
        """The lines, ascending, whose first word is `keyword`, of at most seven letters."""
        bits = 8 * len(keyword)
        same = self._head & np.uint64((1 << bits) - 1) == int.from_bytes(keyword, "little")
        found = np.flatnonzero(same)
        whole_word: NDArray[np.bool_] = _SPACES[self._head[found] >> np.uint64(bits) & np.uint64(255)]
        return found[whole_word]

    def text(self, lines: NDArray[np.intp]) -> bytes:
        """The chosen lines, ascending, each ended by \\n. Runs of neighbours are copied at once."""
        if not len(lines):
            return b""
        cut = np.flatnonzero(np.diff(lines) != 1)
        begin = self.start[lines[np.concatenate([[0], cut + 1])]].tolist()
        end = self.end[lines[np.concatenate([cut, [len(lines) - 1]])]].tolist()
        return b"\n".join([self.data[b:e] for b, e in zip(begin, end, strict=True)]) + b"\n"

    def body(self, lines: NDArray[np.intp], keyword: bytes) -> bytes:
        """The same with spaces in the place of `keyword`, with which each of the lines starts."""
        text, blank = self.text(lines), b" " * len(keyword)
        if text.count(keyword) == len(lines):
            return text.replace(keyword, blank)
        return b"\n".join([line.replace(keyword, blank, 1) for line in text.split(b"\n")])

    def rest(self, line: int, keyword: bytes) -> bytes:
        """What follows `keyword` in a line that it starts."""
        return self.data[int(self.first[line]) + len(keyword) : int(self.end[line])].strip()

    def table(self, lines: NDArray[np.intp], keyword: bytes, columns: int) -> tuple[NDArray[np.float64], NDArray[Any]]:
        """The numbers after `keyword`: (N, columns), NaN where a line has fewer; and how many each line has, (N,)."""
        count = self.words[lines] - 1
        plain = tables.text_numbers(self.data, self.first[lines] + len(keyword), self.end[lines], columns)
        if plain is not None:
            return plain, count
        values = numbers(self.body(lines, keyword), int(count.sum()))
        if len(count) and (count == count[0]).all() and count[0] >= columns:
            return values.reshape(len(lines), -1)[:, :columns], count
        begin = np.cumsum(count) - count
        result = np.full((len(lines), columns), np.nan)
        for k in range(columns):
            has = count > k
            result[has, k] = values[begin[has] + k]
        return result, count


def word_starts(codes: NDArray[np.uint8]) -> NDArray[np.intp]:
    """Offsets at which words start."""
    space = _SPACES[codes]
    start = ~space
    start[1:] &= space[:-1]
    return np.flatnonzero(start)


def strip_comments(data: bytes, keywords: bytes) -> bytes:
    """`data` without what follows a # in lines of numbers (lines whose first word is one of `keywords`, split by |).

    Lines of names are left alone: a name may hold a #.
    """
    if b"#" not in data:
        return data
    marks = np.flatnonzero(np.frombuffer(data, np.uint8) == ord("#"))
    if len(marks) < 1000 and not any(
        data[data.rfind(b"\n", 0, at) + 1 : at].strip()[:1].isalpha() for at in marks.tolist()
    ):
        return data
    return re.sub(rb"(?m)^([ \t]*(?:" + keywords + rb")[ \t][^#\n]*)#[^\n]*", rb"\1", data)
