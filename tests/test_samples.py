"""The sample models keep what their README promises."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from lodpipe.geometry.flatten import flatten
from lodpipe.io import decode_image, load

FOLDER = Path(__file__).parent.parent / "sample_assets"
NAMES = ("animal", "mug", "starfish", "cubes", "terrain", "buoy", "ring")


@pytest.fixture(scope="module")
def make():
    """The script as a module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(FOLDER)
        import make

        yield make


@pytest.fixture(scope="module")
def samples(make, tmp_path_factory):
    """All samples, written and read again."""
    folder = tmp_path_factory.mktemp("samples")
    make.main(folder)
    assert sorted(path.stem for path in folder.iterdir()) == sorted(NAMES)
    return {path.stem: load(path) for path in folder.iterdir()}


def edge_uses(faces):
    """How many triangles each edge has, and whether each direction of an edge occurs once at most."""
    directed = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    _, uses = np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)
    return uses, len(np.unique(directed, axis=0)) == len(directed)


def components_of(faces, count):
    """(V,) int: a number for each connected component, at its vertices."""
    label = np.arange(count)
    while True:
        lowest = label[faces].min(axis=1)
        new = label.copy()
        for k in range(3):
            np.minimum.at(new, faces[:, k], lowest)
        new = new[new]
        if np.array_equal(new, label):
            return label
        label = new


def volume(positions, faces):
    a, b, c = (positions[faces[:, k]] for k in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


def doubly_covered(uv, size):
    """Texel centres of a `size`² grid that lie well inside more than one UV triangle (F, 3, 2)."""
    covered = np.zeros((size, size), np.int32)
    for a, b, c in uv * size:
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0:
            continue
        x0, y0 = np.floor(np.min([a, b, c], axis=0)).astype(int)
        x1, y1 = np.ceil(np.max([a, b, c], axis=0)).astype(int)
        x, y = np.arange(x0, x1)[None] + 0.5, np.arange(y0, y1)[:, None] + 0.5
        u = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
        v = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
        covered[y0:y1, x0:x1] += (u > 1e-3) & (v > 1e-3) & (u + v < 1 - 1e-3)
    return int((covered > 1).sum()), float((covered > 0).mean())


def uv_of(asset):
    mesh = asset.meshes[0]
    return mesh.attributes["TEXCOORD_0"][mesh.wedges].astype(np.float64)


def test_the_readme_tells_the_truth_about_sizes(samples):
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    told = {
        name: int(count.replace(",", "")) for name, count in re.findall(r"^\| `(\w+)\.glb` \| ([\d,]+) \|", text, re.M)
    }
    assert told == {name: asset.triangles for name, asset in samples.items()}
    assert 6500 <= told["animal"] <= 7500


@pytest.mark.parametrize(
    ("name", "components", "holes"),
    [("animal", 1, 0), ("mug", 2, 0), ("starfish", 1, 0), ("cubes", 100, 0), ("buoy", 1, 0), ("ring", 1, 1)],
)
def test_closed_surfaces(samples, name, components, holes):
    soup = flatten(samples[name])
    uses, oriented = edge_uses(soup.faces)
    assert (uses == 2).all()
    assert oriented
    assert len(np.unique(components_of(soup.faces, len(soup.positions))[soup.faces])) == components
    assert len(soup.positions) - len(uses) + len(soup.faces) == 2 * (components - holes)
    label = components_of(soup.faces, len(soup.positions))[soup.faces[:, 0]]
    for number in np.unique(label):  # counter-clockwise from outside
        assert volume(soup.positions, soup.faces[label == number]) > 0


def test_the_terrain_is_open(samples):
    soup = flatten(samples["terrain"])
    uses, oriented = edge_uses(soup.faces)
    assert (uses == 1).sum() == 4 * 64
    assert oriented
    assert (np.asarray(samples["terrain"].meshes[0].attributes["NORMAL"])[:, 1] > 0.5).all()


@pytest.mark.parametrize(("name", "least"), [("animal", 0.3), ("mug", 0.8), ("starfish", 0.15), ("terrain", 0.95)])
def test_one_to_one_atlases(samples, name, least):
    uv = uv_of(samples[name])
    assert uv.min() >= 0
    assert uv.max() <= 1
    twice, used = doubly_covered(uv, 1536)
    assert twice == 0
    assert used > least  # of the texture's texels


def test_textures_read_the_right_way_round(samples):
    """Not mirrored: with v down, triangles that are counter-clockwise in space are clockwise in the texture."""
    for name in ("animal", "mug", "starfish", "terrain", "cubes", "buoy"):
        a, b, c = (uv_of(samples[name])[:, k] for k in range(3))
        area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
        assert (area <= 1e-12).all(), name


def test_the_ring_is_tiled_and_mirrored(samples):
    uv = uv_of(samples["ring"])
    a, b, c = (uv[:, k] for k in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert (area > 0).sum() == (area < 0).sum() == 2304
    assert uv.min() < -0.9
    assert uv.max() == pytest.approx(4)
    assert {sampler["wrapS"] for sampler in samples["ring"].document["samplers"]} == {10497, 33648}


def test_the_buoys_materials_meet_along_a_ring(samples):
    mesh = samples["buoy"].meshes[0]
    assert set(mesh.face_material) == {0, 1}
    ends = np.concatenate([mesh.faces[:, [k, (k + 1) % 3]] for k in range(3)])
    edge = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)[1]
    material = np.tile(mesh.face_material, 3)
    mixed = np.bincount(edge, material) == 1  # one of the edge's two triangles is of material 1
    assert mixed.sum() == 48


def test_every_sample_has_normals_and_a_texture(samples):
    for asset in samples.values():
        assert asset.warnings == ()
        mesh = asset.meshes[0]
        np.testing.assert_allclose(np.linalg.norm(mesh.attributes["NORMAL"], axis=1), 1, atol=1e-5)
        for image in asset.images:
            assert decode_image(image).std() > 20


def test_the_animal_has_its_parts(samples):
    positions = samples["animal"].meshes[0].positions
    thin = positions[positions[:, 2] < -0.8]
    assert np.ptp(thin[:, 0]) > 0.12  # the tail curls
    assert np.ptp(thin[:, 1]) > 0.12
    assert positions[:, 1].min() == pytest.approx(0, abs=0.01)
    feet = positions[positions[:, 1] < 0.02]
    assert len(np.unique(np.sign(feet[:, [0, 2]]), axis=0)) == 4
    inside = positions[
        (np.hypot(np.abs(positions[:, 0]) - 0.055, positions[:, 1] - 0.755) < 0.03) & (positions[:, 2] > 0.8)
    ]
    assert inside[:, 2].min() < 0.97  # the nostrils are holes


def test_the_same_bytes_each_time(make, samples, tmp_path, monkeypatch):
    monkeypatch.setattr(make, "SAMPLES", (make.animal, make.buoy))
    make.main(tmp_path)
    for name in ("animal", "buoy"):
        assert (tmp_path / f"{name}.glb").read_bytes() == samples[name].path.read_bytes()
