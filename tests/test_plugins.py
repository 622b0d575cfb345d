"""Where stages come from, and what is said of plug-ins that do not work."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from chains import plugin_folder
from lodpipe.core.errors import ConfigError
from lodpipe.plugins import find_stages
from lodpipe.stages import BUILTIN

REPO = Path(__file__).parent.parent

GOOD = """
from __future__ import annotations
from lodpipe.stage import stage, Params, Context
from lodpipe.core.asset import Asset
from lodpipe.stages.export import export

class PaintParams(Params):
    '''Parameters of `paint`.'''
    colour: str = "red"
    '''Which.'''

@stage("paint", version=3)
def paint(asset: Asset, params: PaintParams, context: Context) -> Asset:
    '''Paint it.'''
    return asset
"""


def folder_with(root: Path, **files: str) -> Path:
    root.mkdir(exist_ok=True)
    for name, text in files.items():
        (root / f"{name}.py").write_text(text)
    return root


def test_built_in_stages_alone():
    found = find_stages(installed=False)
    assert found == BUILTIN
    assert found is not BUILTIN
    assert {stage.origin for stage in found.values()} == {"built in"}
    assert all(name == stage.name for name, stage in BUILTIN.items())


def test_a_folder_adds_its_own_stages_and_nothing_stays_behind(tmp_path):
    folder = folder_with(tmp_path, paint=GOOD, _helper="raise ValueError", test_paint="raise ValueError")
    found = find_stages([folder, folder], installed=False)
    assert set(found) - set(BUILTIN) == {"paint"}  # not `export`, which the file imports
    assert found["paint"].origin == str(tmp_path / "paint.py")
    assert (found["paint"].version, found["paint"].summary) == (3, "Paint it.")
    assert found["paint"].params.model_fields["colour"].description == "Which."
    assert "paint" not in find_stages(installed=False)


def test_the_plugins_of_this_repository_load():
    assert {"recenter", "drop_small_parts"} <= set(find_stages([REPO / "plugins"], installed=False))


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("import nothing_like_it", ":1: the plug-in cannot be loaded: ModuleNotFoundError: No module named"),
        ("x = 1\ndef broken(:", ":2: the plug-in cannot be loaded: SyntaxError: invalid syntax"),
        ("a = 1\nb = a / 0", ":2: the plug-in cannot be loaded: ZeroDivisionError: division by zero"),
        ("raise SystemExit(3)", ":1: the plug-in cannot be loaded: SystemExit: 3"),
        ("x = 1", ": has no stage; decorate a function with @stage"),
    ],
)
def test_a_broken_plugin_is_one_line(tmp_path, text, line):
    folder = folder_with(tmp_path, broken=text)
    before = set(sys.modules)
    with pytest.raises(ConfigError) as caught:
        find_stages([folder], installed=False)
    assert str(caught.value).startswith(f"{tmp_path / 'broken.py'}{line}")
    assert "\n" not in str(caught.value)
    if "has no stage" not in line:
        assert not [name for name in set(sys.modules) - before if name.startswith("lodpipe_plugin_")]


def test_a_taken_name_is_told_with_both_places(tmp_path):
    folder = folder_with(tmp_path, a=GOOD, b=GOOD)
    with pytest.raises(ConfigError) as caught:
        find_stages([folder], installed=False)
    first, second = tmp_path / "a.py", tmp_path / "b.py"
    taken = f"{second}: the stage 'paint' is there already ({first}); give one of the two another name"
    assert str(caught.value) == taken
    folder_with(tmp_path, a=GOOD.replace('"paint"', '"export"'), b="")
    with pytest.raises(ConfigError, match=r"the stage 'export' is there already \(built in\)"):
        find_stages([folder], installed=False)


def test_a_missing_folder_is_told(tmp_path):
    with pytest.raises(ConfigError, match="there is no such folder of plug-ins"):
        find_stages([tmp_path / "none"], installed=False)


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """A distribution on the path that names stages by entry points."""

    def install(points: str, **modules: str) -> None:
        folder_with(tmp_path / "site", **modules)
        info = tmp_path / "site" / "paintbox-1.2.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: paintbox\nVersion: 1.2\n")
        (info / "entry_points.txt").write_text(f"[lodpipe.stages]\n{points}\n")
        monkeypatch.syspath_prepend(str(tmp_path / "site"))

    yield install
    for name in ("paintbox_a", "paintbox_b"):
        sys.modules.pop(name, None)


def test_entry_points_name_a_stage_or_a_module(installed):
    installed("a = paintbox_a:paint\nb = paintbox_b", paintbox_a=GOOD, paintbox_b=GOOD.replace('"paint"', '"dye"'))
    found = find_stages()
    assert {name: found[name].origin for name in ("paint", "dye")} == {"paint": "paintbox 1.2", "dye": "paintbox 1.2"}


@pytest.mark.parametrize(
    ("point", "line"),
    [
        ("a = paintbox_a:nothing", "paintbox 1.2 (paintbox_a:nothing): the plug-in cannot be loaded: AttributeError"),
        ("a = paintbox_a:PaintParams", "paintbox 1.2 (paintbox_a:PaintParams): is not a stage but a ModelMetaclass"),
    ],
)
def test_a_broken_entry_point_is_one_line(installed, point, line):
    installed(point, paintbox_a=GOOD)
    with pytest.raises(ConfigError) as caught:
        find_stages()
    assert str(caught.value).startswith(line)


def test_the_stages_for_tests_load(tmp_path):
    assert {"thin", "fail"} <= set(find_stages([plugin_folder(tmp_path)], installed=False))
