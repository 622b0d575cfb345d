"""One asset from file to folder, in this process: what is published, and what is left of a failure."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import pytest

from chains import CHAIN, plugin_folder, write_obj
from lodpipe.service import job as jobs
from lodpipe.service.chain import load_pipeline
from lodpipe.service.job import Job, process


@pytest.fixture
def make(tmp_path):
    """A job over a small square."""
    plugins = [plugin_folder(tmp_path)]

    def job(*stages, name: str = "a", path: Path | None = None, **config) -> Job:
        chain = CHAIN | ({"stages": list(stages)} if stages else {}) | config
        path = path or write_obj(tmp_path / "in" / "a.obj")
        resolved = load_pipeline(chain, (), plugins).resolved()
        return Job(str(path), "sub", name, str(tmp_path / "out"), resolved, tuple(map(str, plugins)))

    return job


def leftovers(tmp_path: Path) -> list[Path]:
    return list((tmp_path / "out" / ".lodpipe").iterdir())


def test_a_result_is_published(make, tmp_path):
    told = []
    outcome = process(
        make("thin", {"export": {"formats": ["obj", "glb"], "combined": True}}), lambda *news: told.append(news)
    )
    folder = tmp_path / "out" / "sub" / "a"
    assert (outcome.outcome, outcome.folder, outcome.exit_code) == ("ok", str(folder), 0)
    files = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    levels = {f"LOD{n}/a_LOD{n}.{kind}" for n in range(3) for kind in ("obj", "glb")}
    assert files == levels | {"a.glb", "report.json", "manifest.json", "lodpipe.log"}
    report = json.loads((folder / "report.json").read_text())
    assert [level["triangles"] for level in report["lods"]] == [32, 16, 8]
    assert report["lods"][1]["files"] == ["LOD1/a_LOD1.obj", "LOD1/a_LOD1.glb"]
    assert report["lods"][1]["bytes"] == sum((folder / file).stat().st_size for file in report["lods"][1]["files"])
    assert report["files"] == ["a.glb"]
    assert report["peak_memory_mb"] > 10
    assert report["versions"]["numpy"]
    assert [news[1] for news in told if news[2] == 0.0] == ["load", "thin", "export", "publish"]
    log = (folder / "lodpipe.log").read_text()
    assert "load: 32 triangles" in log
    assert "thin: done" in log
    assert leftovers(tmp_path) == []


def test_the_model_files_are_the_same_every_time_and_with_any_threads(make, tmp_path):
    def bytes_of_models() -> dict[str, bytes]:
        folder = tmp_path / "out" / "sub" / "a"
        return {path.name: path.read_bytes() for path in folder.rglob("*.glb")}

    job = make("thin", {"export": {"combined": True}})
    process(job)
    first = bytes_of_models()
    process(Job(**{**vars(job), "threads": 2}))
    assert bytes_of_models() == first
    assert len(first) == 4


def test_warnings_are_in_report_and_log(make, tmp_path):
    outcome = process(make({"thin": {"say": "beware"}}, "export"))
    assert outcome.outcome == "warnings"
    assert outcome.report["stages"][0]["warnings"] == ["beware"]
    assert "WARNING beware" in (Path(outcome.folder) / "lodpipe.log").read_text()


def test_over_budget_is_published_and_said(make):
    outcome = process(make(budgets={"levels": {"1": {"triangles": 3}}}))
    assert (outcome.outcome, outcome.exit_code) == ("over_budget", 1)
    assert (Path(outcome.folder) / "LOD1").is_dir()
    assert json.loads((Path(outcome.folder) / "manifest.json").read_text())["outcome"] == "over_budget"


@pytest.mark.parametrize(
    ("stage", "outcome", "line"),
    [
        ({"fail": {}}, "failed", "{path}: fail: meshes[0]: two and two is five; count again"),
        (
            {"fail": {"how": "bug"}},
            "bug",
            "{path}: fail: internal error: TypeError: a bug on purpose; this is a bug in lodpipe or a plug-in,"
            " please report it with the log in {failed}",
        ),
        (
            {"fail": {"how": "memory"}},
            "failed",
            "{path}: fail: needs more memory than the limit of 2 GB; raise limits.memory_gb, or split the model",
        ),
        (
            {"fail": {"how": "slow"}},
            "failed",
            "{path}: fail: took longer than the limit of 0.02 minutes;"
            " raise limits.minutes, or simplify the model first",
        ),
    ],
)
def test_a_failure_leaves_a_record_and_nothing_else(make, tmp_path, stage, outcome, line):
    job = make("thin", stage, "export", limits={"memory_gb": 2, "minutes": 0.02 if "slow" in str(stage) else 1})
    failed = tmp_path / "out" / ".failed" / "sub" / "a"
    got = process(job)
    assert got.outcome == outcome
    assert got.exit_code == {"failed": 1, "bug": 3}[outcome]
    assert got.message == line.format(path=job.path, failed=failed)
    assert got.folder == str(failed)
    assert not (tmp_path / "out" / "sub").exists()
    record = json.loads((failed / "error.json").read_text())
    assert record["stage"] == "fail"
    assert record["cause"] in got.message
    report = json.loads((failed / "report.json").read_text())
    assert (report["outcome"], report["error"]["stage"]) == ("failed", "fail")
    assert [part["name"] for part in report["stages"]] == ["thin", "fail"]
    log = (failed / "lodpipe.log").read_text()
    assert ("Traceback" in log) is (outcome == "bug")
    assert (failed / "a.obj").read_text() == Path(job.path).read_text()
    assert leftovers(tmp_path) == []


def test_what_cannot_be_read_fails_at_load(make, tmp_path):
    path = tmp_path / "in" / "broken.glb"
    path.parent.mkdir()
    path.write_bytes(b"glTF")
    got = process(make(path=path))
    assert got.outcome == "failed"
    assert got.message.startswith(f"{path}: ")
    assert json.loads((Path(got.folder) / "error.json").read_text())["stage"] == "load"


def test_a_success_removes_the_record_of_a_failure(make, tmp_path):
    process(make("fail"))
    assert (tmp_path / "out" / ".failed" / "sub" / "a" / "error.json").exists()
    process(make())
    assert not (tmp_path / "out" / ".failed").exists()


def test_a_failure_leaves_the_revision_before(make, tmp_path):
    process(make())
    before = (tmp_path / "out" / "sub" / "a" / "manifest.json").read_bytes()
    assert process(make("fail")).outcome == "failed"
    assert (tmp_path / "out" / "sub" / "a" / "manifest.json").read_bytes() == before


def test_an_interruption_leaves_nothing(make, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        process(make("thin", "export", {"fail": {"how": "interrupt"}}))
    assert leftovers(tmp_path) == []
    assert [path.name for path in (tmp_path / "out").iterdir()] == [".lodpipe"]


def test_files_of_others_stop_it_before_any_work(make, tmp_path, monkeypatch):
    place = tmp_path / "out" / "sub" / "a"
    place.mkdir(parents=True)
    (place / "notes.txt").write_text("mine")
    monkeypatch.setattr(jobs.io, "load", lambda *given: pytest.fail("it has begun to work"))
    got = process(make())
    assert "holds what lodpipe did not write (notes.txt)" in got.message
    assert (place / "notes.txt").exists()


def test_no_logger_is_left_behind(make):
    before = set(logging.Logger.manager.loggerDict)
    process(make())
    assert set(logging.Logger.manager.loggerDict) == before
    assert logging.getLogger("lodpipe").handlers == []
