"""The relations that Liao 2004 measured, on our sample models: ``python docs/make_thesis.py`` (``make thesis``).

Writes the tables into docs/thesis.md and the pictures of our own models into docs/images. Of the models that are named
on the command line (``make thesis ARGS='pig.off bunny.obj'``), which are striped, tables and pictures go to out/thesis.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import lodpipe
from lodpipe.core.asset import Asset, Lod, Target
from lodpipe.core.mesh import F64
from lodpipe.geometry.camera import Camera
from lodpipe.geometry.decimate import decimate_asset
from lodpipe.geometry.distance import distance_between
from lodpipe.geometry.flatten import flatten
from lodpipe.geometry.render import Style, render
from lodpipe.geometry.sheet import contact_sheet
from lodpipe.geometry.surface import Model
from lodpipe.geometry.texture import U8, Textures
from lodpipe.io import decode_image
from lodpipe.kernel import QuadricOptions
from lodpipe.kernel.similarity import SimilarityOptions

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "sample_assets"))

Options = QuadricOptions | SimilarityOptions
Rows = NDArray[np.bool_]

COUNTS = (2000, 1000, 700, 400)
LOCAL = SimilarityOptions(reference="previous")
METHODS: dict[str, Options] = {
    "local, half-edge": LOCAL,
    "global by scene, half-edge": SimilarityOptions(),
    "global by UV, half-edge": SimilarityOptions(correspondence="uv"),
    "local, full edge": replace(LOCAL, collapse="full"),
    "global by scene, full edge": SimilarityOptions(collapse="full"),
    "global by scene, half-edge, view penalty": SimilarityOptions(penalty="view"),
    "local, half-edge, view penalty": replace(LOCAL, penalty="view"),
    "QEM (no attributes), full edge": QuadricOptions(),
    "APS, half-edge": SimilarityOptions(metric="texture_deviation"),
    "IDS, half-edge": SimilarityOptions(metric="image"),
}
RAY = "global by scene, half-edge, view penalty"
SCENE = "global by scene, half-edge"
APS, IDS, QEM = "APS, half-edge", "IDS, half-edge", "QEM (no attributes), full edge"
FEATURES = ("local, half-edge", SCENE, "local, half-edge, view penalty", RAY, IDS, APS, QEM)


@dataclass
class Case:
    """A model, its decoded images, and the levels that each method made of it, by number of triangles."""

    source: Asset
    pixels: dict[int, U8]
    levels: dict[str, dict[int, Lod]]
    seconds: dict[str, float]

    @classmethod
    def of(cls, source: Asset, methods: Sequence[str], counts: Sequence[int] = COUNTS) -> Case:
        """Simplifies the model by all of the methods."""
        pixels = {i: decode_image(image) for i, image in enumerate(source.images)}
        case = cls(source, pixels, {}, {})
        for method in methods:
            start = time.process_time()
            targets = [Target(triangles=count) for count in counts]
            made = decimate_asset(source, targets, METHODS[method], pixels=pixels)
            case.seconds[method] = time.process_time() - start
            case.levels[method] = dict(zip(counts, made[1:], strict=True))
            print(f"{source.name}: {method}: {case.seconds[method]:.1f} s", flush=True)
        return case

    def picture(self, method: str | None, count: int, camera: Camera, size: int, wires: bool = False) -> U8:
        """A level, or the source for None, seen by the camera."""
        meshes = None if method is None else self.levels[method][count].meshes
        model = Model(self.source, meshes, Textures(self.pixels))
        return render(model, camera, size, size, Style(wireframe=1.0 if wires else 0.0), supersample=3)

    def distances(self, method: str) -> list[tuple[float, float]]:
        """Mean and largest distance to the source of each level, in % of its diagonal."""
        soup = flatten(self.source)
        found = []
        for level in self.levels[method].values():
            figure = distance_between(soup, flatten(self.source, level.meshes))
            found.append((figure.mean, figure.max))
        return found

    def loss(self, method: str, count: int, feature: Callable[[F64], Rows]) -> float:
        """Mean distance of a feature's vertices from the level, in % of the feature's own diagonal."""
        from lodpipe.o3d import RayScene

        soup, level = flatten(self.source), flatten(self.source, self.levels[method][count].meshes)
        points = soup.positions[feature(soup.positions)]
        near, _ = RayScene(level.positions.astype(np.float32), level.faces).closest(points.astype(np.float32))
        off = np.linalg.norm(near - points, axis=1).mean()
        return float(100 * off / np.linalg.norm(np.ptp(points, axis=0)))


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def distance_table(case: Case) -> str:
    """Tables 4.1 and 4.2 of the thesis in one: mean and largest distance for each method and number of triangles."""
    rows = []
    for method in case.levels:
        found = case.distances(method)
        got = [level.triangles for level in case.levels[method].values()]
        marks = ["" if n <= count else f" ({n})" for n, count in zip(got, case.levels[method], strict=True)]
        mean = " / ".join(f"{m:.3f}{mark}" for (m, _), mark in zip(found, marks, strict=True))
        rows.append([method, mean, " / ".join(f"{m:.2f}" for _, m in found), f"{case.seconds[method]:.1f}"])
    counts = " / ".join(map(str, next(iter(case.levels.values()))))
    return table([f"{case.source.name}, {counts}", "mean", "max", "CPU s"], rows)


def nostrils(p: F64) -> Rows:
    """Vertices inside the animal's two nostrils."""
    inside = np.minimum(*(np.hypot(p[:, 0] - x, p[:, 1] - 0.755) for x in (-0.055, 0.055))) < 0.045
    found: Rows = inside & (p[:, 2] > 0.85) & (p[:, 2] < 0.99)
    return found


