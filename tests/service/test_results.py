"""Results of stages kept from run to run: used when nothing that they depend on has changed, and only then."""

from __future__ import annotations

import dataclasses
import io
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import lodpipe
from chains import CHAIN, asset, plugin_folder, triangle_soup, write_obj
from lodpipe.core.asset import Asset, Lod, Target
from lodpipe.core.material import Image, Material
from lodpipe.core.page import Page, Picture
from lodpipe.service import results, store
from lodpipe.service.reasons import reasons
from lodpipe.service.recipe import Recipe

CACHED = CHAIN | {"cache": {"min_seconds": 0}}


@pytest.fixture
def run(tmp_path, monkeypatch):
    """`lodpipe.run` with every result kept; gives each stage's (kept, reason)."""
    monkeypatch.chdir(tmp_path)
    plugins = [plugin_folder(tmp_path)]

    def call(config=CACHED, **options):
        (outcome,) = lodpipe.run("a.obj", config, plugins=plugins, **options).outcomes
        assert outcome.outcome in ("ok", "warnings"), outcome.message
        return {part["name"]: (part["kept"], part["reason"]) for part in outcome.report["stages"]}

    write_obj(Path("a.obj"))
    return call


def hashes() -> list[tuple[str, str]]:
    files = json.loads(Path("out/a/manifest.json").read_text())["files"]
    return [(entry["path"], entry["sha256"]) for entry in files if entry["path"].startswith("LOD")]


def test_a_late_change_keeps_what_comes_before_it_and_gives_the_same_bytes(run):
    assert run() == {"thin": (False, ""), "export": (False, "")}
    first = hashes()
    obj = run(settings={"export.formats": ["glb", "obj"]})
    assert obj == {"thin": (True, ""), "export": (False, 'formats: ["glb"] → ["glb", "obj"]')}
    assert [entry for entry in hashes() if entry[0].endswith("glb")] == first


def test_warnings_and_measurements_of_kept_stages_stay_in_the_report(run):
    run(settings={"thin.say": "careful"})
    run(settings={"thin.say": "careful", "export.combined": True})
    part = json.loads(Path("out/a/report.json").read_text())["stages"][0]
    assert (part["kept"], part["warnings"], part["measurements"][0]["name"]) == (True, ["careful"], "levels")


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"thin.say": "x"}, 'say: "" → "x"'),
        ({"lods": [{"ratio": 0.3}]}, "lods changed"),
    ],
)
def test_what_a_stage_depends_on_makes_it_run_again(run, settings, reason):
    run()
    assert run(settings=settings)["thin"] == (False, reason)


def test_what_it_does_not_depend_on_does_not(run):
    run()
    assert run(settings={"seed": 5})["thin"] == (True, "")  # it has not looked at the seed


def test_another_input_or_an_edited_plugin_makes_all_run_again(run, tmp_path):
    run()
    write_obj(Path("a.obj"), cells=5)
    assert run() == {"thin": (False, "changed: a.obj"), "export": (False, "changed: a.obj")}
    (file,) = (tmp_path / "stages_for_tests").glob("*.py")
    file.write_text(file.read_text() + "\n")
    assert run() == {"thin": (False, "the plug-in was edited"), "export": (False, "after thin")}


def test_force_uses_nothing_that_was_kept(run):
    run()
    assert run(force=True)["thin"] == (False, "no result of it was kept")


