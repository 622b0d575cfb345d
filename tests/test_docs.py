"""Every python, yaml and console block of the README and the documentation works as it stands there.

The blocks of a page are followed from top to bottom in a folder of its own, which has a ``model.glb``, a folder
``models`` and copies of ``plugins`` and ``config``. A block whose first line is a comment with a file name (``#
plugins/mine.py``) is saved under it; files named ``test_…`` are run by pytest.

* python: runs; the blocks of a page share their names.
* yaml: a complete configuration; it loads, and the schema accepts it.
* console: lines after ``$`` are run. What stands below a command are lines of its output, in order, ``…`` standing for
  anything; where an ``error:`` is shown the command must fail, else it must not.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import jsonschema
import numpy as np
import pytest

import lodpipe
from lodpipe.config.schema import json_schema
from lodpipe.config.source import read_text
from lodpipe.pipeline import Pipeline
from meshes import sphere

REPO = Path(__file__).parent.parent
PAGES = [REPO / "README.md", *sorted((REPO / "docs").glob("*.md"))]
LANGUAGES = ("python", "yaml", "console")
PROGRAMS = ("lodpipe", "python", "ls", "cat", "mkdir", "cp")
"""What may be run. `make` targets and installations are only looked at: other tests run them."""
LOOKED_AT = ("make", "git", "pip", "cd", "source", ".", "sudo", "apt-get")
SECONDS = 120


@dataclass(frozen=True)
class Block:
    """A fenced block and where it stands."""

    language: str
    text: str
    line: int

    @property
    def file(self) -> str:
        """The name in its first line, if that is a comment with one."""
        match = re.match(r"# ([\w./-]+\.(?:py|yaml))\n", self.text)
        return match[1] if match else ""


def blocks(text: str) -> list[Block]:
    pattern = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
    return [Block(m[1], m[2], text.count("\n", 0, m.start()) + 2) for m in pattern.finditer(text)]


def commands(text: str) -> Iterator[tuple[str, list[str]]]:
    """(command, expected lines) of a console block."""
    for part in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]:
        command, _, output = part.replace("\\\n", " ").partition("\n")
        yield command, [line.strip() for line in output.splitlines() if line.strip()]


def missing(expected: list[str], output: str) -> str:
    """The first expected line that is not in the output after those before it; empty if all are."""
    lines = [line.strip() for line in output.splitlines()]
    for line in expected:
        if line == "…":
            continue
        pattern = re.compile(".*".join(map(re.escape, line.split("…"))))
        found = next((number for number, got in enumerate(lines) if pattern.fullmatch(got)), None)
        if found is None:
            return line
        lines = lines[found + 1 :]
    return ""


def follow(page: str) -> list[str]:
    """Do what a page says, in the working directory; what does not work."""
    wrong: list[str] = []
    names: dict[str, object] = {"__name__": "__docs__"}
    for block in blocks(page):
        if block.file and block.language in LANGUAGES:
            Path(block.file).parent.mkdir(parents=True, exist_ok=True)
            Path(block.file).write_text(block.text, encoding="utf-8")
        try:
            if block.language == "yaml":
                check_yaml(block.text)
            elif block.language == "console":
                for command, expected in commands(block.text):
                    check_command(command, expected)
            elif block.language == "python" and Path(block.file).name.startswith("test_"):
                check_command(f"python -m pytest -q -p no:cacheprovider {block.file}", [])
            elif block.language == "python" and not block.file:
                exec(compile(block.text, f"block at line {block.line}", "exec"), names)
            elif block.language == "python":
                compile(block.text, block.file, "exec")
        except Exception as error:
            wrong.append(f"line {block.line}: {type(error).__name__}: {error}")
    return wrong


def check_yaml(text: str) -> None:
    known = lodpipe.find_stages([Path("plugins")], installed=False)
    source = read_text(text, "block")
    Pipeline.load(source, known)
    jsonschema.validate(source.data, json_schema(known))


def check_command(command: str, expected: list[str]) -> None:
    program = command.split()[0]
    if program == "make":
        targets = (REPO / "Makefile").read_text(encoding="utf-8")
        wanted = [word for word in command.split()[1:] if "=" not in word]
        assert all(re.search(rf"^{target}:", targets, re.MULTILINE) for target in wanted), f"no such target: {command}"
        return
    if program in LOOKED_AT:
        return
    assert program in PROGRAMS, f"{program} is not a program that documentation may run"
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        ["bash", "-c", command],
        capture_output=True,
        text=True,
        timeout=SECONDS,
        check=False,
        env=os.environ | {"PATH": path, "PYTHONPATH": str(REPO)},
    )
    output = done.stdout + done.stderr
    fails = any(line.startswith("error:") for line in expected)
    assert (done.returncode != 0) is fails, f"`{command}` ended with {done.returncode}:\n{output}"
    lost = missing(expected, output)
    assert not lost, f"`{command}` does not say '{lost}':\n{output}"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working directory of a page."""
    monkeypatch.chdir(tmp_path)
    for name in ("plugins", "config"):
        shutil.copytree(REPO / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "sample_assets").symlink_to(REPO / "sample_assets")
    (tmp_path / "models" / "animals").mkdir(parents=True)
    positions, faces = sphere(3)
    uv = np.stack([np.arctan2(positions[:, 1], positions[:, 0]) / 7 + 0.5, positions[:, 2] / 2 + 0.5], axis=1)
    mesh = lodpipe.Mesh(positions * [1.0, 0.8, 0.6], faces, attributes={"TEXCOORD_0": uv, "NORMAL": positions})
    for path in ("model.glb", "models/cup.glb", "models/animals/duck.obj"):
        lodpipe.save(lodpipe.Asset(Path(path).stem, (mesh,)), tmp_path / path)
    return tmp_path


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_block_works(folder, page):
    assert follow(page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_fence_has_a_language_and_every_link_a_target(page):
    text = page.read_text(encoding="utf-8")
    assert [block.line for block in blocks(text) if not block.language] == []
    assert text.count("\n```") % 2 == 0
    targets = re.findall(r"\]\(([^)#]+)[^)]*\)", text)
    assert [t for t in targets if "://" not in t and not (page.parent / t).exists()] == []


@pytest.mark.parametrize(
    ("page", "complaint"),
    [
        ("```python\n1 / 0\n```\n", "line 2: ZeroDivisionError"),
        ("```python\nx = 1\n```\n\n```python\nassert x == 2\n```\n", "line 6: AssertionError"),
        ("```python\n# plugins/a.py\ndef broken(:\n```\n", "line 2: SyntaxError"),
        ("```python\n# test_a.py\ndef test_a():\n    assert False\n```\n", "line 2: AssertionError"),
        ("```yaml\nversion: 1\nstages: [exprt]\n```\n", "line 2: ConfigErrors: block:2:10: stages[0]: unknown stage"),
        ("```console\n$ lodpipe check nothing\n```\n", "line 2: AssertionError: `lodpipe check nothing` ended with 1"),
        ("```console\n$ lodpipe check fast\nerror: no\n```\n", "ended with 0"),
        ("```console\n$ lodpipe check fast\nfast: ok\n```\n", "does not say 'fast: ok'"),
        ("```console\n$ make nothing-like-it\n```\n", "no such target"),
        ("```console\n$ rm -rf x\n```\n", "rm is not a program that documentation may run"),
    ],
)
def test_a_block_that_does_not_work_is_found(folder, page, complaint):
    (line,) = follow(page)
    assert complaint in line


def test_what_works_is_not_complained_of(folder):
    page = "```console\n$ lodpipe check fast\nfast: ok: … → export\n$ make test\n```\n\n```python\nx = 1\n```\n"
    assert follow(page + "\n```python\nassert x == 1\n```\n\n```text\nanything $\n```\n") == []


def test_expected_lines_are_looked_for_in_order():
    assert missing(["a", "…", "c…d"], "a\nb\nc d\n") == ""
    assert missing(["c", "a"], "a\nc\n") == "a"
