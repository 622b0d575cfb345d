"""Jobs in processes of their own: crashes, hangs and orphans of one are nothing to the others."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from chains import CHAIN, plugin_folder, write_obj
from lodpipe.service import pool
from lodpipe.service.chain import load_pipeline
from lodpipe.service.job import Job
from lodpipe.service.pool import run_isolated


@pytest.fixture
def make(tmp_path):
    plugins = [plugin_folder(tmp_path)]

    def job(name: str, *stages, **config) -> Job:
        resolved = load_pipeline(CHAIN | {"stages": [*stages, "thin", "export"]} | config, (), plugins).resolved()
        path = write_obj(tmp_path / "in" / f"{name}.obj")
        return Job(str(path), "", name, str(tmp_path / "out"), resolved, tuple(map(str, plugins)), threads=1)

    return job


def nothing(*news) -> None:
    pass


def test_one_that_dies_does_not_stop_the_others(make, tmp_path):
    jobs = [make(how, {"fail": {"how": how}}) for how in ("crash", "killed", "exit", "bug", "error")]
    told = []
    outcomes = run_isolated([*jobs, make("fine")], 2, lambda job, index, name, share: told.append((job.name, name)))
    got = {outcome.place: outcome for outcome in outcomes}
    assert {place: outcome.outcome for place, outcome in got.items()} == {
        "crash": "failed",
        "killed": "failed",
        "exit": "failed",
        "bug": "bug",
        "error": "failed",
        "fine": "ok",
    }
    path = tmp_path / "in"
    assert got["crash"].message.startswith(
        f"{path}/crash.obj: fail: internal error: its process ended unexpectedly (SIGSEGV)"
    )
    assert got["killed"].message.startswith(
        f"{path}/killed.obj: fail: its process was killed from outside, most likely"
    )
    assert "(exit code 7)" in got["exit"].message
    assert list(dict.fromkeys(name for job, name in told if job == "fine")) == ["load", "thin", "export", "publish"]
    failed = tmp_path / "out" / ".failed"
    assert sorted(folder.name for folder in failed.iterdir()) == ["bug", "crash", "error", "exit", "killed"]
    assert "Segmentation fault" in (failed / "crash" / "lodpipe.log").read_text()
    assert json.loads((failed / "crash" / "error.json").read_text())["stage"] == "fail"
    assert (tmp_path / "out" / "fine" / "manifest.json").is_file()
    assert list((tmp_path / "out" / ".lodpipe").iterdir()) == []


def test_one_that_hangs_is_ended(make, tmp_path, monkeypatch):
    monkeypatch.setattr(pool, "GRACE_SECONDS", 0.0)
    begin = time.monotonic()
    (outcome,) = run_isolated([make("hang", {"fail": {"how": "hang"}}, limits={"minutes": 0.025})], 1, nothing)
    # a busy machine may not even have got to the stage that hangs
    cause = "took longer than the limit of 0.025 minutes; raise limits.minutes, or simplify the model first"
    assert re.fullmatch(rf"{re.escape(str(tmp_path))}/in/hang\.obj: \w+: {re.escape(cause)}", outcome.message)
    assert time.monotonic() - begin < 30
    assert outcome.outcome == "failed"
    assert list((tmp_path / "out" / ".lodpipe").iterdir()) == []


def test_one_that_is_ended_is_asked_first_and_says_where_it_was(make):
    worker = pool.Worker(1)
    worker.assign(make("hang", {"fail": {"how": "hang"}}))
    while worker.stage != "fail":
        worker.read(nothing) or time.sleep(0.01)
        assert not worker.ended
    worker.kill()
    assert worker.process.returncode == -signal.SIGTERM
    assert b"in fail\n" in worker._tail()
    worker.close()


def test_one_that_does_not_heed_that_is_killed_with_all_it_has_started(tmp_path, monkeypatch):
    monkeypatch.setattr(pool, "TERM_SECONDS", 0.3)
    worker = pool.Worker(1)
    worker.kill()
    worker.close()
    script = f"trap '' TERM; sleep 60 & echo $! > {tmp_path}/pid.new; mv {tmp_path}/pid.new {tmp_path}/pid; wait"
    worker.process = subprocess.Popen(["sh", "-c", script], start_new_session=True)
    while not (tmp_path / "pid").exists():
        time.sleep(0.01)
    worker.kill()
    assert worker.process.returncode == -signal.SIGKILL
    end = time.monotonic() + 20
    while pool.process_start(int((tmp_path / "pid").read_text())):  # not our child: nothing tells when it is gone
        assert time.monotonic() < end
        time.sleep(0.01)


def test_one_that_takes_more_memory_than_its_own_limit_let_it_is_ended(make, monkeypatch):
    monkeypatch.setattr(pool, "resident_gb", lambda pid: 99.0)
    (outcome,) = run_isolated([make("fat", {"fail": {"how": "hang"}})], 1, nothing)
    assert "needs more memory than the limit of 8 GB" in outcome.message
    assert outcome.nature == "again"


def test_an_orphan_is_ended_and_only_that(make):
    process = subprocess.Popen(["sleep", "60"], start_new_session=True)
    start = pool.process_start(process.pid)
    assert start > 0
    assert not pool.end_orphan(process.pid, start + 1)  # the id of another process by now
    assert not pool.end_orphan(0, 0)
    assert process.poll() is None
    assert pool.end_orphan(process.pid, start)
    assert process.wait(20) == -signal.SIGKILL
    assert pool.process_start(process.pid) == 0


def children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def test_when_the_caller_stops_the_workers_are_ended_and_leave_nothing(make, tmp_path):
    started = []

    def stop(job, index, name, share):
        started.append(name)
        if name == "fail":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(run_isolated([make("hang", {"fail": {"how": "hang"}})], 1, stop))
    assert "fail" in started
    assert children(os.getpid()) == []
    assert list((tmp_path / "out" / ".lodpipe").iterdir()) == []
    assert not (tmp_path / "out" / "hang").exists()


def test_a_worker_whose_parent_is_gone_ends_itself(make):
    job = make("hang", {"fail": {"how": "hang"}})
    code = (
        "import json, sys\n"
        "from lodpipe.service.job import Job\n"
        "from lodpipe.service.pool import run_isolated\n"
        "data = json.loads(sys.argv[1])\n"
        "def told(job, index, name, share):\n"
        "    print(name, flush=True)\n"
        "list(run_isolated([Job(**{**data, 'plugins': tuple(data['plugins'])})], 1, told))\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", code, json.dumps(vars(job))], stdout=subprocess.PIPE, text=True)
    try:
        assert parent.stdout is not None
        while parent.stdout.readline().strip() != "fail":
            assert parent.poll() is None
        (worker,) = children(parent.pid)
        parent.send_signal(signal.SIGKILL)
        parent.wait()
        end = time.monotonic() + 20
        while Path(f"/proc/{worker}").exists() and "Z" not in Path(f"/proc/{worker}/stat").read_text():
            assert time.monotonic() < end
            time.sleep(0.02)
    finally:
        parent.kill()
        parent.wait()
        if parent.stdout:
            parent.stdout.close()
