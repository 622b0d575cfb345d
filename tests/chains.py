"""Assets and plug-in stages that tests of chains draw on."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lodpipe.core.asset import Asset
from lodpipe.core.mesh import Mesh
from meshes import box, grid

STAGES = '''
"""Stages for tests: one that makes levels, and some that go wrong in every way there is."""
import dataclasses, os, signal, time
import numpy as np
from lodpipe.core.asset import Asset, Lod
from lodpipe.core.errors import InvalidMesh
from lodpipe.stage import Context, Params, stage

class ThinParams(Params):
    """Parameters of `thin`."""
    say: str = ""
    """A warning."""

@stage("thin")
def thin(asset: Asset, params: ThinParams, context: Context) -> Asset:
    """Make a level for each target: the first faces of each mesh."""
    levels = [Lod(asset.meshes)]
    for number, target in enumerate(context.lods):
        meshes = []
        for mesh in asset.meshes:
            count = max(1, int(len(mesh.faces) * (target.ratio or 0.5)))
            meshes.append(dataclasses.replace(mesh, faces=mesh.faces[:count], wedges=mesh.wedges[:count],
                          face_primitive=mesh.face_primitive[:count]))
        levels.append(Lod(tuple(meshes), target, "target", estimate=0.5 * (number + 1)))
        context.progress(number + 1, len(context.lods))
    if params.say:
        context.warn(params.say)
    context.record("levels", len(levels))
    return dataclasses.replace(asset, lods=tuple(levels))

class FailParams(Params):
    """Parameters of `fail`."""
    how: str = "error"
    """In which way."""
    only: str = ""
    """The asset that fails; empty for all."""
    seconds: float = 60.0
    """How long to hang."""

@stage("fail")
def fail(asset: Asset, params: FailParams, context: Context) -> Asset:
    """Go wrong."""
    if params.only not in ("", asset.name):
        return asset
    if params.how == "error":
        raise InvalidMesh("two and two is five", place="meshes[0]", advice="count again")
    if params.how == "bug":
        raise TypeError("a bug on purpose")
    if params.how == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    if params.how == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    if params.how == "exit":
        os._exit(7)
    if params.how == "memory":
        block = np.ones(4 << 30, np.uint8)
    if params.how == "interrupt":
        raise KeyboardInterrupt
    if params.how == "slow":
        end = time.monotonic() + params.seconds
        while time.monotonic() < end:
            time.sleep(0.01)
            context.progress(0, 1)
    if params.how == "hang":
        time.sleep(params.seconds)
    return asset
'''
"""Source of a plug-in file."""

CHAIN = {"lods": [{"ratio": 0.5}, {"ratio": 0.25}], "stages": ["thin", "export"]}


def asset(name: str = "box", **fields) -> Asset:
    """A cube of 12 triangles."""
    positions, faces = box()
    return Asset(name, (Mesh(positions, faces, name=name),), **fields)


def plugin_folder(root: Path) -> Path:
    """A folder with STAGES in it."""
    folder = root / "stages_for_tests"
    folder.mkdir(exist_ok=True)
    (folder / "stages_for_tests.py").write_text(STAGES)
    return folder


def write_obj(path: Path, cells: int = 4) -> Path:
    """An OBJ file of a square of cells² · 2 triangles."""
    positions, faces = grid(cells)
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [f"v {x} {y} {z}" for x, y, z in positions.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n")
    return path


def triangle_soup(*offsets: float) -> Mesh:
    """A cube about each (offset, 0, 0), unconnected."""
    positions, faces = box()
    shifts = np.array([[offset, 0.0, 0.0] for offset in offsets])
    all_positions = np.concatenate([positions + shift for shift in shifts])
    all_faces = np.concatenate([faces + index * len(positions) for index in range(len(offsets))])
    return Mesh(all_positions, all_faces)
