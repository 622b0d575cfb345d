"""When a result is still the one that a run would give, and when it is not."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from chains import CHAIN, plugin_folder, write_obj
from lodpipe import io
from lodpipe.service import manifest
from lodpipe.service.chain import load_pipeline
from lodpipe.service.recipe import Recipe

MTL = "newmtl red\nmap_Kd {}\n"


@pytest.fixture
def plugins(tmp_path):
    return [plugin_folder(tmp_path)]


@pytest.fixture
def published(tmp_path, plugins):
    """An OBJ with its MTL, which names a texture that is not there, and a folder that was made of it."""
    source = write_obj(tmp_path / "in" / "a.obj")
    source.write_text("mtllib a.mtl\nmtllib b.mtl\nusemtl red\n" + source.read_text().replace("f ", "vt 0 0\nf ", 1))
    (source.parent / "a.mtl").write_text(MTL.format("red.png"))
    folder = tmp_path / "out"
    (folder / "LOD0").mkdir(parents=True)
    (folder / "LOD0" / "a_LOD0.glb").write_text("model")
    recipe = recipe_of((), plugins)
    manifest.write(folder, io.load(source), recipe, "a", "ok", {"lodpipe": "1"})
    return folder, source, recipe


def recipe_of(settings, plugins) -> Recipe:
    return Recipe.of(load_pipeline(CHAIN, settings, plugins))


def current(published):
    return manifest.current(*published)


def test_what_it_says(published):
    folder, _, recipe = published
    data = json.loads((folder / manifest.NAME).read_text())
    assert [entry["path"] for entry in data["inputs"]] == ["a.obj", "a.mtl"]
    assert data["missing"] == ["b.mtl", "red.png"]
    assert [(entry["path"], entry["size"]) for entry in data["files"]] == [("LOD0/a_LOD0.glb", 5)]
    assert data["files"][0]["sha256"] == "9372c470eeadd5ecd9c3c74c2b3cb633f8e2f2fad799250a0f70d652b6b825e4"
    assert data["config"] == recipe.config
    assert len(data["fingerprint"]) == 64
    assert [stage["name"] for stage in data["stages"]] == ["thin", "export"]


def test_the_same_again_is_current_and_so_is_a_touched_file(published):
    assert current(published)
    os.utime(published[1])
    assert current(published)


def test_a_broken_texture_is_not_a_missing_one(published):
    folder, source, recipe = published
    (source.parent / "red.png").write_text("no image")
    (source.parent / "b.mtl").write_text("")
    manifest.write(folder, io.load(source), recipe, "a", "ok", {})
    assert current(published)["missing"] == []
    (source.parent / "red.png").write_text("another one")
    assert current(published) is None


@pytest.mark.parametrize(
    "change",
    [
        lambda folder, source: source.write_text(source.read_text() + "# changed"),
        lambda folder, source: (source.parent / "a.mtl").write_text(MTL.format("rad.png")),
        lambda folder, source: (source.parent / "a.mtl").unlink(),
        lambda folder, source: (source.parent / "red.png").write_text("there now"),
        lambda folder, source: (source.parent / "b.mtl").write_text("there now"),
        lambda folder, source: (folder / "LOD0" / "a_LOD0.glb").write_text("other"),
        lambda folder, source: (folder / "LOD0" / "a_LOD0.glb").unlink(),
        lambda folder, source: (folder / manifest.NAME).unlink(),
        lambda folder, source: (folder / manifest.NAME).write_text("{"),
        lambda folder, source: (folder / manifest.NAME).write_text("[]"),
        lambda folder, source: (folder / manifest.NAME).write_text('{"manifest_version": 1}'),
        lambda folder, source: (folder / manifest.NAME).write_text('{"manifest_version": 1, "inputs": 3, "files": 4}'),
    ],
)
def test_any_change_of_input_or_output_counts(published, change):
    folder, source, _ = published
    assert current(published)
    change(folder, source)
    assert current(published) is None


@pytest.mark.parametrize(
    ("settings", "same"),
    [
        ({"seed": 1}, False),
        ({"lods": [{"ratio": 0.4}]}, False),
        ({"thin.say": "hello"}, False),
        ({"budgets.bytes": 10}, False),
        ({"threads": 2}, True),
        ({"limits.minutes": 2}, True),
    ],
)
def test_a_change_of_the_configuration_counts_where_it_can_matter(published, plugins, settings, same):
    folder, source, _ = published
    assert bool(manifest.current(folder, source, recipe_of(settings, plugins))) is same


def test_an_edited_plugin_counts(published, plugins):
    folder, source, _ = published
    file = next(Path(plugins[0]).glob("*.py"))
    file.write_text(file.read_text() + "\n# edited\n")
    assert manifest.current(folder, source, recipe_of((), plugins)) is None


def test_foreign_files(published):
    folder, *_ = published
    assert manifest.foreign_files(folder) == []
    (folder / "mine.txt").write_text("")
    (folder / "empty").mkdir()
    assert manifest.foreign_files(folder) == ["mine.txt"]
    (folder / manifest.NAME).unlink()
    assert manifest.foreign_files(folder) == ["LOD0/a_LOD0.glb", "mine.txt"]
