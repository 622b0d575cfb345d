"""The shared harness for tables of textures, in the peers' environment: flat models, peers' levels, the figures.

judged.py make SOURCE FOLDER PEER RATIO…     FOLDER/source.glb and FOLDER/PEER-RATIO.glb, for `textures.py`
judged.py look ORIGINAL VIEWS RES FILE…      prints the judge's figures of each file as a list in JSON
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import SimpleNamespace

sys.path.insert(0, str(Path(__file__).resolve().parent))
import run


def main() -> None:
    """Do what the first argument says."""
    run.enter()
    (make if sys.argv[1] == "make" else look)(*sys.argv[2:])


def make(source: str, folder: str, peer: str, *ratios: str) -> None:
    """Write the source as the peers see it, and a peer's levels of it."""
    import bench
    from mesh import write_glb

    bench.__file__ = str(run.SHARED / "bench.py")
    work = Path(folder)
    asset = bench.prepare(Path(source), work)
    (work / "source.glb").write_bytes(asset["glb"].read_bytes())
    args = SimpleNamespace(k=1, cpus=1, limit=600, keep=None, config=None, commands={})
    for ratio in ratios:
        target = max(4, round(len(asset["mesh"].f) * float(ratio)))
        figures, level = bench.run_one(peer, asset, float(ratio), target, args, work)
        if level is None:
            sys.exit(f"{peer} fails on {source} at {ratio}: {figures}")
        level.mats = asset["mesh"].mats
        write_glb(level, work / f"{peer}-{ratio}.glb")


def look(original: str, views: str, res: str, *files: str) -> None:
    """Print what the judge sees."""
    import judge
    from mesh import load

    beside = judge.Judge(load(original), int(views), int(res), 1)
    print(json.dumps([beside(load(file)) for file in files]))
    beside.close()


if __name__ == "__main__":
    main()
