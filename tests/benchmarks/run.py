"""Our decimator beside its peers, in one run: time, memory, distances, pictures.

    python tests/benchmarks/run.py --assets FILES… --ratios 0.25,0.1 --peers meshopt_attr,open3d_t,lodpipe_best --table

Takes the options of the shared harness (`../shared/bench/bench.py`), to whose peers it adds ours, and keeps every
row's figures in results.csv beside it when told to (`--keep-results LABEL`). The peers live in an environment of their
own, build/bench, made by the harness' setup script on the first run (about 2 GB).
"""

from __future__ import annotations

import csv
import importlib.util
import json
import os
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
SHARED = ROOT.parent / "shared" / "bench"
PEERS = Path(os.environ.get("LODPIPE_BENCH", ROOT / "build" / "bench"))
RESULTS = HERE / "results.csv"
FIGURES = ("tris_out", "seconds", "x", "extra_mb", "mean", "haus", "iou", "clay.rms", "tex.rms", "tex.psnr", "tex.flip")

#: Our modes: settings of `lodpipe.geometry.decimate.decimate`.
MODES: dict[str, dict[str, Any]] = {
    "lodpipe_fast": {"round_share": 0.5},
    "lodpipe_best": {},
    "lodpipe_half": {"placement": "endpoint"},
}


def main() -> None:
    """Run the harness, in the peers' environment."""
    enter()
    import bench
    import peers

    bench.__file__ = __file__  # its child processes must know our peers, too
    for name, settings in MODES.items():
        peers.peer(name, keeps="uncnm")(_peer(settings))
    for extra in os.environ.get("LODPIPE_MODES", "").split(";"):  # NAME:{"setting": value}, to try settings out
        if extra:
            name, _, text = extra.partition(":")
            peers.peer(name, keeps="uncnm")(_peer(json.loads(text)))
    label = ""
    if "--keep-results" in sys.argv:
        at = sys.argv.index("--keep-results")
        label = sys.argv[at + 1]
        del sys.argv[at : at + 2]
    if sys.argv[1:2] == ["--keeps"]:
        import keeps

        sys.argv[1:2] = []
        keeps.main()
        return
    bench.main()
    if label:
        _keep(label, Path(sys.argv[sys.argv.index("--out") + 1] if "--out" in sys.argv else "results.json"))


def enter() -> None:
    """Go on in the peers' environment, with the harness and our kernel within reach."""
    if not SHARED.is_dir():
        sys.exit("the shared harness (../shared/bench) is not here")
    if "LODPIPE_NATIVE" not in os.environ:
        _enter_peers()
    sys.path[:0] = [str(SHARED), str(ROOT)]
    _load_native(os.environ["LODPIPE_NATIVE"])


def _enter_peers() -> None:
    """Start again under the peers' interpreter, which is set up if it is not there."""
    python = PEERS / "peers" / "bin" / "python"
    if not python.exists():
        print(f"bench: setting up the peers in {PEERS} (about 2 GB)", file=sys.stderr)
        subprocess.run(["sh", str(SHARED / "setup.sh"), str(PEERS)], check=True)
    native = Path(sysconfig.get_path("platlib")) / "lodpipe" / "kernel"
    module = next(iter(sorted(native.glob("_native*.so"))), None)
    if module is None:
        sys.exit("the kernel is not built; run: make setup")
    env = dict(
        os.environ,
        LODPIPE_NATIVE=str(module),
        BENCH_NODE=str(PEERS / "node" / "node_modules" / ".bin"),
        BENCH_BPY=str(PEERS / "peers-bpy" / "bin" / "python"),
        PYTHONDONTWRITEBYTECODE="1",
    )
    os.execve(python, [str(python), *sys.argv], env)


def _load_native(path: str) -> None:
    name = "lodpipe.kernel._native"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(path)
    sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules[name])


