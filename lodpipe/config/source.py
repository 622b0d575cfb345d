"""YAML text to plain data, with the place of every key and value, so that errors can point at them.

The scalars are those of YAML 1.2's core schema (`no` is text, `1e-3` a number), a key may stand only once, and what
a hostile file could blow up (aliases, depth, size) is bounded.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from lodpipe.config.problems import Problem, Problems
from lodpipe.core.errors import ConfigError

Path_ = tuple[str | int, ...]
"""Where a value stands in the data: ``("stages", 1, "decimate", "ratios", 1)``."""

MAX_BYTES = 1_000_000
MAX_VALUES = 10_000
MAX_DEPTH = 40

_INTEGER = re.compile(r"[-+]?[0-9][0-9_]{0,30}|0x[0-9a-fA-F]{1,16}")
_NUMBER = re.compile(r"[-+]?(?:[0-9][0-9_]*\.?[0-9_]*|\.[0-9][0-9_]*)(?:[eE][-+]?[0-9]{1,3})?")
_PLAIN_TAGS = {f"tag:yaml.org,2002:{kind}" for kind in ("str", "seq", "map")}
_WORDS: dict[str, Any] = {"": None, "~": None, "null": None, "true": True, "false": False}


@dataclass
class Source:
    """A configuration as it was written: plain data and where each part of it stands."""

    name: str
    """The file as the user wrote its name, or what else the data came from."""
    data: Any
    folder: Path | None = None
    """The configuration's own folder: relative paths in it start there."""
    values: dict[Path_, str] = field(default_factory=dict)
    """Place of each value, ``chain.yaml:9:20``."""
    keys: dict[Path_, str] = field(default_factory=dict)
    """Place of each mapping key."""

    def place(self, path: Path_, *, key: bool = False) -> str:
        """The place of a value, or of its key; of the nearest enclosing one where it was not written down."""
        if key and path in self.keys:
            return self.keys[path]
        while path not in self.values and path:
            path = path[:-1]
        return self.values.get(path, self.name)


def read_file(path: Path, name: str | None = None) -> Source:
    """The YAML file `path`. Raises ConfigError for what is not readable as one configuration."""
    name = name or str(path)
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise ConfigError(
            f"cannot be read ({error.strerror})", place=name, advice="give a file, or a preset's name"
        ) from error
    if len(raw) > MAX_BYTES:
        raise ConfigError(f"has {len(raw)} bytes, more than a configuration may have ({MAX_BYTES})", place=name)
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ConfigError("is not UTF-8 text", place=f"{name}:{line}", advice="save it as UTF-8") from error
    source = read_text(text, name)
    source.folder = path.parent
    return source


def read_text(text: str, name: str) -> Source:
    """The YAML text of a configuration called `name`. Raises ConfigError."""
    problems = Problems()
    source = Source(name, None)
    try:
        _bound(text)
        node = yaml.compose(text, Loader=yaml.BaseLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{name}:{mark.line + 1}:{mark.column + 1}" if mark else name
        raise ConfigError(f"is not valid YAML: {error.problem or error.context}", place=place) from error
    except yaml.YAMLError as error:
        raise ConfigError(f"is not valid YAML: {error}", place=name) from error
    except _TooMuch as error:
        raise ConfigError(str(error), place=name) from error
    if node is not None:
        try:
            source.data = _Reader(source, problems).value(node, ())
        except _TooMuch as error:
            raise ConfigError(str(error), place=name) from error
    problems.raise_all()
    return source


def scalar(text: str) -> Any:
    """A plain (unquoted) YAML scalar as None, bool, int, float or str."""
    if text.lower() in _WORDS and (text.islower() or text in ("", "~") or text.istitle() or text.isupper()):
        return _WORDS[text.lower()]
    if _INTEGER.fullmatch(text):
        return int(text.replace("_", ""), 16 if text.lower().startswith("0x") else 10)
    if _NUMBER.fullmatch(text) and math.isfinite(number := float(text.replace("_", ""))):
        return number
    return text


def dump(data: Any) -> str:
    """Plain data as YAML text that reads back as the same data."""
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, width=110)


class _Dumper(yaml.SafeDumper):
    """Quotes what `scalar` would read as something else than text; PyYAML's own rules take 0E0 for a word."""


def _text(dumper: _Dumper, text: str) -> yaml.ScalarNode:
    style = None if isinstance(scalar(text), str) else "'"
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _text)


class _TooMuch(Exception):
    """The document is larger or deeper than any configuration is."""


def _bound(text: str) -> None:
    """Refuse depth before the composer, which is recursive, walks into it."""
    depth = 0
    for event in yaml.parse(text, Loader=yaml.BaseLoader):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > MAX_DEPTH:
            raise _TooMuch(f"is nested more than {MAX_DEPTH} deep")


class _Reader:
    """Turns YAML nodes into data, noting places and collecting problems."""

    def __init__(self, source: Source, problems: Problems) -> None:
        self.source = source
        self.problems = problems
        self.count = 0

    def value(self, node: yaml.Node, path: Path_) -> Any:
        self.count += 1
        if self.count > MAX_VALUES:
            raise _TooMuch(f"holds more than {MAX_VALUES} values (aliases counted each time they are used)")
        if len(path) > MAX_DEPTH:
            raise _TooMuch(f"is nested more than {MAX_DEPTH} deep (an alias inside itself?)")
        self.source.values[path] = self._place(node)
        if node.tag not in _PLAIN_TAGS:
            self.problems.add(Problem(self._place(node), "", f"the tag {node.tag} is not supported"))
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, path)
        if isinstance(node, yaml.SequenceNode):
            return [self.value(child, (*path, index)) for index, child in enumerate(node.value)]
        quoted = isinstance(node, yaml.ScalarNode) and node.style is not None
        return node.value if quoted else scalar(node.value)

    def _mapping(self, node: yaml.MappingNode, path: Path_) -> dict[str, Any]:
        result: dict[str, Any] = {}
        first: dict[str, int] = {}
        for key_node, value_node in node.value:
            place = self._place(key_node)
            if not isinstance(key_node, yaml.ScalarNode):
                self.problems.add(Problem(place, "", "a key must be a plain word"))
                continue
            key: str = key_node.value
            if key in first:
                self.problems.add(Problem(place, "", f"duplicate key '{key}' (first on line {first[key]})"))
                continue
            first[key] = key_node.start_mark.line + 1
            self.source.keys[(*path, key)] = place
            result[key] = self.value(value_node, (*path, key))
        return result

    def _place(self, node: yaml.Node) -> str:
        mark = node.start_mark
        return f"{self.source.name}:{mark.line + 1}:{mark.column + 1}"
