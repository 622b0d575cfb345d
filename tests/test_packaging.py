"""What is shipped: the source distribution's and the wheel's contents, and that the wheel works on its own."""

from __future__ import annotations

import email
import importlib.metadata
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from pathlib import Path

import numpy
import pytest

from test_imports import imports, modules

REPO = Path(__file__).parent.parent
PROJECT = tomllib.loads((REPO / "pyproject.toml").read_text(encoding="utf-8"))["project"]
SHIPPED = ("lodpipe/", "config/", "README.md", "CHANGELOG.md", "LICENSE", "pyproject.toml")
SIDE = 12  # squares on each side of the model below
HILL = "".join(f"v {x} {y} {x * y / SIDE}\n" for x in range(SIDE + 1) for y in range(SIDE + 1)) + "".join(
    f"f {i} {i + SIDE + 1} {i + SIDE + 2} {i + 1}\n" for i in range(1, SIDE * (SIDE + 1)) if i % (SIDE + 1)
)


def run(*command: object, cwd: Path, **environment: str) -> str:
    """Standard output of a program that must succeed, run where neither the repository nor PYTHONPATH is in sight."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "LODPIPE"))}
    done = subprocess.run(
        [str(part) for part in command], cwd=cwd, env=clean | environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def sources() -> set[str]:
    """The repository's files that a source distribution is made of."""
    found = {path.relative_to(REPO).as_posix() for path in REPO.rglob("*") if path.is_file()}
    return {
        name for name in found if name.startswith(SHIPPED) and "__pycache__" not in name and not name.endswith(".so")
    }


@pytest.fixture(scope="module")
def sdist(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sdist")
    code = f"from scikit_build_core.build import build_sdist; print(build_sdist({str(folder)!r}))"
    return folder / run(sys.executable, "-c", code, cwd=REPO).splitlines()[-1]


@pytest.fixture(scope="module")
def wheel(sdist, tmp_path_factory):
    """Built from the unpacked source distribution, so that nothing else of the repository can be in it."""
    folder = tmp_path_factory.mktemp("wheel")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    (source,) = folder.iterdir()
    run(
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "-q",
        "--no-deps",
        "--no-build-isolation",
        "-w",
        folder,
        source,
        cwd=folder,
    )
    return next(folder.glob("*.whl"))


def test_installed_metadata_is_that_of_the_project():
    installed = importlib.metadata.distribution("lodpipe")
    assert installed.version == PROJECT["version"]
    assert installed.metadata["License-Expression"] == "Apache-2.0"
    (script,) = installed.entry_points.select(group="console_scripts")
    assert (script.name, script.value) == ("lodpipe", "lodpipe.cli:main")


READ_ONLY = {"dash-model-viewer"}
"""Packages of which a file is read and nothing imported."""
EXTRAS = ("dask", "heat")
"""Optional dependencies that the code, not only the tests, imports where they are there."""


def test_every_imported_package_is_a_declared_dependency():
    """A package that only happens to come along with another one may be gone tomorrow."""
    names = {"yaml": "pyyaml", "PIL": "pillow", "DracoPy": "dracopy"}
    lines = PROJECT["dependencies"] + [line for extra in EXTRAS for line in PROJECT["optional-dependencies"][extra]]
    declared = {re.split(r"[<>=; ]", line)[0].removesuffix("-cpu") for line in lines}
    used = {item.target.split(".")[0] for name, path in modules(REPO).items() for item in imports(path, name)}
    foreign = {names.get(name, name) for name in used - sys.stdlib_module_names - {"lodpipe"}}
    assert foreign | READ_ONLY == declared


def test_sdist_holds_the_sources_and_nothing_else(sdist):
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
        modes = {member.name: member.type for member in archive}
    assert names - {"PKG-INFO"} == sources()
    assert set(modes.values()) == {tarfile.REGTYPE}


@pytest.mark.slow
def test_wheel_holds_the_package_the_kernel_and_the_presets(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if not name.endswith("/")}
        info = f"lodpipe-{PROJECT['version']}.dist-info"
        metadata = email.message_from_bytes(archive.read(f"{info}/METADATA"))
    natives = {name for name in names if name.endswith(".so")}
    assert len(natives) == 1 and natives.pop().startswith("lodpipe/kernel/_native.")
    package = {name for name in sources() if name.startswith("lodpipe/")}
    build_only = {name for name in package if re.match(r"lodpipe/kernel/(src/|CMakeLists)", name)}
    presets = {f"lodpipe/config/presets/{path.name}" for path in (REPO / "config").iterdir()}
    assert "lodpipe/config/presets/default.yaml" in presets
    assert {name for name in names if not name.startswith((info, "lodpipe/kernel/_native."))} == (
        (package - build_only - {"lodpipe/kernel/_native.pyi"}) | presets
    )
    assert f"{info}/licenses/LICENSE" in names
    assert set(PROJECT["optional-dependencies"]) == set(metadata.get_all("Provides-Extra", []))


@pytest.mark.slow
def test_wheel_works_in_an_empty_folder(wheel, tmp_path):
    """In a new environment that has lodpipe from the wheel, and its dependencies from this one."""
    venv.create(tmp_path / "env", with_pip=True)
    python = tmp_path / "env" / "bin" / "python"
    run(python, "-m", "pip", "install", "-q", "--no-deps", "--no-index", wheel, cwd=tmp_path)
    site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=tmp_path).strip())
    (site / "dependencies.pth").write_text(str(Path(numpy.__file__).parents[1]))
    empty = tmp_path / "empty"
    empty.mkdir()
    where = run(python, "-c", "from lodpipe.kernel import _native; print(_native.__file__)", cwd=empty)
    assert where.startswith(str(site))
    command = tmp_path / "env" / "bin" / "lodpipe"
    assert "usage" in run(command, "--help", cwd=empty).lower()
    (tmp_path / "in.obj").write_text(HILL)
    run(command, "run", tmp_path / "in.obj", "-c", "default", "-o", "out", cwd=empty)
    assert (empty / "out" / "in" / "manifest.json").is_file()
    assert (empty / "out" / "in" / "LOD0").is_dir()
