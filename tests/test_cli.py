"""The command line: exit codes, streams, and what a stranger reads."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import jsonschema
import pytest
import yaml

import lodpipe
from chains import CHAIN, plugin_folder, write_obj
from lodpipe import cli
from lodpipe.config.schema import json_schema
from lodpipe.plugins import find_stages
from lodpipe.stages import BUILTIN


@pytest.fixture
def main(tmp_path, monkeypatch, capsys):
    """The program in this process, in a folder of its own: (exit code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NO_COLOR", "1")
    plugin_folder(tmp_path).rename(tmp_path / "plugins")
    Path("chain.yaml").write_text(json.dumps(CHAIN))
    write_obj(Path("a.obj"))

    def call(*arguments: str) -> tuple[int, str, str]:
        try:
            code = cli.main(arguments)
        except SystemExit as end:
            code = int(end.code or 0)
        return (code, *capsys.readouterr())

    return call


def test_run_says_what_it_did(main):
    code, out, err = main("run", "a.obj", "-c", "chain.yaml", "-o", "lods")
    assert code == 0
    assert out.splitlines()[0].startswith("a: ok, ")
    head = "level triangles % vertices size mean error % max error % stopped by"
    assert " ".join(out.splitlines()[1].split()) == head
    assert out.splitlines()[3].split()[:3] == ["1", "16", "50.0"]
    assert err == "[1/1] a: load\n[1/1] a: thin\n[1/1] a: export\n[1/1] a: publish\n"
    assert Path("lods/a/LOD2/a_LOD2.glb").is_file()
    assert main("run", "a.obj", "-c", "chain.yaml", "-o", "lods")[1] == "a: unchanged, lods/a is up to date\n"


def test_run_takes_settings_in_order(main):
    code, _, _ = main(
        "run", "a.obj", "-c", "chain.yaml", "--set", "lods=[{ratio: 0.75}]", "--set", "export.formats=[obj, glb]", "-q"
    )
    assert code == 0
    assert sorted(path.name for path in Path("out/a/LOD1").iterdir()) == ["a_LOD1.glb", "a_LOD1.obj"]
    assert json.loads(Path("out/a/report.json").read_text())["lods"][1]["triangles"] == 24


def test_an_error_of_an_asset_is_one_line_and_exit_code_1(main):
    Path("b.obj").write_text("v 0 0 0\n")
    code, out, err = main("run", "b.obj", "-q")
    assert (code, out) == (1, "")
    assert err.count("\n") == 1
    assert err.startswith("error: b.obj: ")


def test_a_bug_is_exit_code_3_and_one_line(main):
    code, _, err = main("run", "a.obj", "-c", "chain.yaml", "--set", "stages=[{fail: {how: bug}}]", "-q")
    assert code == 3
    assert err == (
        "error: a.obj: fail: internal error: TypeError: a bug on purpose; this is a bug in lodpipe or a plug-in,"
        " please report it with the log in out/.failed/a\n"
    )


def test_a_wrong_configuration_is_a_line_for_each_mistake(main):
    Path("chain.yaml").write_text("stages:\n  - exprt\n  - report: {sampels: 1}\n")
    code, out, err = main("run", "a.obj", "-c", "chain.yaml")
    assert (code, out) == (1, "")
    assert err == (
        "error: chain.yaml:2:5: stages[0]: unknown stage 'exprt'; did you mean 'export'?\n"
        "error: chain.yaml:3:14: stages[1].report: unknown key 'sampels'; did you mean 'samples'?\n"
    )


@pytest.mark.parametrize(
    "arguments",
    [(), ("run",), ("rum", "a.obj"), ("run", "a.obj", "--workers", "0"), ("run", "a.obj", "--what"), ("check",)],
)
def test_wrong_usage_is_exit_code_2(main, arguments):
    code, _, err = main(*arguments)
    assert code == 2
    assert "usage: lodpipe" in err


def test_an_interruption_is_exit_code_130(main):
    code, _, err = main("run", "a.obj", "-c", "chain.yaml", "--set", "stages=[{fail: {how: interrupt}}]")
    assert code == 130
    assert err.endswith("interrupted\n")
    assert not Path("out/a").exists()


def test_an_unexpected_error_of_the_program_itself(main, monkeypatch):
    monkeypatch.setattr(cli, "_check", lambda options: 1 / 0)
    code, _, err = main("check", "default")
    assert code == 3
    assert err.startswith("error: internal error: ZeroDivisionError: division by zero\nthis is a bug")
    assert "Traceback" not in err
    monkeypatch.setenv(cli.TRACEBACK, "1")
    assert "Traceback" in main("check", "default")[2]


def test_run_in_json(main):
    Path("b.obj").write_text("v 0 0 0\n")
    code, out, err = main("run", "a.obj", "b.obj", "none.obj", "-c", "chain.yaml", "--json", "--workers", "2")
    assets = {asset["input"]: asset for asset in json.loads(out)["assets"]}
    assert code == 1
    assert {name: asset["outcome"] for name, asset in assets.items()} == {
        "a.obj": "ok",
        "b.obj": "failed",
        "none.obj": "failed",
    }
    assert assets["a.obj"]["report"]["lods"][2]["triangles"] == 8
    assert assets["b.obj"]["message"].startswith("b.obj: ")
    assert [line[:7] for line in err.splitlines()] == ["error: "] * 2


def test_check(main):
    assert main("check", "chain.yaml") == (0, "chain.yaml: ok: 2 levels below the source, thin → export\n", "")
    code, out, _ = main("check", "chain.yaml", "--resolved", "--set", "seed=4")
    data = yaml.safe_load(out)
    assert (code, data["seed"], data["limits"]["minutes"]) == (0, 4, 30)
    assert data["stages"] == [{"thin": {"say": ""}}, {"export": {"formats": ["glb"], "combined": False}}]
    Path("again.yaml").write_text(out)
    assert main("check", "again.yaml", "--resolved")[1] == out
    assert main("check", "chian.yaml")[2] == "error: chian.yaml: there is no such file\n"
    assert main("check", "defualt")[2] == ("error: defualt: there is no such file or preset; did you mean 'default'?\n")


def test_stages(main):
    code, out, _ = main("stages")
    assert code == 0
    assert [line.split()[0] for line in out.splitlines()[1:-2]] == sorted(BUILTIN)
    assert "built in" in out
    out = main("stages", "--plugins", "plugins")[1]
    assert str(Path("plugins/stages_for_tests.py").resolve()) in out
    out = main("stages", "export")[1]
    assert 'formats: list of glb or gltf or obj or ply or stl or off at least 1 = ["glb"]' in out
    assert main("stages", "exprt") == (1, "", "error: unknown stage 'exprt'; did you mean 'export'?\n")
    listed = json.loads(main("stages", "--json")[1])
    assert {stage["name"] for stage in listed} == set(BUILTIN)
    assert all(param["doc"] and param["type"] for stage in listed for param in stage["params"])


def test_schema(main):
    data = json.loads(main("schema", "--plugins", "plugins")[1])
    jsonschema.Draft202012Validator.check_schema(data)
    jsonschema.validate(CHAIN, data)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(CHAIN, json_schema(BUILTIN))


def test_init_makes_a_folder_that_works(main):
    code, out, _ = main("init", "start")
    assert code == 0
    assert out.split() == ["start/lodpipe.yaml", "start/lodpipe.schema.json", "start/README.md", "start/drop"]
    assert main("check", "start/lodpipe.yaml")[0] == 0
    schema = json.loads(Path("start/lodpipe.schema.json").read_text())
    jsonschema.validate(yaml.safe_load(Path("start/lodpipe.yaml").read_text()), schema)
    before = Path("start/lodpipe.yaml").read_text()
    code, out, err = main("init", "start")
    assert (code, out) == (1, "")
    assert err.startswith("error: start: is there already (lodpipe.yaml, lodpipe.schema.json, README.md, drop)")
    assert Path("start/lodpipe.yaml").read_text() == before


def test_init_refuses_before_it_has_written_anything(main):
    Path("start").mkdir()
    Path("start/README.md").write_text("mine")
    assert main("init", "start")[0] == 1
    assert [path.name for path in Path("start").iterdir()] == ["README.md"]


def test_inspect(main):
    code, out, _ = main("inspect", "a.obj")
    assert code == 0
    assert out.startswith("a (obj): 32 triangles, 25 vertices\n")
    assert "topology defects" in out
    data = json.loads(main("inspect", "a.obj", "--json")[1])
    assert data["meshes"]["properties"][0]["glPrimitives"] == 32
    assert data["topology"][0]["boundary_edges"] == 16
    assert data["uv"][0]["missing_faces"] == 32
    code, _, err = main("inspect", "none.obj")
    assert (code, err) == (1, "error: none.obj: no such file; check the path\n")


def test_the_version_is_that_of_the_package(main):
    assert main("--version")[:2] == (0, f"lodpipe {lodpipe.__version__}\n")


def test_public_names():
    assert {"load", "run", "save", "decimate", "Pipeline", "load_pipeline", "find_stages"} <= set(dir(lodpipe))
    assert all(getattr(lodpipe, name) for name in dir(lodpipe) if name in lodpipe._PUBLIC)
    assert lodpipe.find_stages is find_stages
    with pytest.raises(AttributeError, match="module 'lodpipe' has no attribute 'dceimate'"):
        _ = lodpipe.dceimate


def heed_interrupts() -> None:
    """A shell that runs the tests in the background has SIGINT ignored, and children inherit that."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def test_compare_tells_how_different_two_models_are(main):
    lodpipe.save(lodpipe.decimate(lodpipe.load(Path("a.obj")), 12), Path("b.ply"))
    code, out, err = main("compare", "a.obj", "b.ply", "--views", "2", "--size", "64", "-o", "pairs")
    assert (code, err) == (0, "")
    assert out.splitlines()[0] == "A  a.obj: 32 triangles"
    assert [word for word in ("PSNR", "SSIM", "FLIP", "silhouette", "largest distance") if word not in out] == []
    assert len(list(Path("pairs").glob("view0[12]_*.png"))) == 6
    assert "7 pictures: pairs/all.png" in out
    code, out, _ = main("compare", "a.obj", "b.ply", "--views", "2", "--size", "64", "--protocol", "papers", "--json")
    data = json.loads(out)
    assert code == 0
    assert (data["a"]["triangles"], data["visual"]["views"], data["warnings"]) == (32, 2, [])
    assert 0 < data["visual"]["silhouette_iou"] <= 1


def test_compare_with_itself(main):
    code, out, _ = main("compare", "a.obj", "a.obj", "--views", "2", "--size", "32")
    assert code == 0
    assert "identical in every picture" in out
    assert "psnr: the pictures are equal" in out


@pytest.mark.parametrize(
    ("arguments", "code", "complaint"),
    [
        (("a.obj", "nothing.obj"), 1, "error: nothing.obj: "),
        (("a.obj", "a.obj", "-o", "a.obj/x", "--size", "16", "--views", "1"), 1, "error: a.obj/x: the folder"),
        (("a.obj", "a.obj", "--views", "0"), 2, "is not a number of at least 1"),
        (("a.obj", "a.obj", "--protocol", "film"), 2, "invalid choice"),
    ],
)
def test_compare_refuses(main, arguments, code, complaint):
    got, _, err = main("compare", *arguments)
    assert (got, complaint in err) == (code, True), err


def program(*arguments: str, **options) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "lodpipe", *arguments]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, preexec_fn=heed_interrupts, **pipes, **options)


def test_help_is_fast():
    """The best of three, as the machine may be busy."""
    seconds = []
    for _ in range(3):
        begin = time.monotonic()
        out, _ = program("--help").communicate()
        seconds.append(time.monotonic() - begin)
    assert "usage: lodpipe" in out
    assert min(seconds) < 0.5


@pytest.mark.parametrize(("number", "single"), [(signal.SIGINT, True), (signal.SIGTERM, False)])
def test_a_signal_in_the_middle_leaves_nothing_half_done(tmp_path, number, single):
    plugin_folder(tmp_path).rename(tmp_path / "plugins")
    chain = CHAIN | {"stages": ["thin", "export", {"fail": {"how": "hang", "only": "a"}}]}
    (tmp_path / "chain.yaml").write_text(json.dumps(chain))
    for name in ("a", "b")[: 1 if single else 2]:
        write_obj(tmp_path / "in" / f"{name}.obj")
    process = program("run", "in", "-c", "chain.yaml", "--workers", "1", cwd=tmp_path)
    assert process.stderr is not None
    while process.stderr.readline() != f"[1/{1 if single else 2}] a: fail\n":
        assert process.poll() is None
    process.send_signal(number)
    _, err = process.communicate(timeout=20)
    assert process.returncode == 130
    assert err == "interrupted\n"
    assert [path.relative_to(tmp_path).as_posix() for path in (tmp_path / "out").rglob("*")] == ["out/.lodpipe"]


def test_a_reader_that_stops_reading_is_no_error(tmp_path):
    command = f"{sys.executable} -m lodpipe schema | head -c 1"
    done = subprocess.run(["bash", "-o", "pipefail", "-c", command], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_skeleton_as_text_as_json_and_as_a_model(main):
    code, out, err = main("skeleton", "a.obj", "-o", "skeleton.glb")
    assert (code, err) == (0, "")
    assert out.startswith("component 1: ")
    assert [mesh.name for mesh in lodpipe.load("skeleton.glb").meshes][-1] == "segments"
    code, out, _ = main("skeleton", "a.obj", "--method", "dcg", "--json")
    data = json.loads(out)
    assert code == 0
    assert set(data) == {"method", "components", "seconds"}
    part = data["components"][0]
    assert {"nodes", "edges", "ends", "joints", "cycle_rank", "genus", "inside_share"} <= set(part)
    assert set(part["nodes"][0]) >= {"position", "radius", "type"}
    assert main("skeleton", "none.obj")[0] == 1
    assert main("skeleton", "a.obj", "--method", "x")[0] == 2