def tail(p: F64) -> Rows:
    """Vertices of the animal's tail outside the body."""
    found: Rows = p[:, 2] < -0.66
    return found


def hooves(p: F64) -> Rows:
    """Vertices of the animal's hooves."""
    found: Rows = p[:, 1] < 0.14
    return found


def inside_of_mug(p: F64) -> Rows:
    """Vertices of the mug's hollow, its handle's ends left out."""
    found: Rows = (np.hypot(p[:, 0], p[:, 2]) < 0.435) & (p[:, 1] > 0.05) & ~((p[:, 0] > 0.38) & (abs(p[:, 2]) < 0.07))
    return found


def feature_table(animal: Case, mug: Case, methods: Sequence[str]) -> str:
    """How much of the thesis' features is lost by which method."""
    rows = []
    for method in methods:
        found = [animal.loss(method, 2000, nostrils), animal.loss(method, 400, tail), animal.loss(method, 400, hooves)]
        found.append(mug.loss(method, 400, inside_of_mug))
        rows.append([method, *(f"{x:.1f}" for x in found)])
    return table(
        ["mean distance, % of the feature", "nostrils, 2000", "tail, 400", "hooves, 400", "mug inside, 400"], rows
    )


def ringed_disk(rings: int = 24, spokes: int = 48) -> Asset:
    """A plain disk, a little curved, whose UVs are stretched in one ring."""
    from build import Part, asset

    radius = np.linspace(0, 1, rings + 1)[1:]
    flat = radius + 0.35 * np.clip(
        (radius - 0.55) / 0.1, 0, 1
    )  # UV radius: the ring 0.55 … 0.65 takes 4.5 times its share
    flat = flat / flat[-1] * 0.5
    angle = np.arange(spokes) * 2 * np.pi / spokes
    spot = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rim = np.concatenate([[[0, 0]], (radius[:, None, None] * spot).reshape(-1, 2)])
    uv = np.concatenate([[[0, 0]], (flat[:, None, None] * spot).reshape(-1, 2)]) + 0.5
    height = 0.1 * np.cos(rim[:, 0] * 1.5) * np.cos(rim[:, 1] * 1.5)  # a little curved: nothing is free
    at = 1 + np.arange(rings * spokes).reshape(rings, spokes)
    turned = np.roll(at, -1, axis=1)
    fan = np.stack([np.zeros(spokes, int), at[0], turned[0]], axis=1)
    quads = [at[:-1], at[1:], turned[1:], turned[:-1]]
    ring = np.concatenate([np.stack([quads[i].ravel() for i in t], axis=1) for t in ((0, 1, 2), (0, 2, 3))])
    faces = np.concatenate([fan, ring])
    texture = np.full((256, 256, 3), 200, np.uint8)
    positions = np.stack([rim[:, 0], height, -rim[:, 1]], axis=1)
    return asset("disk", positions, [Part(faces, uv[faces], texture, "plain")], crease=60)


