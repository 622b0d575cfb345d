"""Output folders: whole or not at all, nobody's files lost, crashes swept up."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path, PurePosixPath

import pytest

from lodpipe.core.errors import OutputError
from lodpipe.service import publish
from lodpipe.service.publish import Output

PLACE = PurePosixPath("farm/duck")


def built(output: Output, folder: Path, text: str) -> Path:
    result = folder / "built"
    result.mkdir()
    (result / "a.txt").write_text(text)
    (result / "manifest.json").write_text(json.dumps({"files": [{"path": "a.txt"}]}))
    return result


def publish_text(output: Output, text: str) -> Path:
    with output.workspace() as folder:
        return output.publish(built(output, folder, text), PLACE)


def state(output: Output) -> list[str]:
    return [path.name for path in output.state.iterdir()]


@pytest.mark.parametrize("exchange", [True, False])
def test_a_result_replaces_the_one_before(tmp_path, monkeypatch, exchange):
    if not exchange:
        monkeypatch.setattr(publish, "_exchange", lambda a, b: False)
    output = Output(tmp_path / "out")
    for text in ("one", "two"):
        folder = publish_text(output, text)
        assert folder == tmp_path / "out" / "farm" / "duck"
        assert (folder / "a.txt").read_text() == text
    assert state(output) == []


def test_the_exchange_is_one_step_where_the_system_has_it(tmp_path):
    a, b = tmp_path / "a", tmp_path / "b"
    a.mkdir()
    b.mkdir()
    (a / "x").touch()
    if sys.platform.startswith("linux"):
        assert publish._exchange(a, b)
        assert (b / "x").exists()
    assert not publish._exchange(a, tmp_path / "none")


def test_all_of_a_result_is_on_the_disk_before_its_name_is(tmp_path, monkeypatch):
    done = []
    monkeypatch.setattr(publish, "_sync", lambda path: done.append(path.name))
    put = Output._put
    monkeypatch.setattr(Output, "_put", lambda self, *rest: done.append("put") or put(self, *rest))
    publish_text(Output(tmp_path / "out"), "one")
    assert done == ["a.txt", "manifest.json", "built", "put", "farm"]


def test_a_failure_between_leaves_the_old_revision(tmp_path, monkeypatch):
    output = Output(tmp_path / "out")
    folder = publish_text(output, "one")

    def broken(a: Path, b: Path) -> bool:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(publish, "_exchange", broken)
    with pytest.raises(OutputError, match=r"cannot be written \(No space left on device\)"):
        publish_text(output, "two")
    assert (folder / "a.txt").read_text() == "one"
    assert state(output) == []


@pytest.mark.parametrize("name", ["notes.txt", "deep/er/notes.txt", "manifest.json.bak"])
def test_files_of_others_are_never_removed(tmp_path, name):
    output = Output(tmp_path / "out")
    folder = publish_text(output, "one")
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text("mine")
    with pytest.raises(OutputError, match=rf"holds what lodpipe did not write \({name}\); move it away"):
        publish_text(output, "two")
    assert (folder / name).read_text() == "mine"
    assert (folder / "a.txt").read_text() == "one"


def test_a_file_in_the_way_is_told(tmp_path):
    output = Output(tmp_path / "out")
    (tmp_path / "out" / "farm").mkdir()
    (tmp_path / "out" / "farm" / "duck").write_text("mine")
    with pytest.raises(OutputError, match="a file of that name"):
        publish_text(output, "one")


def test_an_output_that_cannot_be_made_is_told(tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(OutputError, match=r"out: cannot be written \(.*\); see to space and rights"):
        Output(tmp_path / "out")


def test_a_workspace_is_gone_afterwards_whatever_happens(tmp_path):
    output = Output(tmp_path / "out")
    with pytest.raises(KeyboardInterrupt), output.workspace() as folder:
        (folder / "big").write_text("x")
        raise KeyboardInterrupt
    assert state(output) == []


def test_a_workspace_that_another_process_sweeps_at_once_is_made_anew(tmp_path, monkeypatch):
    output = Output(tmp_path / "out")
    made = []
    make = publish.tempfile.mkdtemp

    def swept(**options):
        made.append(make(**options))
        if len(made) == 1:
            Output(tmp_path / "out").sweep()
        return made[-1]

    monkeypatch.setattr(publish.tempfile, "mkdtemp", swept)
    with output.workspace() as folder:
        assert folder.is_dir()
    assert len(made) == 2


def test_without_locks_a_workspace_works_and_nothing_is_swept(tmp_path, monkeypatch):
    def no_locks(handle, flags):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(publish.fcntl, "flock", no_locks)
    output = Output(tmp_path / "out")
    with output.workspace() as folder:
        output.sweep()
        assert folder.is_dir()
    assert state(output) == []


HOLD = """
import sys, time
from pathlib import Path
from lodpipe.service.publish import Output
with Output(Path(sys.argv[1])).workspace() as folder:
    (folder / "half").write_text("x")
    print("ready", flush=True)
    time.sleep(60)
"""


def test_what_a_killed_process_left_is_swept_and_what_a_living_one_has_is_not(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        output = Output(tmp_path)
        output.sweep()
        assert len(state(output)) == 1
        process.kill()
        process.wait()
        output.sweep()
        assert state(output) == []
    finally:
        process.kill()
        process.wait()
        if process.stdout:
            process.stdout.close()


def test_a_revision_that_was_being_replaced_is_put_back(tmp_path):
    output = Output(tmp_path)
    aside = output.state / "old-x"
    (aside / "revision").mkdir(parents=True)
    (aside / "revision" / "a.txt").write_text("one")
    (aside / "place.txt").write_text("duck")
    output.sweep()
    assert (tmp_path / "duck" / "a.txt").read_text() == "one"
    assert state(output) == []


def test_a_failure_has_its_record_until_a_success(tmp_path):
    output = Output(tmp_path / "out")
    source, log = tmp_path / "duck.glb", tmp_path / "lodpipe.log"
    source.write_text("model")
    log.write_text("log")
    for cause in ("one", "two"):
        folder = output.fail(PLACE, {"cause": cause}, [log, tmp_path / "none"], source)
        assert json.loads((folder / "error.json").read_text()) == {"cause": cause}
    assert folder == tmp_path / "out" / ".failed" / "farm" / "duck"
    assert (folder / "lodpipe.log").read_text() == "log"
    assert (folder / "duck.glb").read_text() == "model"
    assert (folder / "duck.glb").is_symlink()
    other = output.fail(PurePosixPath("farm/cow"), {}, [], source)
    publish_text(output, "fine")
    assert not folder.exists()
    assert other.exists()
    output.forget_failure(PurePosixPath("farm/cow"))
    assert not (tmp_path / "out" / ".failed").exists()
    assert source.read_text() == "model"
