"""Textured 3-D models in, folders of LODs and a report out.

The public names are loaded when they are first used, so that `import lodpipe` costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lodpipe.core.asset import Asset as Asset
    from lodpipe.core.errors import LodpipeError as LodpipeError
    from lodpipe.core.mesh import Mesh as Mesh
    from lodpipe.geometry.decimate import decimate as decimate
    from lodpipe.io import load as load
    from lodpipe.io import save as save
    from lodpipe.pipeline import Pipeline as Pipeline
    from lodpipe.plugins import find_stages as find_stages
    from lodpipe.service.batch import run as run
    from lodpipe.service.chain import load_pipeline as load_pipeline

_PUBLIC = {
    "Asset": "lodpipe.core.asset",
    "LodpipeError": "lodpipe.core.errors",
    "Mesh": "lodpipe.core.mesh",
    "Pipeline": "lodpipe.pipeline",
    "decimate": "lodpipe.geometry.decimate",
    "find_stages": "lodpipe.plugins",
    "load": "lodpipe.io",
    "load_pipeline": "lodpipe.service.chain",
    "run": "lodpipe.service.batch",
    "save": "lodpipe.io",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version("lodpipe")
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'lodpipe' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted([*globals(), *_PUBLIC, "__version__"])
