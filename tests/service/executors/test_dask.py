"""The executor for a farm, on a real scheduler and two workers in processes of their own on this machine."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from chains import CHAIN, plugin_folder, write_obj
from lodpipe.core.errors import ConfigError
from lodpipe.service.chain import load_pipeline
from lodpipe.service.executors import Settings, find_executor
from lodpipe.service.job import Job, Outcome

distributed = pytest.importorskip("distributed")
# Dask's own threads and sockets end when they like
pytestmark = [pytest.mark.filterwarnings("ignore"), pytest.mark.slow]
REPO = Path(__file__).parents[3]


class Heard:
    """Listens to an executor."""

    def __init__(self) -> None:
        self.stages: list[tuple[str, str]] = []
        self.outcomes: dict[str, Outcome | None] = {}

    def progress(self, key: str, step: int, stage: str, share: float) -> None:
        self.stages.append((key, stage))

    def ended(self, key: str, outcome: Outcome | None) -> None:
        self.outcomes[key] = outcome


def until(condition: Callable[[], object], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it took too long"
        time.sleep(0.05)


@pytest.fixture
def cluster(tmp_path):
    """The address of a scheduler, and the processes of two workers with one thread each."""
    file = tmp_path / "scheduler.json"
    environment = os.environ | {"PYTHONPATH": str(REPO), "DASK_DISTRIBUTED__LOGGING__DISTRIBUTED": "error"}
    begin = [sys.executable, "-m", "dask"]
    common = ["--scheduler-file", str(file)]
    processes = [
        subprocess.Popen(
            [*begin, "scheduler", *common, "--host", "127.0.0.1", "--port", "0", "--no-dashboard"],
            env=environment,
            stderr=subprocess.DEVNULL,
        )
    ]
    try:
        until(file.is_file)
        for number in range(2):
            options = ["--no-nanny", "--nthreads", "1", "--no-dashboard", "--host", "127.0.0.1", "--name", str(number)]
            command = [*begin, "worker", *common, *options, "--local-directory", str(tmp_path / "dask")]
            processes.append(subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL))
        yield json.loads(file.read_text())["address"], processes[1:]
    finally:
        for process in processes:
            process.kill()
            process.wait()


def job(root: Path, name: str, *stages, cells: int = 4) -> Job:
    plugins = [plugin_folder(root)]
    config = load_pipeline(CHAIN | {"stages": [*stages, "thin", "export"]}, (), plugins).resolved()
    path = write_obj(root / "in" / f"{name}.obj", cells=cells)
    return Job(str(path), "", name, str(root / "out"), config, tuple(map(str, plugins)), threads=1)


def busy(workers: list[subprocess.Popen[bytes]]) -> list[int]:
    """The workers that have a job's process."""
    found = []
    for index, worker in enumerate(workers):
        for task in Path(f"/proc/{worker.pid}/task").iterdir():
            if (task / "children").read_text().strip():
                found.append(index)
                break
    return found


def test_jobs_run_beside_the_workers_and_a_killed_worker_loses_none(cluster, tmp_path):
    address, workers = cluster
    heard = Heard()
    executor = find_executor("dask")(Settings(scheduler=address), heard)
    try:
        until(lambda: executor.slots == 2)
        executor.start("a", job(tmp_path, "a"), "a")
        executor.start("bad", job(tmp_path, "bad", {"fail": {"how": "crash"}}), "bad")
        until(lambda: len(heard.outcomes) == 2)
        assert heard.outcomes["a"].outcome == "ok"
        assert "SIGSEGV" in heard.outcomes["bad"].message
        assert (tmp_path / "out" / "a" / "manifest.json").is_file()
        assert ("a", "publish") in heard.stages

        slow = job(tmp_path, "slow", {"fail": {"how": "slow", "seconds": 5.0}}, cells=5)
        executor.start("slow", slow, "slow")
        until(lambda: ("slow", "fail") in heard.stages)
        (victim,) = busy(workers)
        workers[victim].send_signal(signal.SIGKILL)
        until(lambda: "slow" in heard.outcomes)
        assert heard.outcomes["slow"].outcome == "ok"
        assert busy(workers[1 - victim : 2 - victim]) == []
        assert (tmp_path / "out" / "slow" / "manifest.json").is_file()
        assert list((tmp_path / "out" / ".lodpipe").glob("tmp-*")) == [] or sweep_is_enough(tmp_path / "out")
        until(lambda: executor.slots == 1)

        # one that is stopped leaves nothing running
        executor.start("long", job(tmp_path, "long", {"fail": {"how": "hang"}}), "long")
        until(lambda: ("long", "fail") in heard.stages)
        executor.stop("long")
        until(lambda: "long" in heard.outcomes)
        assert heard.outcomes["long"] is None
        until(lambda: busy(workers[1 - victim : 2 - victim]) == [])
        assert not (tmp_path / "out" / "long").exists()
    finally:
        executor.close()


def sweep_is_enough(out: Path) -> bool:
    """What the killed one has left is nobody's, so that the next start sweeps it away."""
    from lodpipe.service.publish import Output

    Output(out).sweep()
    return list((out / ".lodpipe").glob("tmp-*")) == []


def test_the_daemon_publishes_through_the_cluster(cluster, tmp_path):
    address, _ = cluster
    for number in range(4):
        write_obj(tmp_path / "drop" / f"a{number}.obj", cells=4 + number)
    plugin_folder(tmp_path)
    (tmp_path / "chain.yaml").write_text(json.dumps(CHAIN | {"watch": {"settle_s": 0.2}}))
    command = [sys.executable, "-m", "lodpipe", "watch", tmp_path / "drop", "-c", tmp_path / "chain.yaml"]
    options = ["-o", tmp_path / "out", "--once", "--executor", "dask", "--scheduler", address]
    done = subprocess.run(
        [*command, *options, "--plugins", tmp_path / "stages_for_tests"],
        cwd=REPO,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "out").glob("a*/manifest.json"))) == 4


def test_workers_of_another_version_get_no_jobs(cluster, monkeypatch):
    from lodpipe.service.executors import dask

    address, _ = cluster
    monkeypatch.setattr(dask, "versions", lambda: {"python": "3.11.1", "lodpipe": "99.0"})
    executor = find_executor("dask")(Settings(scheduler=address), Heard())
    try:
        until(lambda: len(executor.problems) == 2)
        assert executor.slots == 0
        assert all("instead of 99.0" in why for why in executor.problems.values())
    finally:
        executor.close()


def test_no_scheduler_is_told_in_one_line(monkeypatch):
    from lodpipe.service.executors import dask

    monkeypatch.setattr(dask, "CONNECT_SECONDS", 0.5)
    with pytest.raises(ConfigError, match=r"needs watch\.scheduler"):
        find_executor("dask")(Settings(), Heard())
    with pytest.raises(ConfigError, match=r"no scheduler answers at tcp://127\.0\.0\.1:9"):
        find_executor("dask")(Settings(scheduler="tcp://127.0.0.1:9"), Heard())
