"""Which way imports point: read from the source with `ast`, so that imports inside functions count as well."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

REPO = Path(__file__).parent.parent

MAY_IMPORT: dict[str, str] = {
    "core": "",
    "kernel": "core",
    "o3d": "core",
    "geometry": "o3d kernel core",
    "io": "o3d kernel core",
    "stage": "core",
    "stages": "stage geometry io o3d kernel core",
    "config": "stage io core",  # io: the defaults of its limits stand there
    "pipeline": "config stage core",
    "plugins": "stages stage core",
    "reporting": "core",
    "service": "lodpipe plugins pipeline reporting config stage io core",
    "cli": "lodpipe service plugins pipeline reporting config stages stage geometry io core",
    "__main__": "cli",
}
"""What each part may import besides itself, and with that all it may depend on; `lodpipe` is the bare package."""

ONLY_IN: dict[str, str | tuple[str, ...]] = {
    "open3d": "lodpipe/o3d.py",
    "lodpipe.kernel._native": (
        "lodpipe/kernel/__init__.py",
        *(f"lodpipe/kernel/{name}.py" for name in ("layout", "pictures", "surfaces", "tables")),
    ),
    "sqlite3": "lodpipe/service/",
    "signal": "lodpipe/service/",
    "multiprocessing": "lodpipe/service/",
}

PLUGINS_MAY_IMPORT = "stage core geometry"


@dataclass(frozen=True)
class Import:
    """One import: of what, where, and whether it happens when its module is imported."""

    target: str
    line: int
    at_once: bool


def imports(path: Path, module: str) -> Iterator[Import]:
    """Every import in a file; `from a import b` is of ``a.b``, `import_module("a")` of ``a``."""

    def visit(node: ast.AST, at_once: bool) -> Iterator[Import]:
        if isinstance(node, ast.Import):
            yield from (Import(alias.name, node.lineno, at_once) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
            base = package[: len(package) - node.level + 1] if node.level else []
            source = ".".join([*base, *([node.module] if node.module else [])])
            yield from (Import(f"{source}.{alias.name}", node.lineno, at_once) for alias in node.names)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in ("import_module", "__import__"):
            yield from (Import(str(a.value), node.lineno, at_once) for a in node.args if isinstance(a, ast.Constant))
        later = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) or (
            isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING")
        )
        for child in ast.iter_child_nodes(node):
            yield from visit(child, at_once and not later)

    return visit(ast.parse(path.read_text(encoding="utf-8"), str(path)), True)


def modules(root: Path) -> dict[str, Path]:
    """Dotted name -> file, for every module of lodpipe under `root`."""
    found = {}
    for path in sorted((root / "lodpipe").rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def is_of(target: str, module: str) -> bool:
    """Whether `target` is `module` or something in it."""
    return target == module or target.startswith(module + ".")


def part_of(target: str, place: int) -> str:
    """The name at that place in a dotted name, empty behind its end."""
    return [*target.split("."), "", ""][place]


def wrong_directions(root: Path) -> list[str]:
    """Imports against MAY_IMPORT, and between two stages."""
    found = []
    for module, path in modules(root).items():
        if module == "lodpipe":  # the public names come from everywhere
            continue
        part = module.split(".")[1]
        place = path.relative_to(root)
        if part not in MAY_IMPORT:
            found.append(f"{place}:1: lodpipe.{part} has no row in MAY_IMPORT; decide where it stands")
            continue
        for item in imports(path, module):
            if not is_of(item.target, "lodpipe"):
                continue
            other, sibling = part_of(item.target, 1) or "lodpipe", part_of(item.target, 2)
            if part == other == "stages" and module != "lodpipe.stages":
                if not sibling.startswith("_") and not is_of(item.target, module):
                    found.append(f"{place}:{item.line}: a stage imports another ({item.target})")
            elif other != part and other not in MAY_IMPORT[part].split():
                found.append(f"{place}:{item.line}: {part} must not import {item.target}")
    return found


def wrong_places(root: Path) -> list[str]:
    """Imports of what only one place may import (ONLY_IN), and of lodpipe's inner parts by plug-ins."""
    found = []
    for module, path in modules(root).items():
        place = path.relative_to(root).as_posix()
        for item in imports(path, module):
            for target, home in ONLY_IN.items():
                if is_of(item.target, target) and not place.startswith(home):
                    found.append(f"{place}:{item.line}: {target} is imported in {home} alone")
    for path in sorted((root / "plugins").rglob("*.py")):
        for item in imports(path, path.stem):
            part = part_of(item.target, 1)
            if is_of(item.target, "lodpipe") and part not in PLUGINS_MAY_IMPORT.split():
                found.append(f"{path.relative_to(root)}:{item.line}: a plug-in must not import {item.target}")
    return found


