"""The whole daemon against what is worst: every poison at once, all bad files at once, a full disk."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

from chains import CHAIN, write_obj
from daemon_kit import World, until
from lodpipe.service import control

BAD = Path(__file__).parents[3] / "shared" / "assets" / "bad"
WAYS = ("crash", "killed", "exit", "bug", "memory", "hang", "error")


@pytest.mark.slow
def test_every_kind_of_poison_at_once(running):
    """Segmentation fault, kill, exit, exception, huge allocation, endless loop, wrong input: and a good one between."""
    stages = [{"fail": {"how": how, "only": how}} for how in WAYS]
    # a hanging job is ended after its minutes and a grace of some seconds
    limits = {"minutes": 0.1, "memory_gb": 1}
    daemon = running({"stages": [*stages, "thin", "export"], "limits": limits, "watch": {"workers": 2}})
    for number, name in enumerate((*WAYS, "good", "better")):
        write_obj(daemon.drop / f"{name}.obj", cells=3 + number)
    done = {"good.obj": "done", "better.obj": "done"}
    until(lambda: daemon.says("seen"))
    until(lambda: daemon.states() == {f"{how}.obj": "failed" for how in WAYS} | done, 240)
    causes = {how: json.loads((daemon.out / ".failed" / how / "error.json").read_text())["cause"] for how in WAYS}
    assert "SIGSEGV" in causes["crash"]
    assert "killed from outside" in causes["killed"]
    assert "exit code 7" in causes["exit"]
    assert "TypeError: a bug on purpose" in causes["bug"]
    assert "more memory than the limit of 1 GB" in causes["memory"]
    assert "longer than the limit of 0.1 minutes" in causes["hang"]
    assert causes["error"] == "two and two is five"
    starts = [line for line in daemon.log.read_text().splitlines() if ": start (" in line]
    count = {how: sum(f'"{how}.obj: start' in line for line in starts) for how in (*WAYS, "good")}
    assert count == dict.fromkeys(WAYS, 2) | {"error": 1, "good": 1}
    assert all((daemon.drop / f"{how}.obj").is_file() for how in WAYS)


@pytest.mark.slow
@pytest.mark.skipif(not BAD.is_dir(), reason="the shared assets are not there")
def test_all_bad_files_at_once(running):
    """Each is quarantined with its reason or processed with a warning; the good ones are published; nothing outside
    is read."""
    daemon = running({"watch": {"workers": 2, "wait_s": 1}})
    passwd = Path("/etc/passwd").read_bytes()
    for path in sorted(BAD.rglob("*")):
        if path.is_file() and path.suffix != ".tsv":
            target = daemon.drop / path.relative_to(BAD)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
    for number in range(3):
        write_obj(daemon.drop / f"good{number}.obj", cells=10 + number)
    (daemon.drop / "link.obj").symlink_to("/etc/passwd")
    until(lambda: daemon.says("seen"))
    until(lambda: not set(daemon.states().values()) - {"done", "same", "failed"}, 600)
    status = control.status(daemon.state, every=True)
    assert len(status["assets"]) > 60
    for asset in status["assets"]:
        if asset["state"] == "failed":
            assert asset["message"]
            assert asset["outcome"] == "failed", asset  # no bug, no crash
            assert (daemon.out / asset["folder"] / "error.json").is_file()
    states = daemon.states()
    assert all(states[f"good{number}.obj"] == "done" for number in range(3))
    assert states["m_traversal_buffer.gltf"] == states["link.obj"] == states["m_pixel_bomb/quad.obj"] == "failed"
    for path in daemon.out.rglob("*"):
        if path.is_file() and not path.is_symlink():
            assert passwd[:40] not in path.read_bytes(), path


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount a file system to fill")
def test_a_full_disk_is_waited_for(running, tmp_path):
    """The output's file system is full: jobs are put off, burn no attempt, and go on when there is space."""
    out = tmp_path / "out"
    out.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", out], check=False).returncode:
        pytest.skip("a file system cannot be mounted here")
    try:
        daemon = running({})
        until(lambda: daemon.says("watching"))
        ballast = out / "ballast"
        with ballast.open("wb", buffering=0) as file, pytest.raises(OSError, match="No space"):
            while True:
                file.write(bytes(1024))
        for number in range(3):
            write_obj(daemon.drop / f"a{number}.obj", cells=20 + number)
        until(lambda: daemon.says("No space left") or daemon.says("disk is full"), 120)
        end = time.monotonic() + 5
        until(lambda: time.monotonic() > end)
        assert daemon.process.poll() is None
        assert not list(out.glob("a*"))
        ballast.unlink()
        until(lambda: daemon.says("a2.obj: ok") and daemon.states() == {f"a{n}.obj": "done" for n in range(3)}, 200)
        assert not (out / ".failed").exists()
        daemon.process.send_signal(signal.SIGTERM)
        assert daemon.process.wait(60) == 0
    finally:
        for one in [daemon]:
            one.end()
        subprocess.run(["umount", out], check=False)


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount a file system to fill")
def test_a_full_disk_under_the_job_table_is_waited_for(running, tmp_path):
    """Inputs and results have room, the table has none: nothing is lost, done twice or forgotten, hooks included."""
    state, told = tmp_path / "state", tmp_path / "told"
    state.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=12m", "tmpfs", state], check=False).returncode:
        pytest.skip("a file system cannot be mounted here")
    hook = {"command": ["sh", "-c", f"echo $LODPIPE_ASSET >> {told}"]}
    daemon = running({"watch": {"on_done": hook}}, "--state", str(state))
    daemon.state = state
    try:
        until(lambda: daemon.says("watching"))
        write_obj(daemon.drop / "first.obj")
        until(lambda: daemon.says("first.obj: ok"))
        with (state / "ballast").open("wb", buffering=0) as file, pytest.raises(OSError, match="No space"):
            while True:
                file.write(bytes(1024))
        for number in range(30):
            write_obj(daemon.drop / f"a{number}.obj", cells=5 + number)
        until(lambda: daemon.says("disk is full") or daemon.says("disk I/O error"), 120)
        end = time.monotonic() + 5
        until(lambda: time.monotonic() > end)
        assert daemon.process.poll() is None
        assert daemon.log.read_text().count("going on") < 10  # the log does not fill the next disk
        (state / "ballast").unlink()
        names = ["first", *(f"a{number}" for number in range(30))]
        until(lambda: daemon.states() == {f"{name}.obj": "done" for name in names}, 400)
        until(lambda: set(told.read_text().split()) == set(names), 60)  # once more where that could not be noted
        daemon.process.send_signal(signal.SIGTERM)
        assert daemon.process.wait(60) == 0
    finally:
        daemon.end()
        subprocess.run(["umount", state], check=False)


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount a file system")
def test_folders_that_may_only_be_read(running, tmp_path):
    """DROP may only be read, always; OUT for a while, as a share that met an error: it goes on by itself after that."""
    out, inside, state = tmp_path / "out", tmp_path / "inside", tmp_path / "state"
    for folder in (out, inside, tmp_path / "drop"):
        folder.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "tmpfs", out], check=False).returncode:
        pytest.skip("a file system cannot be mounted here")
    subprocess.run(["mount", "--bind", inside, tmp_path / "drop"], check=True)
    subprocess.run(["mount", "-o", "remount,bind,ro", tmp_path / "drop"], check=True)
    daemon = running({}, "--state", str(state))
    daemon.state = state
    try:
        until(lambda: daemon.says("watching"))
        write_obj(inside / "a.obj")
        until(lambda: daemon.says("a.obj: ok"))
        subprocess.run(["mount", "-o", "remount,ro", out], check=True)
        write_obj(inside / "b.obj", cells=6)
        until(lambda: daemon.says("b.obj: put off for 4 s") or daemon.says("b.obj: put off for 5 s"), 60)
        assert "Read-only file system" in control.status(state)["assets"][0]["message"]
        subprocess.run(["mount", "-o", "remount,rw", out], check=True)
        until(lambda: daemon.states() == {"a.obj": "done", "b.obj": "done"}, 200)
        assert control.status(state)["assets"][0]["attempts"] == 0
        assert not (out / ".failed").exists()
        assert not (inside / ".lodpipe-root").exists()
    finally:
        daemon.end()
        subprocess.run(["umount", out], check=False)
        subprocess.run(["umount", tmp_path / "drop"], check=False)


def test_a_result_that_is_too_large_is_refused(tmp_path):
    world = World(tmp_path, CHAIN | {"limits": {"output_bytes": 2000}})
    write_obj(world.drop / "a.obj")
    world.work()
    assert "more than the limit of 2,000" in world.row("a.obj").message
    assert not (world.out / "a").exists()
