"""The table of looks: our modes beside the best peer of each case, from the shared harness' peers and judge.

    python tests/benchmarks/looks.py --assets FILES… --modes quadric,visual --views 24 --res 512

Peers' meshes and figures are kept in build/looks and made only once for each asset, ratio and resolution; ours are
made anew. Prints a line for each case (ours − best peer of the case) and the means that matter. LOOKS_MODES='{"name":
{"setting": value}}' tries settings out. `--top N` leaves all but the N best peers of each case out, by the figures of
an earlier run with 8 views × 256²: large pictures of all peers take hours.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))
import run

PEERS = (
    "meshopt_attr",
    "meshopt_update",
    "meshopt_update_uv",
    "meshopt_update_prune",
    "blender",
    "pymeshlab_tex",
    "gltfpack_spv",
)
PLAIN_PEERS = ("open3d_t", "meshopt_update")
MODES: dict[str, dict[str, Any]] = {
    "quadric": {},
    "visual": {"metric": "visual"},
    "quality": {"metric": "visual", "trials": 6},
}


def main() -> None:
    """Judge every case and print the tables."""
    ap = argparse.ArgumentParser(description=__doc__)
    ap.add_argument("--assets", nargs="+", required=True)
    ap.add_argument("--ratios", default="0.5,0.25,0.1,0.02")
    ap.add_argument("--modes", default="quadric,visual")
    ap.add_argument("--views", type=int, default=24)
    ap.add_argument("--res", type=int, default=512)
    ap.add_argument("--top", type=int, help="judge the best peers alone, by what 8 views of 256² said")
    ap.add_argument("--workers", type=int, default=1, help="processes of the judge")
    ap.add_argument("--cache", default=str(run.ROOT / "build" / "looks"))
    ap.add_argument("--shots", help="folder for pictures: original, best peer, ours")
    ap.add_argument("--out", help="all figures as JSON")
    a = ap.parse_args()
    run.enter()
    modes = MODES | json.loads(os.environ.get("LOOKS_MODES", "{}"))
    rows: list[dict[str, Any]] = []
    for path in a.assets:
        rows += _asset(Path(path), [float(r) for r in a.ratios.split(",")], a.modes.split(","), modes, a)
    for mode in a.modes.split(","):
        _print(mode, [r for r in rows if r["mode"] == mode])
    if a.out:
        Path(a.out).write_text(json.dumps(rows, indent=1))


def _asset(path: Path, ratios: list[float], names: list[str], modes: dict[str, Any], a: Any) -> list[dict[str, Any]]:
    from types import SimpleNamespace

    import bench
    import judge
    from mesh import Mesh

    cache = Path(a.cache)
    cache.mkdir(parents=True, exist_ok=True)
    stem = path.stem.replace(" ", "_")
    book = cache / f"{stem}-{a.views}x{a.res}.json"
    known = json.loads(book.read_text()) if book.exists() else {}
    bench.__file__ = str(run.SHARED / "bench.py")
    work = Path(tempfile.mkdtemp(prefix="looks-"))
    asset = bench.prepare(path, work)
    source = asset["mesh"]
    kind = "tex" if source.textured() else "clay"
    args = SimpleNamespace(k=1, cpus=1, limit=600, keep=None, config=None, commands={})
    look = judge.Judge(source, a.views, a.res, a.workers)
    rows = []
    targets = [max(4, round(len(source.f) * r)) for r in ratios]
    made = {name: run.levels(source, targets, modes[name]) for name in names}
    for number, (ratio, target) in enumerate(zip(ratios, targets, strict=True)):
        for name in _leading(cache, stem, ratio, target, kind, a.top):
            key = f"{name}@{ratio:g}"
            if key in known:
                continue
            kept = cache / f"{stem}-{name}-{ratio:g}.npz"
            figures: dict[str, Any] = {}
            if not kept.exists():
                figures, got = bench.run_one(name, asset, ratio, target, args, work)
                if got is not None:
                    got.save(kept)
            if kept.exists():
                level = Mesh.open(kept, source.mats)
                figures = figures | look(level) | {"tris": len(level.f)}
            known[key] = figures
            book.write_text(json.dumps(known))
        peer = _best(known, ratio, target, kind)
        for name in names:
            level, seconds = made[name][0][number], made[name][1]
            row = {"asset": stem, "ratio": ratio, "mode": name, "target": target, "tris": len(level.f), "kind": kind}
            row |= {"seconds": seconds, "ours": look(level), "peer": peer, "best": known.get(f"{peer}@{ratio:g}")}
            rows.append(row)
            if a.shots:
                _shots(Path(a.shots), look, row, level, cache / f"{stem}-{peer}-{ratio:g}.npz", source)
        print(f"{stem} {ratio:g} done", file=sys.stderr)
    look.close()
    return rows


def _leading(cache: Path, stem: str, ratio: float, target: int, kind: str, top: int | None) -> tuple[str, ...]:
    """The peers to judge: all of them, or the `top` best of an earlier run of small pictures."""
    every = PEERS if kind == "tex" else PLAIN_PEERS
    book = cache / f"{stem}-8x256.json"
    if not top or not book.exists():
        return every
    known = json.loads(book.read_text())
    order = []
    while len(order) < top and (best := _best(known, ratio, target, kind)):
        order.append(best)
        del known[f"{best}@{ratio:g}"]
    return tuple(order)


def _best(known: dict[str, Any], ratio: float, target: int, kind: str) -> str | None:
    """The peer of the best picture among those that reached the target (within 2 %)."""
    fit = {
        key.split("@")[0]: figures[kind]["psnr"]
        for key, figures in known.items()
        if key.endswith(f"@{ratio:g}") and kind in figures and figures["tris"] <= target * 1.02 + 2
    }
    return max(fit, key=lambda name: fit[name]) if fit else None


#: Heading, figure of ours and the peer's, its form: differences, then quotients.
COLUMNS: tuple[tuple[str, Any, str], ...] = (
    ("Δ dB", lambda p, q, kind: p[kind]["psnr"] - q[kind]["psnr"], "+.2f"),
    ("Δ SSIM", lambda p, q, kind: p[kind]["ssim"] - q[kind]["ssim"], "+.4f"),
    ("Δ FLIP", lambda p, q, kind: p[kind]["flip"] - q[kind]["flip"], "+.4f"),
    ("Δ 1-IoU %", lambda p, q, kind: p["iou"] - q["iou"], "+.3f"),
    ("clay RMS ÷", lambda p, q, kind: (p["clay"]["rms"] + 1e-6) / (q["clay"]["rms"] + 1e-6), ".3f"),
    ("mean ÷", lambda p, q, kind: (p["mean"] + 1e-6) / (q["mean"] + 1e-6), ".2f"),
)


def _print(mode: str, rows: list[dict[str, Any]]) -> None:
    headings = ["asset", "ratio", "triangles", "best peer", "its PSNR", "ours", *(name for name, _, _ in COLUMNS)]
    print(f"\n## {mode}\n\n| {' | '.join(headings)} |\n|{'---|' * len(headings)}")
    figures: dict[float, list[list[float]]] = {}
    for r in rows:
        kind, ours, best = r["kind"], r["ours"], r["best"]
        start = [r["asset"], f"{r['ratio']:g}", f"{r['tris']} of {r['target']}"]
        if not best:
            print(" | ".join(["|", *start, "none reaches the target", "", f"{ours[kind]['psnr']:.2f} |"]))
            continue
        line = [of(ours, best, kind) for _, of, _ in COLUMNS]
        figures.setdefault(r["ratio"], []).append(line)
        cells = [*start, r["peer"], f"{best[kind]['psnr']:.2f}", f"{ours[kind]['psnr']:.2f}"]
        cells += [format(x, form) for x, (_, _, form) in zip(line, COLUMNS, strict=True)]
        print(f"| {' | '.join(cells)} |")
    for ratio, lines in figures.items():
        _print_means(f"{ratio:g}", lines)
    _print_means("all", [line for lines in figures.values() for line in lines])
    mean = sum(r["ours"]["mean"] for r in rows) / len(rows)
    seconds = sum({r["asset"]: r["seconds"] for r in rows}.values())
    print(f"ours: mean distance {mean:.4f} % of the diagonal, {seconds:.2f} s for all levels of all assets")


def _print_means(name: str, lines: list[list[float]]) -> None:
    if not lines:
        return
    means = [sum(column) / len(lines) for column in zip(*lines, strict=True)]
    text = ", ".join(f"{name} {x:{form}}" for x, (name, _, form) in zip(means, COLUMNS, strict=True))
    print(f"{name}: {text}; ahead in {sum(line[0] > 0 for line in lines)} of {len(lines)}")


def _shots(folder: Path, look: Any, row: dict[str, Any], made: Any, peer: Path, source: Any) -> None:
    import numpy as np
    from mesh import Mesh
    from PIL import Image

    folder.mkdir(parents=True, exist_ok=True)
    ours = look.shots(made)
    if peer.exists():
        theirs = look.shots(Mesh.open(peer, source.mats))
        ours = np.vstack([theirs, ours[len(ours) // 2 :]])
    Image.fromarray(ours).save(folder / f"{row['asset']}-{row['ratio']:g}-{row['mode']}.png")


if __name__ == "__main__":
    main()