def test_damage_and_other_code_are_not_taken(run, monkeypatch):
    run()
    (kept,) = Path("out/.lodpipe/cache").glob("*.asset")
    data = bytearray(kept.read_bytes())
    data[len(data) // 2] ^= 1
    kept.write_bytes(data)
    assert run(settings={"export.combined": True})["thin"] == (False, "no result of it was kept")
    monkeypatch.setattr(results, "_code", lambda: "other")
    assert run()["thin"][0] is False


def test_nothing_is_kept_of_quick_stages_or_when_it_is_turned_off(run):
    run(CHAIN)
    run(CHAIN | {"cache": {"min_seconds": 0, "gb": 0}}, force=True)
    assert not Path("out/.lodpipe/cache").exists()


def test_the_oldest_go_when_there_is_no_more_room(run):
    run()
    (kept,) = Path("out/.lodpipe/cache").glob("*.asset")
    size = kept.stat().st_size
    for number in range(6):
        run(CHAIN | {"cache": {"min_seconds": 0, "gb": 2.9 * size / 1e9}}, settings={"thin.say": str(number)})
    files = list(Path("out/.lodpipe/cache").iterdir())
    assert sum(path.stat().st_size for path in files) <= 2.9 * size
    assert kept not in files
    assert len([path for path in files if path.suffix == ".asset"]) == 2


def test_no_room_at_all_does_not_matter(run, monkeypatch):
    def full(self, name, put):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(results.StageResults, "_write", full)
    assert run()["export"] == (False, "")


def test_an_asset_comes_back_as_it_was():
    mesh = triangle_soup(0.0, 3.0)
    mesh = dataclasses.replace(mesh, attributes={"TEXCOORD_0": np.zeros((len(mesh.positions), 2), np.float32)})
    whole = asset(
        images=(Image(b"\x00\xff", width=1, height=1),),
        materials=(Material({"name": "red", "extras": [1, None, True, 0.1]}),),
        document={"nodes": [{"mesh": 0}]},
        lods=(Lod((mesh,), Target(ratio=0.5), "target"),),
        path=Path("x/a.obj"),
    )
    page = Page(files={"a.bin": b"123"}, models={0: "a.gltf"}, pictures=[Picture("p", "shaded", "", b"png", 1, 1)])
    file = io.BytesIO()
    size = store.write(file, (whole, page))
    assert size == len(file.getvalue())
    again, page_again = store.read(file.getvalue())
    assert isinstance(again, Asset)
    assert again.fingerprint() == whole.fingerprint()
    assert (again.path, again.lods[0].target, page_again) == (whole.path, whole.lods[0].target, page)
    assert not again.lods[0].meshes[0].positions.flags.writeable


PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**60), 2**60) | st.floats(allow_nan=False) | st.text() | st.binary(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text() | st.integers(), inner) | st.tuples(inner, inner),
    max_leaves=20,
)


@given(PLAIN)
def test_plain_data_comes_back_as_it_was(value):
    file = io.BytesIO()
    store.write(file, value)
    assert store.read(file.getvalue()) == value


@given(st.binary(max_size=200), st.integers(0, 60))
def test_any_other_bytes_are_refused(data, cut):
    file = io.BytesIO()
    store.write(file, (np.arange(5), {"a": [1.5]}))
    for broken in (data, file.getvalue()[:-1], file.getvalue()[: max(0, len(file.getvalue()) - cut - 1)] + data):
        if broken != file.getvalue():
            with pytest.raises(ValueError, match=r"version|damaged|cut off"):
                store.read(broken)


def test_what_has_no_place_in_the_file_is_told():
    for value in (object(), {"a": {1, 2}}, np.array([object()])):
        with pytest.raises(store.CannotStore):
            store.write(io.BytesIO(), value)


def test_only_plain_data_of_lodpipe_is_made_from_a_file():
    text = json.dumps({"data": ["subprocess", "Popen", {"args": {"list": ["true"]}}]}).encode()
    import zlib

    data = store._HEAD.pack(b"lodpipe1", len(text), 0) + text + zlib.crc32(text).to_bytes(4, "little")
    with pytest.raises(ValueError, match="not a module of plain data"):
        store.read(data)


def test_reasons_of_a_manifest_that_cannot_be_compared():
    recipe = Recipe({"stages": [{"export": {}}]}, ({"name": "export", "version": 1},))
    assert reasons(None, [], recipe) == [""]
    assert reasons({}, [], recipe) == ["the last result is of another version"]
