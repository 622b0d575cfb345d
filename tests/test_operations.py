"""What surrounds the daemon: hooks, systemd, status for people and programs, and the promises in the documentation."""

from __future__ import annotations

import configparser
import json
import logging
import re
import socket
import sqlite3
import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, HTTPServer
from io import StringIO
from pathlib import Path

import pytest

from chains import CHAIN, write_obj
from daemon_kit import World
from lodpipe.config.watch import Hook, Watch
from lodpipe.core.errors import ConfigError, OutputError
from lodpipe.reporting.daemon_status import metrics_text, status_lines
from lodpipe.reporting.table import Style
from lodpipe.service import control, hooks
from lodpipe.service.executors import find_executor
from lodpipe.service.notify import notify, watchdog_seconds
from lodpipe.service.pool import process_start
from lodpipe.service.table import JobTable

REPO = Path(__file__).parents[1]
PROMISES = (REPO / "docs" / "operations.md").read_text(encoding="utf-8")


def test_every_promise_names_tests_that_there_are():
    rows = re.findall(r"^\| (\d+) \|.*\| ([^|]+) \|$", PROMISES, re.MULTILINE)
    assert [int(number) for number, _ in rows] == list(range(1, 19))
    written = "".join(path.read_text(encoding="utf-8") for path in (REPO / "tests").rglob("test_*.py"))
    for number, cell in rows:
        names = re.findall(r"`(test_\w+)`", cell)
        assert names, number
        assert [name for name in names if f"def {name}(" not in written] == [], number


def test_every_key_of_the_section_is_in_the_documentation():
    section = PROMISES.partition("## The watch section")[2].partition("## What it promises")[0]
    assert [name for name in Watch.model_fields if not re.search(rf"^  {name}:", section, re.MULTILINE)] == []


def test_the_unit_fits_the_program():
    unit = configparser.ConfigParser(interpolation=None, strict=False)
    unit.optionxform = str
    unit.read(REPO / "deploy" / "lodpipe-watch.service")
    service = unit["Service"]
    assert service["Type"] == "notify"
    assert float(service["TimeoutStopSec"]) > Watch().drain_s + 10
    assert service["KillMode"] == "mixed"
    from lodpipe.cli import _parser

    words = service["ExecStart"].split()[1:]
    assert _parser().parse_args(words).command.__name__ == "_watch"


def test_systemd_is_told(tmp_path, monkeypatch):
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    assert not notify("READY=1")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.bind(str(tmp_path / "s"))
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "s"))
        assert notify("READY=1", "STATUS=x")
        assert line.recv(100) == b"READY=1\nSTATUS=x"
    assert not notify("READY=1")  # nobody listens
    for usec, seconds in (("10000000", 5.0), ("", 0.0), ("x", 0.0)):
        monkeypatch.setenv("WATCHDOG_USEC", usec)
        assert watchdog_seconds() == seconds
    monkeypatch.setenv("WATCHDOG_USEC", "10000000")
    monkeypatch.setenv("WATCHDOG_PID", "1")
    assert watchdog_seconds() == 0.0


EVIL = "a'; touch pwned; $(touch pwned) `touch pwned`.obj"


def test_a_hook_gets_names_as_data_and_no_shell_sees_them(tmp_path):
    same = "json.load(sys.stdin)['input'] == os.environ['LODPIPE_INPUT']"
    program = f"import json, os, sys; print({same}, file=open('said', 'w'))"
    hook = Hook(command=(sys.executable, "-c", f"import os; os.chdir({str(tmp_path)!r}); {program}"))
    assert hooks.call(hook, {"event": "done", "asset": "a", "input": EVIL}) == ""
    assert (tmp_path / "said").read_text() == "True\n"
    assert [path.name for path in tmp_path.iterdir()] == ["said"]
    bad = Hook(command=(sys.executable, "-c", "import sys; sys.exit('no such channel')"))
    assert hooks.call(bad, {"event": "done"}) == f"{sys.executable} ended with 1 no such channel"
    slow = Hook(command=(sys.executable, "-c", "input(); import time; time.sleep(60)"), timeout_s=0.5)
    assert "took longer than 0.5 s" in hooks.call(slow, {"event": "done"})
    assert "No such file" in hooks.call(Hook(command=("/no/such/program",)), {"event": "done"})


def test_a_hook_over_its_time_is_ended_with_all_that_it_has_started(tmp_path):
    program = (
        "import os, subprocess, time;"
        f" child = subprocess.Popen(['sleep', '60']); print(child.pid, file=open({str(tmp_path / 'pid')!r}, 'w'));"
        " time.sleep(60)"
    )
    slow = Hook(command=(sys.executable, "-c", program), timeout_s=1.5)
    assert "took longer" in hooks.call(slow, {"event": "done"})
    end = time.monotonic() + 20
    while process_start(int((tmp_path / "pid").read_text())):
        assert time.monotonic() < end
        time.sleep(0.01)