def cycles(root: Path) -> list[str]:
    """Modules that need each other while they are being imported."""
    known = modules(root)
    graph: dict[str, set[str]] = {}
    for module, path in known.items():
        wanted = [item.target for item in imports(path, module) if item.at_once]
        names = {name if name in known else name.rpartition(".")[0] for name in wanted}
        graph[module] = {name for name in names if name in known and name != module and not is_of(module, name)}
    found: list[str] = []

    def visit(module: str, trail: list[str]) -> None:
        if module in trail:
            found.append("import cycle: " + " -> ".join([*trail[trail.index(module) :], module]))
        elif module in graph:
            for name in sorted(graph[module]):
                visit(name, [*trail, module])
            graph.pop(module, None)

    for module in list(graph):
        visit(module, [])
    return found


def slow_start(root: Path) -> list[str]:
    """Third-party imports that happen when lodpipe.cli is imported, directly or through other modules."""
    known = modules(root)
    todo, seen, found = ["lodpipe", "lodpipe.cli"], set(), []
    while todo:
        module = todo.pop()
        if module in seen or module not in known:
            continue
        seen.add(module)
        for item in imports(known[module], module):
            if not item.at_once:
                continue
            parts = item.target.split(".")
            if parts[0] == "lodpipe":
                todo.extend(".".join(parts[:count]) for count in range(1, len(parts) + 1))
            elif parts[0] not in sys.stdlib_module_names and parts[0] != "__future__":
                place = known[module].relative_to(root)
                found.append(f"{place}:{item.line}: {parts[0]} is imported whenever the program starts")
    return found


CHECKS = [wrong_directions, wrong_places, cycles, slow_start]


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_of_this_project(check):
    assert len(modules(REPO)) > 10
    assert check(REPO) == []


