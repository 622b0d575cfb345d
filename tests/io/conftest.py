"""What the tests of files share: the Khronos validator, and the real models."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

VALIDATOR = Path(__file__).parent / "validator"
ASSETS = Path(__file__).parents[3] / "shared" / "assets"


@pytest.fixture(scope="session")
def errors_of() -> Callable[[list[Path]], dict[str, list[str]]]:
    """A function that gives the Khronos validator's errors of glTF files, by file name."""
    if shutil.which("node") is None:
        pytest.skip("the glTF validator needs Node.js")
    if not (VALIDATOR / "node_modules" / "gltf-validator").is_dir():
        pytest.skip("the glTF validator is not installed: npm install --prefix tests/io/validator")

    def run(paths: list[Path]) -> dict[str, list[str]]:
        result = subprocess.run(
            ["node", str(VALIDATOR / "validate.js")],
            input="\n".join(map(str, paths)),
            capture_output=True,
            text=True,
            check=True,
            timeout=120,
        )
        found: dict[str, list[str]] = json.loads(result.stdout)
        assert set(found) == set(map(str, paths))
        return {Path(name).name: errors for name, errors in found.items()}

    return run


@pytest.fixture(scope="session")
def assets() -> Path:
    """The folder of real and of broken models."""
    if not ASSETS.is_dir():
        pytest.skip("the folder of real models is not beside this repository")
    return ASSETS
