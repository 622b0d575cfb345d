"""Which files become assets, and what their outputs are called."""

from __future__ import annotations

from pathlib import Path

import pytest

from lodpipe.service.discover import find_assets


@pytest.fixture
def tree(tmp_path, monkeypatch):
    """Makes empty files below a folder that is the working directory."""
    monkeypatch.chdir(tmp_path)

    def make(*names: str) -> Path:
        for name in names:
            Path(name).parent.mkdir(parents=True, exist_ok=True)
            Path(name).write_text("")
        return tmp_path

    return make


def places(*inputs, output: str = "out") -> dict[str, str]:
    found, problems = find_assets(inputs, Path(output))
    assert problems == []
    return {asset.path.as_posix(): str(asset.place) for asset in found}


def test_a_file_stands_for_itself(tree):
    tree("models/duck.glb")
    assert places("models/duck.glb") == {"models/duck.glb": "duck"}


def test_a_folder_keeps_its_relative_folders_in_order(tree):
    tree("m/b/duck.glb", "m/a/cow.OBJ", "m/z.ply", "m/a/cow.mtl", "m/a/cow.png", "m/b/duck.bin", "m/notes.txt")
    assert list(places("m").items()) == [("m/z.ply", "z"), ("m/a/cow.OBJ", "a/cow"), ("m/b/duck.glb", "b/duck")]


def test_globs_are_relative_to_their_fixed_part(tree):
    tree("m/a/duck.glb", "m/b/c/cow.glb", "m/b/pig.obj", "m/x.glb")
    assert places("m/**/*.glb") == {"m/a/duck.glb": "a/duck", "m/b/c/cow.glb": "b/c/cow", "m/x.glb": "x"}
    assert places("m/b/*") == {"m/b/c/cow.glb": "c/cow", "m/b/pig.obj": "pig"}
    assert places("m/?/duck.glb") == {"m/a/duck.glb": "a/duck"}


def test_a_name_with_glob_signs_is_a_file_first(tree):
    tree("m/duck[1].glb")
    assert places("m/duck[1].glb") == {"m/duck[1].glb": "duck[1]"}


def test_hidden_files_own_output_and_other_outputs_are_left_out(tree):
    tree("m/duck.glb", "m/.hidden.glb", "m/.git/x.glb", "m/~$duck.glb", "m/out/duck/LOD0/duck_LOD0.glb")
    tree("m/old/.lodpipe/tmp", "m/old/duck/LOD0/duck_LOD0.glb")
    assert places("m", output="m/out") == {"m/duck.glb": "duck"}
    assert places("m/**", output="m/out") == {"m/duck.glb": "duck"}


@pytest.mark.parametrize("given", ["m", "m/a", "m/*.glb", "m/a/*"])
def test_results_never_become_inputs(tree, given):
    tree("m/duck.glb", "m/a/cow.glb")
    found, problems = find_assets([given], Path("m"))
    assert found == []
    assert "lies in the output folder" in str(problems[0])
    assert str(find_assets(["m/duck.glb"], Path("m"))[0][0].place) == "duck"


def test_what_is_named_twice_counts_once(tree):
    tree("m/duck.glb")
    Path("m/link.glb").symlink_to("duck.glb")
    assert places("m", "m/duck.glb", "m/*.glb") == {"m/duck.glb": "duck"}


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["a.obj", "a.glb"], {"a.obj": "a_obj", "a.glb": "a"}),
        (["a.glb", "a.obj", "a.ply", "a.GLTF"], {"a.glb": "a", "a.GLTF": "a_gltf", "a.obj": "a_obj", "a.ply": "a_ply"}),
        (["A.glb", "a.glb"], {"A.glb": "A", "a.glb": "a_glb"}),
        (["a.glb", "a/b.glb"], {"a.glb": "a_glb", "a/b.glb": "a/b"}),
        (["a.glb", "a.obj", "a_obj.glb"], {"a.glb": "a", "a.obj": "a_obj_2", "a_obj.glb": "a_obj"}),
    ],
)
def test_names_that_clash_are_told_apart(tree, names, expected):
    tree(*(f"m/{name}" for name in names))
    assert places("m") == {f"m/{path}": place for path, place in expected.items()}


def test_files_of_one_name_from_two_folders(tree):
    tree("x/duck.glb", "y/duck.glb", "z/duck.glb")
    assert list(places("x/duck.glb", "y/duck.glb", "z/duck.glb").values()) == ["duck", "duck_glb", "duck_glb_2"]


def test_a_name_cannot_hide_the_output(tree):
    tree(".failed.glb", "dots. .glb", "...obj")
    assert list(places(".failed.glb", "dots. .glb", "...obj").values()) == ["_failed", "dots", "asset"]


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ("nothing.glb", "nothing.glb: there is no such file or folder; check the path; quote globs"),
        ("empty", "empty: has no assets in it; known formats: .glb, .gltf, .obj, .ply, .stl, .off"),
        ("*.ply", "*.ply: matches no asset; known formats"),
    ],
)
def test_what_is_not_there_is_told_and_the_rest_goes_on(tree, given, line):
    tree("duck.glb", "empty/readme.txt")
    found, problems = find_assets([given, "duck.glb"], Path("out"))
    assert [str(asset.place) for asset in found] == ["duck"]
    assert str(problems[0]).startswith(line)
