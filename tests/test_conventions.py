"""What the project has agreed on and no other tool checks. Each check is a function of a folder, seen failing below."""

from __future__ import annotations

import dataclasses
import functools
import re
import subprocess
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from lodpipe.plugins import find_stages
from lodpipe.stage import AnyStage, Params, stage
from lodpipe.stages import BUILTIN

REPO = Path(__file__).parent.parent

MAX_LINES = 600
MAX_LINE = 1000  # characters; a longer one was written by a machine
MAX_BYTES = 2_000_000
TEXT = {
    ".py",
    ".cpp",
    ".h",
    ".txt",
    ".md",
    ".toml",
    ".yaml",
    ".json",
    ".sh",
    ".html",
    ".css",
    ".js",
    ".bib",
    "",
}
NOT_OURS = {".git", ".venv", "build", "dist", "out", "node_modules", "__pycache__"}


@functools.cache
def files(root: Path) -> list[Path]:
    """The files that belong to the project: those that git knows or would take; without git, all but built ones."""
    listed = ["git", "-C", str(root), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    if (root / ".git").exists():
        names = subprocess.run(listed, capture_output=True, check=True, text=True).stdout.split("\0")
        found = [root / name for name in names if name]
    else:
        found = [path for path in root.rglob("*") if not NOT_OURS & set(path.relative_to(root).parts)]
    return sorted(path for path in found if path.is_file())


def lines(root: Path, suffixes: set[str] = TEXT) -> Iterator[tuple[str, str]]:
    """(``file:line``, text) for every line of the project's text files."""
    for path in files(root):
        if path.suffix in suffixes:
            for number, line in enumerate(path.read_text(encoding="utf-8").split("\n"), 1):
                yield f"{path.relative_to(root)}:{number}", line


def long_files(root: Path) -> list[str]:
    counts = {path: path.read_text(encoding="utf-8").count("\n") for path in files(root) if path.suffix == ".py"}
    return [
        f"{path.relative_to(root)}: {n} lines, more than {MAX_LINES}" for path, n in counts.items() if n > MAX_LINES
    ]


def minified(root: Path) -> list[str]:
    return [f"{place}: {len(line)} characters" for place, line in lines(root) if len(line) > MAX_LINE]


def large_files(root: Path) -> list[str]:
    return [f"{path.relative_to(root)}: too large" for path in files(root) if path.stat().st_size > MAX_BYTES]


def machine_paths(root: Path) -> list[str]:
    """Paths of somebody's machine: a home folder, or the folder that this clone lies in."""
    known = [re.escape(str(path)) for path in (REPO, Path.home()) if len(path.parts) > 2]
    pattern = re.compile(
        "|".join([r"/home/[a-z]\w*/", r"/Users/\w+/", r"(?<![\w.])/roo[t]/", r"\b[A-Z]:\\Users", *known])
    )
    return [f"{place}: {found[0]}" for place, line in lines(root) if (found := pattern.search(line))]


def unfinished(root: Path) -> list[str]:
    """Marks of unfinished work in code."""
    pattern = re.compile(r"\b(?:TO" r"DO|FIX" r"ME|XX" r"X|HA" r"CK)\b")
    code = {".py", ".cpp", ".h", ".sh", ".js", ".yaml", ".toml"}
    return [f"{place}: {found[0]}" for place, line in lines(root, code) if (found := pattern.search(line))]


def silenced(root: Path) -> list[str]:
    """Checkers told to be quiet without a reason on the same line (``# noqa: B008 because …``)."""
    bare = re.compile(r"#\s*(?:noqa(?::\s*[A-Z]+[0-9]+(?:,\s*[A-Z]+[0-9]+)*)?|type:\s*ignore(?:\[[\w, -]+\])?)\s*$")
    return [f"{place}: no reason given" for place, line in lines(root, {".py"}) if bare.search(line)]


def stray_tests(root: Path) -> list[str]:
    """Test files in ``tests/<part>/`` that are not named after a module of ``lodpipe/<part>/`` (or after the part)."""
    found = []
    for path in files(root):
        parts = path.relative_to(root).parts
        if len(parts) != 3 or parts[0] != "tests" or not parts[2].startswith("test_"):
            continue
        folder = root / "plugins" if parts[1] == "plugins" else root / "lodpipe" / parts[1]
        if not folder.is_dir():
            continue
        names = [parts[1], parts[1].removesuffix("s"), *(p.stem.strip("_") for p in folder.rglob("*.py"))]
        if not any(re.fullmatch(f"test_{name}(_.*)?", path.stem) for name in names):
            found.append(f"{path.relative_to(root)}: no module in {folder.relative_to(root)} is named so")
    return found


def decisions(root: Path) -> list[str]:
    """Decision records: numbered once each, with the four parts of the template."""
    found, seen = [], set()
    for path in files(root):
        if path.parent != root / "docs" / "decisions":
            continue
        if not re.fullmatch(r"\d{3}-[a-z0-9-]+\.md", path.name) or path.name[:3] in seen:
            found.append(f"{path.name}: not NNN-title.md with a number of its own")
        seen.add(path.name[:3])
        heads = re.findall(r"^## (.+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
        if heads != ["Background", "Options", "Measured", "Outcome"]:
            found.append(f"{path.name}: parts {heads} are not those of the template")
    return found


def changelog(root: Path) -> list[str]:
    """Keep a Changelog 1.1: `Unreleased` first, then versions, newest first; known groups; an entry in each."""
    text = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    found = [] if text.startswith("# Changelog\n") else ["does not begin with '# Changelog'"]
    versions = []
    for section in re.split(r"^## ", text, flags=re.MULTILINE)[1:]:
        title, _, body = section.partition("\n")
        match = re.fullmatch(r"\[(\d+)\.(\d+)\.(\d+)\] - \d{4}-\d{2}-\d{2}", title)
        if match:
            versions.append(tuple(map(int, match.groups())))
        elif title != "[Unreleased]" or versions:
            found.append(f"'## {title}' is neither '[Unreleased]' at the top nor '[1.2.3] - 2026-01-31'")
        groups = re.split(r"^### ", body, flags=re.MULTILINE)
        for group in groups[1:]:
            name, _, entries = group.partition("\n")
            if name not in {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}:
                found.append(f"'### {name}' is not a group")
            if not re.search(r"^- \S", entries, re.MULTILINE):
                found.append(f"{title}: {name} has no entry")
        if match and len(groups) == 1:
            found.append(f"{title} is empty")
    if versions != sorted(versions, reverse=True):
        found.append("versions are not in descending order")
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    if tuple(map(int, project["version"].split("."))) not in versions and "## [Unreleased]" not in text:
        found.append(f"{project['version']} has no section")
    return found


def make_targets(root: Path) -> list[str]:
    """Targets of the Makefile that `make help` does not list."""
    text = (root / "Makefile").read_text(encoding="utf-8")
    phony = set(re.findall(r"^\.PHONY: (.+)$", text, re.MULTILINE)[0].split())
    return sorted(phony - set(re.findall(r"^([a-z-]+):.*## \S", text, re.MULTILINE)))


CHECKS = [
    long_files,
    minified,
    large_files,
    machine_paths,
    unfinished,
    silenced,
    stray_tests,
    decisions,
    changelog,
    make_targets,
]
PROJECT = {"pyproject.toml": '[project]\nversion = "0.1.0"\n'}
HISTORY = (
    "# Changelog\n\n## [Unreleased]\n\n### Added\n\n- a thing\n\n## [0.1.0] - 2026-01-31\n\n### Fixed\n\n- a bug\n"
)


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_of_this_project(check):
    assert len(files(REPO)) > 40
    assert check(REPO) == []


@pytest.mark.parametrize(
    ("check", "name", "bad", "good"),
    [
        (long_files, "lodpipe/a.py", "\n" * 601, "\n" * 600),
        (minified, "a.js", "x" * 1001, "x" * 1000),
        (large_files, "a.bin", "x" * 2_000_001, "x" * 2_000_000),
        (machine_paths, "a.md", "see /home/" + "anna/x", "see ~/x and https://x.org/home/"),
        (machine_paths, "a.yaml", f"path: {REPO}/x" if len(REPO.parts) > 2 else "/Users/" + "x/", "path: out/x"),
        (machine_paths, "a.py", "'/ro" + "ot/x'", "'/root_folder/x' 'a/ro" + "ot/x'"),
        (unfinished, "a.cpp", "// TO" + "DO: later", "// to do"),
        (silenced, "a.py", "x = 1  # no" + "qa: E501", "x = 1  # no" + "qa: E501 a table"),
        (silenced, "a.py", "x = 1  # no" + "qa", "# no quarrel"),
        (silenced, "a.py", "x = 1  # type: " + "ignore[misc]", "x = 1  # type: " + "ignore[misc]  # why"),
        (stray_tests, "tests/io/test_png.py", "", None),
        (decisions, "docs/decisions/1-x.md", "", None),
        (decisions, "docs/decisions/001-x.md", "## Outcome\n", "## Background\n## Options\n## Measured\n## Outcome\n"),
        (changelog, "CHANGELOG.md", HISTORY.replace("# Changelog", "# News", 1), HISTORY),
        (changelog, "CHANGELOG.md", HISTORY.replace("Fixed", "Repaired"), HISTORY),
        (changelog, "CHANGELOG.md", HISTORY.replace("- a bug", ""), HISTORY),
        (changelog, "CHANGELOG.md", HISTORY.replace(" - 2026-01-31", ""), HISTORY),
        (
            changelog,
            "CHANGELOG.md",
            HISTORY.replace("0.1.0", "0.0.9").replace("Unreleased", "0.0.8] - 2026-01-31 ["),
            HISTORY,
        ),
        (changelog, "CHANGELOG.md", "# Changelog\n", HISTORY),
        (make_targets, "Makefile", ".PHONY: a b\n\na:  ## does a\n", ".PHONY: a\n\na: c  ## does a\n"),
    ],
)
def test_a_violation_is_found(tmp_path, check, name, bad, good):
    for path, text in {**PROJECT, "lodpipe/io/gltf.py": "", "tests/io/test_gltf_skins.py": "", name: bad}.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)
    assert check(tmp_path)
    files.cache_clear()
    if good is None:
        (tmp_path / name).unlink()
    else:
        (tmp_path / name).write_text(good)
    assert check(tmp_path) == []


def incomplete_stages(root: Path, stages: dict[str, AnyStage]) -> list[str]:
    """Stages that lack a module, a test file, a row in the README's table, or words on themselves or a parameter.

    Plug-ins lie in ``plugins/`` and are shown on a page of the documentation instead of in the README.
    """
    readme = (root / "README.md").read_text(encoding="utf-8")
    pages = "".join(path.read_text(encoding="utf-8") for path in files(root) if path.match("docs/*.md"))
    found = []
    for name, known in stages.items():
        built_in = known.origin == "built in"
        if not (root / ("lodpipe/stages" if built_in else "plugins") / f"{name}.py").is_file():
            found.append(f"{name}: no module of that name")
        if not (root / "tests" / ("stages" if built_in else "plugins") / f"test_{name}.py").is_file():
            found.append(f"{name}: no test file")
        if not (re.search(rf"^\| *`{name}` *\|", readme, re.MULTILINE) if built_in else f"`{name}`" in pages):
            found.append(f"{name}: no row in the README's table" if built_in else f"{name}: on no page of docs/")
        if not known.summary.endswith("."):
            found.append(f"{name}: the function's docstring does not begin with a sentence")
        for field, info in known.params.model_fields.items():
            if not info.description:
                found.append(f"{name}.{field}: no docstring")
    return found


def test_every_stage_is_complete():
    stages = find_stages([REPO / "plugins"], installed=False)
    assert set(stages) > set(BUILTIN)
    assert incomplete_stages(REPO, stages) == []


class ThinParams(Params):
    depth: int = 1


@stage("thin")
def thin(asset, params: ThinParams, context):
    """no sentence"""


def test_an_incomplete_stage_is_found(tmp_path):
    (tmp_path / "README.md").write_text("`thin` is not in a table")
    complaints = [
        "thin: no module of that name",
        "thin: no test file",
        "thin: no row in the README's table",
        "thin: the function's docstring does not begin with a sentence",
        "thin.depth: no docstring",
    ]
    assert incomplete_stages(tmp_path, {"thin": thin}) == complaints
    plugin = dataclasses.replace(thin, origin="plugins/thin.py")
    assert incomplete_stages(tmp_path, {"thin": plugin})[2] == "thin: on no page of docs/"
