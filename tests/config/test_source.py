"""YAML with places: scalars of YAML 1.2, lines and columns, and everything hostile refused in one line."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from lodpipe.config.source import MAX_BYTES, MAX_DEPTH, MAX_VALUES, dump, read_file, read_text, scalar
from lodpipe.core.errors import ConfigError


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1),
        ("-7", -7),
        ("20_000_000", 20_000_000),
        ("0x1f", 31),
        ("010", 10),
        ("1.5", 1.5),
        (".5", 0.5),
        ("1e-3", 0.001),
        ("1e999", "1e999"),
        (".inf", ".inf"),
        (".nan", ".nan"),
        ("true", True),
        ("False", False),
        ("tRUE", "tRUE"),
        ("no", "no"),
        ("on", "on"),
        ("null", None),
        ("~", None),
        ("", None),
        ("1:30", "1:30"),
        ("2024-01-01", "2024-01-01"),
        ("9" * 5000, "9" * 5000),
    ],
)
def test_plain_scalars(text, value):
    got = scalar(text)
    assert got == value
    assert type(got) is type(value)


def test_quoted_scalars_stay_text():
    assert read_text("a: \"1\"\nb: 'true'\nc: |\n  12\n", "x").data == {"a": "1", "b": "true", "c": "12\n"}


def test_places_of_keys_and_values():
    source = read_text("stages:\n  - decimate:\n      ratios: [0.5, 2]\n", "chain.yaml")
    assert source.place(("stages", 0, "decimate"), key=True) == "chain.yaml:2:5"
    assert source.place(("stages", 0, "decimate", "ratios", 1)) == "chain.yaml:3:21"
    assert source.place(("stages", 0, "decimate", "nothing")) == "chain.yaml:3:7"
    assert source.place(("elsewhere",)) == "chain.yaml:1:1"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("a: 1\nb: 2\na: 3", "x:3:1: duplicate key 'a' (first on line 1)"),
        ("a: b: c", "x:1:5: is not valid YAML: mapping values are not allowed here"),
        ("a:\n\t- b", "x:2:1: is not valid YAML: found character '\\t' that cannot start any token"),
        ("a: *b", "x:1:4: is not valid YAML: found undefined alias 'b'"),
        ("--- 1\n--- 2", "x:2:1: is not valid YAML: but found another document"),
        ("? [1]\n: 2", "x:1:3: a key must be a plain word"),
        ("a: !!python/name:os.system x", "x:1:4: the tag tag:yaml.org,2002:python/name:os.system is not supported"),
        ("\x07", "x: is not valid YAML: unacceptable character #x0007: special characters are not allowed"),
        ("&a [*a]", f"x: is nested more than {MAX_DEPTH} deep (an alias inside itself?)"),
        ("[" * 5000, f"x: is nested more than {MAX_DEPTH} deep"),
    ],
)
def test_bad_yaml_is_one_clear_line(text, line):
    with pytest.raises(ConfigError) as caught:
        read_text(text, "x")
    assert str(caught.value).startswith(line)
    assert "\n" not in str(caught.value)


def test_an_alias_bomb_is_refused_at_once():
    rows = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    rows += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 12)]
    with pytest.raises(ConfigError, match=f"more than {MAX_VALUES} values"):
        read_text("\n".join(rows), "bomb.yaml")


def test_an_alias_is_fine():
    assert read_text("a: &x {b: 1}\nc: *x", "x").data == {"a": {"b": 1}, "c": {"b": 1}}


def test_files_that_cannot_be_read(tmp_path):
    path = tmp_path / "latin1.yaml"
    path.write_bytes("version: 1\nname: größe\n".encode("latin-1"))
    with pytest.raises(ConfigError, match=r"latin1\.yaml:2: is not UTF-8 text; save it as UTF-8"):
        read_file(path)
    path.write_bytes(b"a: " + b"x" * MAX_BYTES)
    with pytest.raises(ConfigError, match="has 1000003 bytes"):
        read_file(path)
    with pytest.raises(ConfigError, match=r"cannot be read \(Is a directory\)"):
        read_file(tmp_path)


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path):
    path = tmp_path / "bom.yaml"
    path.write_bytes(b"\xef\xbb\xbfversion: 1\n")
    assert read_file(path).data == {"version": 1}


PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**12), 10**12) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.from_regex(r"[a-z]{1,5}", fullmatch=True), inner),
    max_leaves=10,
)


@given(st.dictionaries(st.from_regex(r"[a-z]{1,5}", fullmatch=True), PLAIN, min_size=1, max_size=4))
@example({"a": "0E0", "b": "1_0", "c": ["0x1F", "yes", "1e5", "null", "12", ""]})
def test_dump_reads_back_as_the_same(data):
    assert read_text(dump(data), "x").data == data


@given(st.text(max_size=60))
def test_any_text_is_data_or_one_clear_error(text):
    try:
        read_text(text, "x")
    except ConfigError as error:
        assert str(error).startswith("x")
