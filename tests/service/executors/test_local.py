"""Jobs on this machine: each in a fresh process, the next one waiting ready."""

from __future__ import annotations

import threading

import pytest

from chains import CHAIN, plugin_folder, write_obj
from lodpipe.service import executors
from lodpipe.service.chain import load_pipeline
from lodpipe.service.executors import Settings, find_executor
from lodpipe.service.job import Job


class Heard:
    """Listens, and lets a test wait for what it hears."""

    def __init__(self) -> None:
        self.stages, self.outcomes, self._more = [], {}, threading.Condition()

    def progress(self, key, step, stage, share):
        with self._more:
            self.stages.append((key, stage))
            self._more.notify_all()

    def ended(self, key, outcome):
        with self._more:
            self.outcomes[key] = outcome
            self._more.notify_all()

    def wait(self, condition):
        with self._more:
            assert self._more.wait_for(condition, timeout=60)


@pytest.fixture
def local():
    heard = Heard()
    made = find_executor("local")(Settings(workers=2, threads=1), heard)
    made.heard = heard
    yield made
    made.close()


@pytest.fixture
def make(tmp_path):
    plugins = [plugin_folder(tmp_path)]

    def job(name: str, *stages) -> Job:
        config = load_pipeline(CHAIN | {"stages": [*stages, "thin", "export"]}, (), plugins).resolved()
        path = write_obj(tmp_path / "in" / f"{name}.obj")
        return Job(str(path), "", name, str(tmp_path / "out"), config, tuple(map(str, plugins)), threads=1)

    return job


def test_a_process_that_waits_is_used_once_and_the_others_end(local, make, tmp_path):
    local.prepare()
    spares = [worker.process for worker in local._spares]
    assert len(spares) == 2
    local.start("a", make("a"), "a")
    assert local.process_of("a") == spares[0].pid
    local.heard.wait(lambda: "a" in local.heard.outcomes)
    assert local.heard.outcomes["a"].outcome == "ok"
    assert spares[0].wait(20) == 0
    assert local.process_of("a") == 0
    assert spares[1].poll() is None
    local.rest()
    assert spares[1].poll() is not None
    assert "lodpipe.stages.export" in local._modules  # what the job has loaded, the next process loads ahead


def test_what_is_stopped_ends_at_once_and_leaves_nothing(local, make, tmp_path):
    local.start("long", make("long", {"fail": {"how": "hang"}}), "x")
    local.heard.wait(lambda: ("long", "fail") in local.heard.stages)
    local.stop("long")
    local.heard.wait(lambda: "long" in local.heard.outcomes)
    assert local.heard.outcomes["long"] is None
    assert list((tmp_path / "out" / ".lodpipe").glob("tmp-*")) == []
    assert not (tmp_path / "out" / ".failed").exists()


def test_an_executor_of_a_package(monkeypatch):
    class Point:
        name = "farm"

        def load(self):
            return "a factory"

    monkeypatch.setattr(executors, "entry_points", lambda group: [Point()] if group == "lodpipe.executors" else [])
    assert find_executor("farm") == "a factory"
    monkeypatch.setattr(Point, "load", lambda self: 1 / 0)
    with pytest.raises(executors.ConfigError, match="the executor 'farm' cannot be loaded: ZeroDivisionError"):
        find_executor("farm")