def write(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


@pytest.mark.parametrize(
    ("check", "files", "complaint"),
    [
        (wrong_directions, {"core/mesh.py": "import lodpipe.geometry"}, "core/mesh.py:1: core must not import"),
        (wrong_directions, {"core/mesh.py": "def f():\n from lodpipe import io"}, "core/mesh.py:2: core must not"),
        (wrong_directions, {"core/mesh.py": "from .. import stage"}, "core must not import lodpipe.stage"),
        (wrong_directions, {"core/mesh.py": "from lodpipe import load"}, "core must not import lodpipe.load"),
        (wrong_directions, {"core/mesh.py": "import lodpipe"}, "core must not import lodpipe"),
        (wrong_directions, {"io/gltf.py": "from lodpipe.geometry.atlas import x"}, "io must not import"),
        (wrong_directions, {"reporting/html.py": "from lodpipe.pipeline import run"}, "reporting must not import"),
        (wrong_directions, {"pipeline.py": "import lodpipe.stages"}, "pipeline must not import"),
        (wrong_directions, {"stages/a.py": "from lodpipe.stages.b import f"}, "stages/a.py:1: a stage imports another"),
        (wrong_directions, {"stages/a.py": "from . import b"}, "stages/a.py:1: a stage imports another"),
        (wrong_directions, {"helpers.py": ""}, "helpers has no row"),
        (wrong_places, {"geometry/bake.py": "import open3d as o3d"}, "bake.py:1: open3d is imported in"),
        (wrong_places, {"geometry/bake.py": "def f():\n from open3d.t import x"}, "bake.py:2: open3d is imported in"),
        (wrong_places, {"io/a.py": "import importlib\nimportlib.import_module('open3d')"}, "a.py:2: open3d"),
        (wrong_places, {"kernel/reference.py": "from . import _native"}, "reference.py:1: lodpipe.kernel._native"),
        (wrong_places, {"cli.py": "import signal"}, "signal is imported in lodpipe/service/ alone"),
        (wrong_places, {"pipeline.py": "from multiprocessing import Pool"}, "multiprocessing is imported in"),
        (wrong_places, {"../plugins/p.py": "from lodpipe.kernel import x"}, "a plug-in must not import lodpipe.kernel"),
        (
            cycles,
            {"io/a.py": "import lodpipe.io.b", "io/b.py": "from lodpipe.io import a"},
            "import cycle: lodpipe.io.a",
        ),
        (slow_start, {"cli.py": "import numpy"}, "cli.py:1: numpy is imported whenever"),
        (slow_start, {"cli.py": "", "__init__.py": "from lodpipe.x import y", "x.py": "import yaml"}, "x.py:1: yaml"),
        (
            slow_start,
            {"cli.py": "import lodpipe.io.x", "io/__init__.py": "import open3d"},
            "open3d is imported whenever",
        ),
    ],
)
def test_a_violation_is_found(tmp_path, check, files, complaint):
    root = write(tmp_path, {"lodpipe/__init__.py": ""} | {f"lodpipe/{name}": text for name, text in files.items()})
    assert any(complaint in line for line in check(root)), check(root)


def test_what_is_allowed_is_not_complained_of(tmp_path):
    files = {
        "lodpipe/__init__.py": "",
        "lodpipe/cli.py": "import argparse\ndef main():\n import numpy\n from lodpipe.service import daemon",
        "lodpipe/o3d.py": "import open3d\nfrom lodpipe.core import mesh",
        "lodpipe/core/mesh.py": "import numpy\nfrom lodpipe.core import errors",
        "lodpipe/core/errors.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n from lodpipe.core import mesh",
        "lodpipe/kernel/__init__.py": "from . import _native",
        "lodpipe/service/queue.py": "import sqlite3, signal, multiprocessing",
        "lodpipe/stages/__init__.py": "from lodpipe.stages import a, b",
        "lodpipe/stages/a.py": "from lodpipe.stages import _shared\nfrom lodpipe.geometry import atlas",
        "lodpipe/stages/b.py": "from lodpipe.io import gltf",
        "plugins/p.py": "from lodpipe.stage import stage",
    }
    write(tmp_path, files)
    assert [line for check in CHECKS for line in check(tmp_path)] == []


def test_help_starts_without_third_party_packages():
    """The same as `slow_start`, but as it really happens: `lodpipe --help` in a fresh interpreter."""
    code = (
        "import sys\n"
        "from lodpipe.cli import main\n"
        "try:\n main(['--help'])\nexcept SystemExit as end:\n assert not end.code, end.code\n"
        "names = {name.partition('.')[0] for name in sys.modules}\n"
        "print('FOREIGN', *sorted(names & {'numpy', 'open3d', 'pydantic', 'yaml', 'PIL', 'DracoPy', 'scipy'}))\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert "usage" in run.stdout.lower()
    assert run.stdout.splitlines()[-1].strip() == "FOREIGN"


def test_a_plain_run_loads_neither_open3d_nor_scipy(tmp_path: Path):
    """They take a second and half a second to load, as long as a small model's whole run."""
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    code = (
        "import sys\nfrom lodpipe.cli import main\n"
        f"main(['run', {str(tmp_path / 'm.obj')!r}, '-c', 'fast', '-o', {str(tmp_path / 'out')!r}])\n"
        "print([name for name in ('open3d', 'scipy', 'xatlas') if name in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.splitlines()[-1] == "[]"