def test_hooks_survive_a_full_disk(tmp_path, monkeypatch):
    world = World(tmp_path, on_done={"command": ["true"]})
    write_obj(world.drop / "a.obj")
    world.work()
    made, trouble = threading.Event(), [sqlite3.OperationalError("database or disk is full")] * 2
    try_call = JobTable.try_call

    def full(self, number):
        if trouble:
            raise trouble.pop()
        try_call(self, number)

    monkeypatch.setattr(JobTable, "try_call", full)
    monkeypatch.setattr(hooks, "call", lambda hook, said: made.set() or "")
    monkeypatch.setattr(hooks, "PAUSE_SECONDS", 0.01)
    said = StringIO()
    log = logging.Logger("test")
    log.addHandler(logging.StreamHandler(said))
    runner = hooks.Hooks(world.output.state, world.daemon.watch, log)
    assert made.wait(20)
    runner.close()
    assert "hooks wait: database or disk is full" in said.getvalue()
    assert world.table.calls() == []


def test_a_webhook_gets_json(monkeypatch):
    got = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self):
            got.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(500 if len(got) > 1 else 204)
            self.end_headers()

        def log_message(self, *args): ...

    server = HTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.05,))
    thread.start()
    try:
        hook = Hook(webhook=f"http://127.0.0.1:{server.server_address[1]}/")
        assert hooks.call(hook, {"event": "failed", "asset": EVIL}) == ""
        assert got == [{"event": "failed", "asset": EVIL}]
        assert "500" in hooks.call(hook, {"event": "failed"})
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
    with pytest.raises(ValueError, match="must begin with http"):
        Hook(webhook="file:///etc/passwd")


def test_hooks_are_called_after_a_crash_too_and_given_up_after_three_times(tmp_path, monkeypatch):
    world = World(tmp_path, on_done={"command": ["true"]})
    write_obj(world.drop / "a.obj")
    world.work()
    ((_, tried, data),) = world.table.calls()
    assert (tried, data["event"], data["asset"], data["revision"]) == (0, "done", "a", 1)
    made = []
    monkeypatch.setattr(hooks, "call", lambda hook, said: made.append(said["asset"]) or "it fails")
    monkeypatch.setattr(hooks, "PAUSE_SECONDS", 0.01)
    runner = hooks.Hooks(world.output.state, world.daemon.watch, logging.getLogger("test"))
    runner.look()
    end = threading.Event()
    for _ in range(2000):
        if len(made) == 3 and not world.table.calls():
            break
        end.wait(0.01)
    runner.close()
    assert made == ["a", "a", "a"]
    assert world.table.calls() == []


def test_status_for_people_and_for_prometheus(tmp_path):
    world = World(tmp_path, CHAIN | {"stages": [{"fail": {"only": "bad"}}, "thin", "export"]}, wait_s=1000)
    write_obj(world.drop / "a.obj")
    write_obj(world.drop / "bad.obj", cells=5)
    world.work()
    write_obj(world.drop / "b.obj")
    (world.drop / "c.gltf").write_text('{"asset": {"version": "2.0"}, "buffers": [{"uri": "c.bin", "byteLength": 3}]}')
    world.work()
    write_obj(world.drop / "run.obj", cells=6)
    world.settle()
    world.daemon.progress("run.obj", 1, "thin", 0.5)
    world.daemon.tick()
    world.table.set_facts(drop=str(world.drop), config="fast", config_problem="chain.yaml:1:1: bad\nand more")
    status = control.status(world.output.state)
    assert json.loads(json.dumps(status)) == status
    text = "\n".join(status_lines(status, Style(StringIO())))
    assert text.splitlines()[0] == f"not running; watches {world.drop} with fast"
    assert "1 running, 1 waiting, 1 done, 1 same, 1 failed" in text
    assert re.search(r"bad +failed .*meshes\[0\]: two and two is five; count again", text)
    assert re.search(r"run +running .*thin 50%", text)
    assert re.search(r"c +waiting .*waits for c\.bin", text)
    assert re.search(r"b +same .*the same content as a", text)
    assert "the old one stays: and more" in text
    metrics = metrics_text(status, 123)
    assert 'lodpipe_assets{state="failed"} 1' in metrics
    assert "lodpipe_results_total 1\n" in metrics
    for line in metrics.splitlines():
        assert line.startswith("# ") or re.fullmatch(r'[a-z_]+(\{state="[a-z]+"\})? [0-9.e+-]+', line), line


def test_a_folder_without_a_daemon_is_told(tmp_path):
    with pytest.raises(OutputError, match="has no job table"):
        control.status(tmp_path)


def test_a_table_of_another_version_is_not_touched(tmp_path):
    table = JobTable(tmp_path, create=True)
    table.set_facts(version=99)
    table.close()
    with pytest.raises(OutputError, match=r"another version of lodpipe \(table version 99\)"):
        JobTable(tmp_path, create=True)


def test_an_executor_that_there_is_not(tmp_path):
    with pytest.raises(ConfigError, match="there is no executor 'lokal'; did you mean 'local'"):
        find_executor("lokal")
