"""Skeletons, segments and levels of very few triangles: pictures, and tables of how good they are.

``python docs/make_skeletons.py [-o FOLDER] [ASSET…]``: skeletons.png (both methods, from two sides), extreme.png (plain
decimation above, with the skeleton's help below) and tables.md. Without an asset: the sample starfish and animal, and
the models of the papers that are found in the folder given with --models.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

import lodpipe
from lodpipe.core.asset import Asset, Lod, Target
from lodpipe.core.mesh import F64, Mesh
from lodpipe.geometry.camera import Camera, bounding_sphere, views
from lodpipe.geometry.decimate import decimate_asset
from lodpipe.geometry.flatten import flatten
from lodpipe.geometry.importance import importance
from lodpipe.geometry.render import Style, buffers, render
from lodpipe.geometry.segment import segment
from lodpipe.geometry.sheet import contact_sheet, png_bytes
from lodpipe.geometry.skeleton import SkeletonOptions, load_libraries, skeleton
from lodpipe.geometry.skeleton_view import skeleton_model
from lodpipe.geometry.surface import Model
from lodpipe.geometry.texture import Textures

ROOT = Path(__file__).parent.parent
NAMED = ("stanford_bunny.obj", "teddy.obj", "horse.ply", "cow.obj", "octopus.off", "armadillo.obj", "dolphin.off")
MODELS = ROOT.parent / "shared" / "assets" / "dev"
COUNTS = (174, 100, 50, 20, 10)
VIEWS, SIZE = 24, 128
NEAR = 0.03
"""A branch survives if a vertex is within this share of the diagonal of its terminal vertex."""
METHODS: tuple[Literal["geodesic", "dcg"], ...] = ("geodesic", "dcg")
Picture = NDArray[np.uint8]
WIRES = Style(mode="clay", wireframe=True)


def bare(asset: Asset) -> Asset:
    """One mesh of positions and faces, in world space."""
    soup = flatten(asset)
    return Asset(asset.name, (Mesh(soup.positions, soup.faces),))


def with_shape(asset: Asset, method: Literal["geodesic", "dcg"] = "geodesic") -> Asset:
    """The asset with its skeleton and segments."""
    asset = replace(asset, skeleton=skeleton(asset, SkeletonOptions(method=method)))
    assert asset.skeleton is not None
    return replace(asset, segments=segment(asset, asset.skeleton))


def silhouettes(asset: Asset, meshes: Sequence[Mesh], centre: F64, radius: float) -> NDArray[np.bool_]:
    """What each of the views shows of the meshes."""
    if not any(len(mesh.faces) for mesh in meshes):
        return np.zeros((VIEWS, SIZE, SIZE), bool)
    model = Model(asset, tuple(meshes), Textures({}))
    cameras = [Camera.around(centre, radius, direction, fov=None) for direction in views(VIEWS)]
    return np.array([buffers(model, camera, SIZE, SIZE).hit for camera in cameras])


def overlap(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    """Mean intersection over union."""
    return float(((a & b).sum(axis=(1, 2)) / np.maximum((a | b).sum(axis=(1, 2)), 1)).mean())


def lost(asset: Asset, level: Lod) -> int:
    """Branches without a vertex near their terminal vertex."""
    assert asset.importance is not None
    tips = asset.meshes[0].positions[asset.importance.reserved[:, 0]]
    away = np.linalg.norm(tips[:, None] - level.meshes[0].positions[None], axis=2).min(axis=1, initial=np.inf)
    return int((away > NEAR * flatten(asset).diagonal).sum())


def skeleton_rows(asset: Asset) -> tuple[list[str], list[Picture], list[str]]:
    """Lines of the table, pictures and their labels, for both methods."""
    lines, pictures, labels = [], [], []
    for method in METHODS:
        begin = time.process_time()
        shaped = with_shape(asset, method)
        seconds = time.process_time() - begin
        found, segments = shaped.skeleton, shaped.segments
        assert found is not None and segments is not None
        part = found.components[0]
        share = "—" if part.inside_share is None else f"{part.inside_share:.3f}"
        changed = " / ".join(str(skeleton(a, SkeletonOptions(method=method)).count("end")) for a in changes(asset))
        ends = found.count("end")
        lines.append(
            f"| {asset.name} | {asset.triangles:,} | {method} | {ends} | {found.count('joint')} | {part.cycle_rank} "
            f"| {part.genus} | {share} | {changed} | {seconds:.2f} | {seconds / asset.triangles * 1e5:.2f} |"
        )
        model = skeleton_model(asset, found, segments)
        drawn = Model(model, model.meshes, Textures({}))
        for direction in ((0.75, 0.3, 1.0), (-1.0, 0.4, 0.1)):
            pictures.append(render(drawn, Camera.around(drawn.centre, drawn.radius, direction), 360, 360))
            labels.append(f"{asset.name}, {method}: {ends} ends, {len(segments.names)} segments")
    return lines, pictures, labels


def changes(asset: Asset) -> list[Asset]:
    """The asset with noise of 0.5 % of the diagonal, decimated to 10 %, and turned."""
    mesh = asset.meshes[0]
    noise = np.random.default_rng(0).normal(size=mesh.positions.shape) * 0.005 * flatten(asset).diagonal
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    meshes = [
        Mesh(mesh.positions + noise, mesh.faces),
        lodpipe.decimate(mesh, 0.1),
        Mesh(mesh.positions @ turn, mesh.faces),
    ]
    return [Asset(asset.name, (m,)) for m in meshes]


def extreme_rows(asset: Asset) -> tuple[str, list[tuple[float, float]], list[Picture], list[str]]:
    """A line of the table, (plain, ours) overlaps, pictures and labels."""
    shaped = with_shape(asset)
    shaped = replace(shaped, importance=importance(shaped))
    goals = [Target(triangles=count) for count in COUNTS if count < asset.triangles]
    plain, ours = decimate_asset(asset, goals), decimate_asset(shaped, goals)
    centre, radius = bounding_sphere(flatten(asset))
    seen = silhouettes(asset, asset.meshes, centre, radius)
    camera = Camera.around(centre, radius, (0.75, 0.3, 1.0))
    figures, cells = [], []
    rows: dict[str, list[Picture]] = {"plain": [], "ours": []}
    labels: dict[str, list[str]] = {"plain": [], "ours": []}
    for one, other in zip(plain[1:], ours[1:], strict=True):
        pair = [overlap(seen, silhouettes(asset, level.meshes, centre, radius)) for level in (one, other)]
        gone = [lost(shaped, level) for level in (one, other)]
        figures.append((pair[0], pair[1]))
        cells.append(f"{pair[0]:.3f} → **{pair[1]:.3f}** ({gone[0]} → {gone[1]})")
        for name, level, value, number in zip(rows, (one, other), pair, gone, strict=True):
            rows[name].append(render(Model(asset, level.meshes, Textures({})), camera, 260, 260, WIRES))
            labels[name].append(f"{name}, {level.triangles}: {value:.3f}, {number} lost")
    assert shaped.importance is not None
    line = f"| {asset.name} | {len(shaped.importance.reserved)} | " + " | ".join(cells) + " |"
    return line, figures, rows["plain"] + rows["ours"], labels["plain"] + labels["ours"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the sheets and the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("assets", nargs="*", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/skeletons"))
    parser.add_argument("--models", type=Path, default=MODELS, help="folder of models")
    options = parser.parse_args(arguments)
    samples = [ROOT / "sample_assets" / f"{name}.glb" for name in ("starfish", "animal")]
    paths = options.assets or [*samples, *(path for n in NAMED if (path := options.models / n).is_file())]
    load_libraries()
    head = "| model | triangles | method | ends | joints | loops | genus | inside | changed | s | s / 100 k |"
    legend = "Ends, and ends after noise of 0.5 % / decimation to 10 % / a turn; processor time, both stages."
    table: list[str] = ["# Skeletons", "", legend, "", head, "|" + " --- |" * 11]
    extreme: list[str] = [
        "# Levels of few triangles",
        "",
        "Overlap of silhouettes over 24 views, plain quadric error → with `importance` (branches lost).",
        "",
        "| model | branches | " + " | ".join(map(str, COUNTS)) + " |",
        "|" + " --- |" * (2 + len(COUNTS)),
    ]
    sheets: dict[str, tuple[list[Any], list[str]]] = {"skeletons": ([], []), "extreme": ([], [])}
    figures: list[tuple[float, float]] = []
    for path in paths:
        asset = bare(lodpipe.load(path))
        lines, pictures, labels = skeleton_rows(asset)
        table += lines
        sheets["skeletons"][0].extend(pictures)
        sheets["skeletons"][1].extend(labels)
        line, pairs, pictures, labels = extreme_rows(asset)
        extreme.append(line)
        figures += pairs
        sheets["extreme"][0].extend(pictures)
        sheets["extreme"][1].extend(labels)
        print(lines[0], line, sep="\n", flush=True)
    better = sum(ours > plain for plain, ours in figures)
    worst = min((ours - plain for plain, ours in figures), default=0.0)
    extreme += ["", f"Better in {better} of {len(figures)} cases; the worst differs by {100 * worst:+.1f} %."]
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / "tables.md").write_text("\n".join([*table, "", *extreme, ""]), encoding="utf-8")
    for name, (images, texts) in sheets.items():
        columns = 4 if name == "skeletons" else len(COUNTS)
        (options.output / f"{name}.png").write_bytes(png_bytes(contact_sheet(images, texts, columns=columns)))
    print(f"skeletons: look into {options.output} (skeletons.png, extreme.png, tables.md)")


if __name__ == "__main__":
    main()
