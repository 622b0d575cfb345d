"""`run`: many assets, one bad one among them; what is up to date is not done again."""

from __future__ import annotations

import functools
import json
from pathlib import Path

import pytest

import lodpipe
from chains import CHAIN, plugin_folder, write_obj
from lodpipe.core.errors import ConfigError
from lodpipe.service import batch
from lodpipe.service.batch import Silent


@pytest.fixture
def run(tmp_path, monkeypatch):
    """`lodpipe.run` in a folder of its own, with the stages for tests, everything in this process."""
    monkeypatch.chdir(tmp_path)
    plugins = [plugin_folder(tmp_path)]
    seen = []

    def in_process(jobs, workers, progress):
        seen.append((len(jobs), workers))
        for job in jobs:
            yield batch.process(job, functools.partial(progress, job))

    monkeypatch.setattr(batch, "run_isolated", in_process)

    def call(inputs, config=CHAIN, **options):
        return lodpipe.run(inputs, config, plugins=plugins, **options)

    call.isolated = seen
    return call


def outcomes(result) -> dict[str, str]:
    return {outcome.place: outcome.outcome for outcome in result.outcomes}


def test_one_bad_file_does_not_stop_the_others(run):
    write_obj(Path("in/a.obj"))
    write_obj(Path("in/sub/c.obj"))
    Path("in/b.obj").write_text("nonsense")
    result = run(["in", "nothing.glb"])
    assert outcomes(result) == {"": "failed", "a": "ok", "b": "failed", "sub/c": "ok"}
    assert (result.exit_code, result.ok) == (1, False)
    assert result.outcomes[0].message.startswith("nothing.glb: there is no such file")
    assert {str(p.parent) for p in Path("out").rglob("manifest.json")} == {"out/a", "out/sub/c"}
    assert Path("out/.failed/b/error.json").is_file()
    assert run.isolated == [(3, 1)]


def test_several_formats_of_one_name(run):
    write_obj(Path("in/a.obj"))
    Path("in/a.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    assert outcomes(run("in")) == {"a": "ok", "a_off": "ok"}
    assert Path("out/a_off/LOD0/a_off_LOD0.glb").is_file()


def test_a_single_asset_is_done_in_this_process_unless_something_asks_for_another(run):
    write_obj(Path("a.obj"))
    assert outcomes(run("a.obj")) == {"a": "ok"}
    assert run.isolated == []
    run("a.obj", workers=2, force=True)
    run("a.obj", settings={"limits.minutes": 1}, force=True)
    run("a.obj", settings=["limits.memory_gb=4"], force=True)
    assert len(run.isolated) == 3


def test_what_is_up_to_date_is_not_done_again(run):
    write_obj(Path("a.obj"))
    first = run("a.obj")
    stamp = Path("out/a/manifest.json").stat().st_mtime_ns
    again = run("a.obj")
    assert outcomes(again) == {"a": "unchanged"}
    assert again.exit_code == 0
    assert again.outcomes[0].report["lods"] == first.outcomes[0].report["lods"]
    assert Path("out/a/manifest.json").stat().st_mtime_ns == stamp
    assert outcomes(run("a.obj", force=True)) == {"a": "ok"}
    assert outcomes(run("a.obj", settings={"lods": [{"ratio": 0.3}]})) == {"a": "ok"}
    write_obj(Path("a.obj"), cells=5)
    assert outcomes(run("a.obj", settings={"lods": [{"ratio": 0.3}]})) == {"a": "ok"}


def test_over_budget_stays_over_budget(run):
    write_obj(Path("a.obj"))
    over = {"budgets.levels.1.triangles": 1}
    assert outcomes(run("a.obj", settings=over)) == {"a": "over_budget"}
    again = run("a.obj", settings=over)
    assert (outcomes(again), again.exit_code) == ({"a": "unchanged"}, 1)


def test_a_bug_is_the_worst(run):
    write_obj(Path("in/a.obj"))
    write_obj(Path("in/b.obj"))
    write_obj(Path("in/c.obj"))
    result = run("in", CHAIN | {"stages": [{"fail": {"how": "bug", "only": "b"}}, {"fail": {"only": "c"}}, "thin"]})
    assert outcomes(result) == {"a": "ok", "b": "bug", "c": "failed"}
    assert result.exit_code == 3


def test_the_listener_hears_of_everything(run):
    heard = []

    class Listener(Silent):
        def begin(self, total, steps):
            heard.append(("begin", total, steps))

        def progress(self, place, index, name, share):
            heard.append((place, name))

        def finished(self, outcome):
            heard.append(("finished", outcome.place))

    write_obj(Path("in/a.obj"))
    write_obj(Path("in/b.obj"))
    run("in", listener=Listener())
    assert heard[0] == ("begin", 2, 2)
    assert [entry for entry in heard if entry[0] == "finished"] == [("finished", "a"), ("finished", "b")]
    assert ("b", "thin") in heard


def test_a_configuration_that_is_wrong_stops_all_before_anything_is_written(run):
    write_obj(Path("a.obj"))
    with pytest.raises(ConfigError, match=r"config: stages\[0\]: unknown stage 'thing'; did you mean 'thin'"):
        run("a.obj", {"stages": ["thing"]})
    assert not Path("out").exists()


def test_nothing_found_writes_nothing(run):
    assert run("none.glb").exit_code == 1
    assert not Path("out").exists()


def test_plugins_beside_the_configuration_are_found(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("chains").mkdir()
    plugin_folder(tmp_path).rename("chains/plugins")
    Path("chains/chain.yaml").write_text(json.dumps(CHAIN))
    write_obj(Path("a.obj"))
    assert outcomes(lodpipe.run("a.obj", "chains/chain.yaml")) == {"a": "ok"}


def test_workers_share_the_cores(run, monkeypatch):
    monkeypatch.setattr(batch.os, "cpu_count", lambda: 8)
    write_obj(Path("in/a.obj"))
    recipe = batch.Recipe.loaded(batch.load_chain(CHAIN, (), [Path("stages_for_tests")]))
    found, _ = batch.find_assets(["in"], Path("out"))
    assert batch.job_of(found[0], Path("out"), recipe, 2).threads == 4
    assert batch.job_of(found[0], Path("out"), recipe, 1).threads == 0
    assert batch.job_of(found[0], Path("out"), recipe, 100).threads == 1