def _peer(settings: dict[str, Any]) -> Any:
    def make(m: Any, target: int) -> Any:
        import mesh as harness
        import numpy as np

        from lodpipe.core.mesh import Mesh
        from lodpipe.geometry.decimate import decimate
        from lodpipe.geometry.joined import AttributeWeights

        own = dict(settings)
        if "weights" in own:
            own["weights"] = AttributeWeights(**own["weights"])
        columns = {"NORMAL": m.n, "TEXCOORD_0": m.uv, "COLOR_0": m.c}
        attributes = {name: values for name, values in columns.items() if values is not None}
        threads = len(os.sched_getaffinity(0))

        def prepare() -> Mesh:
            positions, faces, _, kept = harness.weld(m.v, m.f)
            owner = m.fm[kept] if m.fm is not None else None
            primitives = _primitives(len(m.mats), tuple(attributes))
            return Mesh(positions.astype(np.float64), faces, m.f[kept], attributes, owner, primitives)

        def call(source: Mesh) -> Mesh:
            return decimate(source, target, threads=threads, **own)

        def done(out: Mesh) -> Any:
            if not attributes:
                return harness.Mesh(out.positions.astype(np.float32), out.faces, fm=out.face_primitive, mats=m.mats)
            corners = {name: table[out.wedges] for name, table in out.attributes.items()}
            get = corners.get
            made = harness.corners(
                out.positions, out.faces, get("TEXCOORD_0"), get("NORMAL"), get("COLOR_0"), out.face_primitive
            )
            made.mats = m.mats
            return made

        return prepare, call, done

    return make


def levels(source: Any, targets: list[int], settings: dict[str, Any]) -> tuple[list[Any], float]:
    """Our levels of a harness mesh, textures and all, and the seconds that they took on one thread."""
    import time

    import mesh as harness
    import numpy as np

    from lodpipe.core.asset import Asset, Target
    from lodpipe.core.material import Image, Material
    from lodpipe.core.mesh import Mesh
    from lodpipe.geometry import decimate as ours
    from lodpipe.geometry.joined import AttributeWeights
    from lodpipe.kernel import QuadricOptions

    columns = {"NORMAL": source.n, "TEXCOORD_0": source.uv, "COLOR_0": source.c}
    attributes = {name: values for name, values in columns.items() if values is not None}
    positions, faces, _, kept = harness.weld(source.v, source.f)
    primitives = _primitives(len(source.mats), tuple(attributes))
    made = Mesh(positions.astype(np.float64), faces, source.f[kept], attributes, source.fm[kept], primitives)
    materials, pixels, images = [], {}, {}
    for m in source.mats:
        pbr: dict[str, Any] = {"baseColorFactor": list(m.color)}
        if m.image is not None:
            number = images.setdefault(id(m.image), len(images))
            pixels[number] = np.asarray(m.image)
            pbr["baseColorTexture"] = {"index": number}
        cut = {"alphaMode": "MASK", "alphaCutoff": m.cutoff} if m.cutoff else {}
        materials.append(Material({"pbrMetallicRoughness": pbr, "doubleSided": m.double, **cut}))
    blank = tuple(Image() for _ in images)
    document = {"textures": [{"source": i} for i in range(len(images))]}
    asset = Asset(name="bench", meshes=(made,), materials=tuple(materials), images=blank, document=document)
    own = dict(settings)
    metric = own.pop("metric", "quadric")
    fields = {name: own.pop(name) for name in list(own) if name in QuadricOptions.__dataclass_fields__}
    if "weights" in own:
        own["weights"] = AttributeWeights(**own["weights"])
    goals = [Target(triangles=t) for t in targets]
    begin = time.process_time()
    own |= {"metric": metric, "pixels": pixels, "threads": 1}
    lods = ours.decimate_asset(asset, goals, QuadricOptions(**fields), **own)
    seconds = time.process_time() - begin
    out = []
    for lod in lods[1:]:
        level = lod.meshes[0]
        get = {name: table[level.wedges] for name, table in level.attributes.items()}.get
        columns = get("TEXCOORD_0"), get("NORMAL"), get("COLOR_0")
        one = harness.corners(level.positions, level.faces, *columns, level.face_primitive)
        one.mats = source.mats
        out.append(one)
    return out, seconds


def _primitives(count: int, attributes: tuple[str, ...]) -> tuple[Any, ...]:
    from lodpipe.core.mesh import Primitive

    return tuple(Primitive(material=i, attributes=attributes) for i in range(max(count, 1)))


def _keep(label: str, results: Path) -> None:
    rows = json.loads(results.read_text())["rows"]
    new = not RESULTS.exists()
    with RESULTS.open("a", newline="") as out:
        table = csv.writer(out)
        if new:
            table.writerow(["label", "asset", "ratio", "peer", *FIGURES])
        for row in rows:
            table.writerow([label, row["asset"], row["ratio"], row["peer"], *(_figure(row, key) for key in FIGURES)])


def _figure(row: Any, key: str) -> str:
    for part in key.split("."):
        row = row.get(part) if isinstance(row, dict) else None
    return "" if row is None else f"{row:.6g}"


if __name__ == "__main__":
    main()