def striped(path: Path, triangles: int) -> Asset:
    """A model without a texture, reduced to `triangles` by QEM, with stripes by a planar projection along z."""
    from build import Part, asset

    source = lodpipe.decimate(lodpipe.load(path), triangles)
    mesh = source.meshes[0]
    low, high = mesh.positions.min(axis=0), mesh.positions.max(axis=0)
    uv = ((mesh.positions - low) / (high - low).max())[:, :2]
    stripes = np.zeros((512, 512, 3), np.uint8)
    stripes[:] = np.where(np.arange(512)[:, None, None] // 16 % 2, 225, 60)
    return asset(
        f"striped {path.stem}", mesh.positions, [Part(mesh.faces, uv[mesh.faces].astype(float), stripes, "skin")], 60
    )


def around(case: Case, direction: Sequence[float]) -> Camera:
    """A camera that has the whole source in view."""
    model = Model(case.source, None, Textures(case.pixels))
    return Camera.around(model.centre, model.radius, direction)


def write(name: str, pictures: Sequence[U8], labels: Sequence[str], columns: int, folder: Path) -> None:
    """A sheet as a PNG of at most 256 colours."""
    from PIL import Image

    sheet = Image.fromarray(contact_sheet(pictures, labels, columns)).quantize(256)
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / f"{name}.png"
    sheet.save(target, optimize=True)
    print(target, target.stat().st_size // 1024, "kB")


def figures(animal: Case, mug: Case, disk: Case, folder: Path) -> None:
    """Figures 4.1 to 4.7, with our models."""
    side = around(animal, (1.0, 0.35, 0.9))
    local, uv = "local, half-edge", "global by UV, half-edge"
    shots = [(method, count) for method in (local, SCENE, uv) for count in (2000, 1000, 400)]
    write("thesis-global", [animal.picture(m, c, side, 240) for m, c in shots],
          [f"{m.split(',')[0]}, {c}" for m, c in shots], 3, folder)  # fmt: skip
    shots = [(method, count) for count in (1000, 400) for method in (QEM, RAY, IDS, APS)]
    names = {QEM: "QEM", RAY: "ray", IDS: "IDS", APS: "APS"}
    write("thesis-methods", [animal.picture(m, c, side, 240) for m, c in shots],
          [f"{names[m]}, {c}" for m, c in shots], 4, folder)  # fmt: skip
    hoof = Camera.around(np.array([0, 0.12, 0.0]), 0.5, (1.0, 0.2, 0.7))
    nose = Camera.around(np.array([0, 0.755, 0.95]), 0.2, (0.15, 0.1, 1.0))
    back = Camera.around(np.array([0, 0.72, -0.7]), 0.28, (-0.9, 0.3, -0.6))
    top = around(mug, (0.3, 1.4, 0.6))
    rows = [
        (animal, hoof, 400, "hooves"),
        (animal, nose, 2000, "nostrils"),
        (animal, back, 400, "tail"),
        (mug, top, 400, "mug"),
    ]
    pictures, labels = [], []
    for case, camera, count, what in rows:
        for method in (None, RAY, IDS, APS):
            pictures.append(case.picture(method, count, camera, 240))
            labels.append(what if method is None else f"{names[method]}, {count}")
    write("thesis-features", pictures, labels, 4, folder)
    above = around(disk, (0.0, 1.0, 0.01))
    write("thesis-disk", [disk.picture(m, c, above, 260, wires=True) for m, c in ((None, 0), (APS, 400), (RAY, 400))],
          ["source", "APS, 400", "ray, 400"], 3, folder)  # fmt: skip
    shots = [(method, count) for count in (1000, 400) for method in ("local, full edge", local)]
    write("thesis-full", [animal.picture(m, c, side, 320) for m, c in shots],
          [f"{m}, {c}" for m, c in shots], 2, folder)  # fmt: skip


def insert(page: Path, tables: dict[str, str]) -> None:
    """Puts each table between its two marks on the page."""
    text = page.read_text(encoding="utf-8")
    for name, made in tables.items():
        start, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
        before, _, rest = text.partition(start)
        after = rest.partition(end)[2]
        text = f"{before}{start}{made}\n{end}{after}"
    page.write_text(text, encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> None:
    """Make tables and pictures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("models", nargs="*", type=Path, help="untextured models; those are striped and measured too")
    parser.add_argument("--only-models", action="store_true", help="leave our own models out")
    options = parser.parse_args(arguments)
    if not options.only_models:
        samples = ROOT / "sample_assets"
        animal = Case.of(lodpipe.load(samples / "animal.glb"), list(METHODS))
        mug = Case.of(lodpipe.load(samples / "mug.glb"), FEATURES, (400,))
        disk = Case.of(ringed_disk(), [APS, RAY], (400,))
        insert(ROOT / "docs" / "thesis.md", {
            "distances": distance_table(animal),
            "features": feature_table(animal, mug, FEATURES),
        })  # fmt: skip
        figures(animal, mug, disk, ROOT / "docs" / "images")
    out = ROOT / "out" / "thesis"
    for path in options.models:
        bunny = "bunny" in path.stem
        counts = (2000, 700) if bunny else COUNTS
        case = Case.of(striped(path, 10000 if bunny else 7164), [m for m in METHODS if "UV" not in m], counts)
        out.mkdir(parents=True, exist_ok=True)
        (out / f"{path.stem}.md").write_text(distance_table(case) + "\n", encoding="utf-8")
        view = around(case, (0.6, 0.3, 1.0))
        shots = [(m, c) for c in counts[1::2] for m in (QEM, RAY, IDS, APS)]
        write(path.stem, [case.picture(m, c, view, 300) for m, c in shots], [f"{m}, {c}" for m, c in shots], 4, out)


if __name__ == "__main__":
    main()
