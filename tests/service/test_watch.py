"""The daemon as a process: events wake it, signals and a changed configuration reach it, one for each folder."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import signal
import socket
import sys
import threading
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from chains import CHAIN, plugin_folder, write_obj
from daemon_kit import until
from lodpipe.core.errors import ConfigError, OutputError
from lodpipe.service import control
from lodpipe.service.lock import NoLocks, is_running, take_lock
from lodpipe.service.logs import daemon_log
from lodpipe.service.recipe import read_recipe
from lodpipe.service.watch import Request, check_apart, watch

REPO = Path(__file__).parents[2]


def get(url: str, **headers: str) -> tuple[int, bytes, dict[str, str]]:
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=20) as answer:
            return answer.status, answer.read(), dict(answer.headers)
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read(), dict(error.headers)


def test_a_day_of_its_life(running, tmp_path):
    """Dropped, published, shown; paused and resumed; a second daemon; a bad configuration; drained."""
    notified = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    notified.bind(str(tmp_path / "notify"))
    notified.settimeout(60)
    daemon = running({"watch": {"port": 0, "rescan_s": 3600}}, NOTIFY_SOCKET=str(tmp_path / "notify"))
    assert notified.recv(4096).startswith(b"READY=1\nSTATUS=watching ")
    assert is_running(daemon.state)

    write_obj(daemon.drop / "deep" / "a.obj")  # no scan is due for an hour: an event must wake it
    until(lambda: (daemon.out / "deep" / "a" / "manifest.json").is_file())
    until(lambda: daemon.states() == {"deep/a.obj": "done"})

    with pytest.raises(OutputError, match=rf"another daemon works on it \(process {daemon.process.pid}\)"):
        take_lock(daemon.state)

    page = control.status(daemon.state)["address"]
    assert page.startswith("http://127.0.0.1:")
    code, body, headers = get(page)
    assert (code, b"<title>lodpipe</title>" in body) == (200, True)
    assert headers["X-Frame-Options"] == "DENY"
    assert get(f"{page}healthz")[:2] == (200, b"ok\n")
    assert 'lodpipe_assets{state="done"} 1' in get(f"{page}metrics")[1].decode()
    (shown,) = json.loads(get(f"{page}api/status")[1])["assets"]
    assert shown["report"] == "deep/a/report.json"
    assert json.loads(get(f"{page}files/deep/a/report.json")[1])["asset"] == "a"
    for path in ("../chain.yaml", "%2e%2e/chain.yaml", ".lodpipe/jobs.sqlite", "deep/a", "deep/a/none", "%00"):
        assert get(f"{page}files/{path}")[0] == 404, path
    (daemon.out / "deep" / "a" / "out.json").symlink_to(daemon.config)
    assert get(f"{page}files/deep/a/out.json")[0] == 404
    (daemon.out / "deep" / "a" / "out.json").unlink()
    assert get(page, Host="evil.example")[0] == 403

    control.pause(daemon.state)
    write_obj(daemon.drop / "b.obj", cells=5)
    until(lambda: daemon.states().get("b.obj") == "queued")
    control.resume(daemon.state)
    until(lambda: daemon.states().get("b.obj") == "done")

    daemon.write_config({"stages": ["thinn"]})  # seen without a signal
    until(lambda: daemon.says("the new configuration is not valid"))
    status = control.status(daemon.state)
    assert "unknown stage 'thinn'; did you mean 'thin'?" in status["config_problem"]
    daemon.write_config({"lods": [{"ratio": 0.3}]})
    daemon.process.send_signal(signal.SIGHUP)
    until(lambda: set(daemon.states().values()) == {"done"} and control.status(daemon.state)["totals"]["done"] == 4)
    assert control.status(daemon.state)["config_problem"] == ""

    daemon.write_config({"stages": [{"fail": {"how": "slow", "seconds": 1.0, "only": "c"}}, "thin", "export"]})
    until(lambda: daemon.log.read_text().count("the configuration was read again") == 2)
    until(lambda: set(daemon.states().values()) == {"done"} and control.status(daemon.state)["totals"]["done"] == 6)
    write_obj(daemon.drop / "c.obj", cells=6)
    until(lambda: daemon.says("c.obj: start"))
    daemon.process.send_signal(signal.SIGTERM)
    assert daemon.process.wait(60) == 0
    assert daemon.states()["c.obj"] == "done"
    assert not is_running(daemon.state)
    assert list(daemon.state.glob("tmp-*")) == []
    lines = [json.loads(line) for line in daemon.log.read_text().splitlines()]
    assert all({"time", "level", "message"} <= line.keys() for line in lines)
    assert any(line.get("asset") == "c" and line["job"] and line["state"] == "done" for line in lines)
    notified.close()


def test_a_second_signal_ends_it_now_and_what_ran_is_done_next_time(running):
    daemon = running({"stages": [{"fail": {"how": "hang", "only": "a"}}, "thin", "export"]})
    write_obj(daemon.drop / "a.obj")
    until(lambda: control.status(daemon.state)["counts"]["running"] == 1 if daemon.says("a.obj: start") else False)
    until(lambda: control.status(daemon.state)["assets"][0].get("stage") == "fail")
    daemon.process.send_signal(signal.SIGTERM)
    until(lambda: daemon.says("stopping"))
    daemon.process.send_signal(signal.SIGTERM)
    assert daemon.process.wait(30) == 0
    assert daemon.states() == {"a.obj": "queued"}
    assert control.status(daemon.state)["assets"][0]["attempts"] == 0
    assert not (daemon.out / "a").exists()
    daemon.write_config({})
    daemon.start()
    until(lambda: daemon.states() == {"a.obj": "done"})


def test_once_does_what_is_there_and_tells_by_its_exit_code(tmp_path, capsys):
    import sys as system

    write_obj(tmp_path / "drop" / "a.obj")
    (tmp_path / "drop" / "bad.obj").write_text("nonsense")
    plugins = (str(plugin_folder(tmp_path)),)
    (tmp_path / "chain.yaml").write_text(json.dumps(CHAIN | {"watch": {"settle_s": 0.1}}))
    config = str(tmp_path / "chain.yaml")
    request = Request(tmp_path / "drop", tmp_path / "out", config, plugins=plugins, once=True)
    assert watch(request, daemon_log(system.stderr, text=False)) == 1
    assert "nothing is left to do: 1 done, 1 failed" in capsys.readouterr().err
    page = (tmp_path / "out" / "index.html").read_text()
    assert 'href=".failed/bad/error.json"' in page
    assert 'href="a/' in page
    (tmp_path / "drop" / "bad.obj").unlink()
    assert watch(request, daemon_log(system.stderr, text=True)) == 0
    assert ".failed" not in (tmp_path / "out" / "index.html").read_text()


def test_a_bug_in_one_look_does_not_end_it(tmp_path, monkeypatch, capsys):
    from lodpipe.service import watch as module
    from lodpipe.service.daemon import Daemon

    monkeypatch.setattr(module, "DISK_SECONDS", 0.0)
    write_obj(tmp_path / "drop" / "a.obj")
    (tmp_path / "chain.yaml").write_text(json.dumps(CHAIN | {"watch": {"settle_s": 0.1}}))
    plugins = (str(plugin_folder(tmp_path)),)
    request = Request(tmp_path / "drop", tmp_path / "out", str(tmp_path / "chain.yaml"), plugins=plugins, once=True)
    finish, bugs = Daemon._finish, [ZeroDivisionError("a bug"), OSError(5, "Input/output error")]

    def broken(self, key, outcome):
        if bugs:
            raise bugs.pop(0)
        finish(self, key, outcome)

    monkeypatch.setattr(Daemon, "_finish", broken)
    monkeypatch.setattr(module, "MISHAPS", 1)
    assert watch(request, daemon_log(sys.stderr, text=False)) == 0
    said = capsys.readouterr().err
    assert "ZeroDivisionError: a bug; going on" in said
    assert "nothing is left to do: 1 done" in said


def test_folders_that_would_feed_on_themselves_are_refused(tmp_path):
    (tmp_path / "out" / "drop").mkdir(parents=True)
    for drop in (tmp_path / "out" / "drop", tmp_path / "out"):
        with pytest.raises(OutputError, match="results would be taken as inputs"):
            check_apart(drop, tmp_path / "out")
    check_apart(tmp_path, tmp_path / "out")  # that one is left out of the listing


def test_two_daemons_with_tables_of_their_own_do_not_share_an_output(tmp_path):
    (tmp_path / "drop").mkdir()
    (tmp_path / "out" / ".lodpipe").mkdir(parents=True)
    request = Request(tmp_path / "drop", tmp_path / "out", "fast", state=tmp_path / "state", once=True)
    held = take_lock(tmp_path / "out" / ".lodpipe")
    with pytest.raises(OutputError, match=rf"out/.lodpipe: another daemon works on it \(process {os.getpid()}\)"):
        watch(request, daemon_log(sys.stderr, text=False))
    assert not is_running(tmp_path / "state")
    os.close(held)
    assert watch(request, daemon_log(sys.stderr, text=False)) == 0


def test_a_status_that_looks_at_the_lock_does_not_keep_a_daemon_from_starting(tmp_path):
    handle = os.open(tmp_path / "daemon.lock", os.O_RDWR | os.O_CREAT)
    fcntl.flock(handle, fcntl.LOCK_SH)
    threading.Timer(0.06, os.close, [handle]).start()
    held = take_lock(tmp_path)
    with pytest.raises(OutputError, match="another daemon works on it"):
        take_lock(tmp_path)
    os.close(held)


def test_a_file_system_without_locks_is_told_apart_from_another_daemon(tmp_path, monkeypatch):
    def none(handle, how):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr("lodpipe.service.lock.fcntl.flock", none)
    with pytest.raises(NoLocks, match="cannot be locked"):
        take_lock(tmp_path)


def test_a_folder_that_has_never_been_there_is_a_mistake(tmp_path):
    with pytest.raises(OutputError, match="there is no such folder"):
        watch(Request(tmp_path / "none", tmp_path / "out", "fast"), daemon_log(sys.stderr, text=False))


def test_a_configuration_is_read_in_a_process_of_its_own(tmp_path):
    (tmp_path / "bad.yaml").write_text("stages: [exprt]\nlods: 3\n")
    with pytest.raises(ConfigError) as caught:
        read_recipe(str(tmp_path / "bad.yaml"))
    first, second = str(caught.value).splitlines()
    assert first.endswith("bad.yaml:1:10: stages[0]: unknown stage 'exprt'; did you mean 'export'?")
    assert "bad.yaml:2:7: lods: must be a list" in second
    plugins = plugin_folder(tmp_path)
    (tmp_path / "plug.yaml").write_text("stages: [thin]\n")
    recipe = read_recipe(str(tmp_path / "plug.yaml"), ["seed=3"], [plugins])
    assert recipe.config["seed"] == 3
    assert recipe.stages[0]["name"] == "thin"
    assert {Path(name).name for name in recipe.files} == {"plug.yaml", "stages_for_tests.py"}
    (plugins / "dies.py").write_text("import os\nos._exit(5)\n")
    with pytest.raises(ConfigError, match="cannot be loaded"):
        read_recipe(str(tmp_path / "plug.yaml"), [], [plugins])
