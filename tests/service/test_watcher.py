"""What wakes the daemon, and that nothing depends on it."""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
from pathlib import Path

import pytest

from chains import write_obj
from daemon_kit import until
from lodpipe.service.watcher import Watcher, file_system, is_silent

MOUNTS = """22 1 8:1 / / rw - ext4 /dev/sda1 rw
30 22 0:40 / /mnt/share rw - nfs4 host:/x rw
31 22 0:41 / /mnt/a\\040b rw - fuse.sshfs host: rw
32 30 0:42 / /mnt/share/local rw - tmpfs tmpfs rw
"""


@pytest.mark.parametrize(
    ("path", "kind", "silent"),
    [
        ("/srv/drop", "ext4", False),
        ("/mnt/share", "nfs4", True),
        ("/mnt/share/deep/er", "nfs4", True),
        ("/mnt/shared", "ext4", False),
        ("/mnt/share/local/x", "tmpfs", False),
        ("/mnt/a b/x", "fuse.sshfs", True),
    ],
)
def test_file_systems_without_events(path, kind, silent):
    assert file_system(Path(path), MOUNTS) == kind
    assert is_silent(kind) is silent
    assert is_silent("cifs")
    assert is_silent("9p")


class Told:
    """Collects what a watcher says, and lets a test wait for it without sleeping."""

    def __init__(self) -> None:
        self.folders: list[str | None] = []
        self.hear = lambda folder, name, closed: None
        self._more = threading.Condition()

    def __call__(self, folder: str | None, name: str = "", closed: bool = False) -> None:
        with self._more:
            self.folders.append(folder)
            self.hear(folder, name, closed)
            self._more.notify_all()

    def wait_for(self, folder: str | None) -> bool:
        return self.wait(lambda: folder in self.folders)

    def wait(self, condition) -> bool:
        with self._more:
            return self._more.wait_for(condition, timeout=20)


@pytest.fixture
def watcher(tmp_path):
    told = Told()
    made = Watcher(tmp_path, told, logging.getLogger("test"), "on")
    made.told = told
    yield made
    made.close()


def test_events_name_the_folder_also_of_moves_and_of_new_folders(watcher, tmp_path):
    assert watcher.check()
    assert watcher.told.folders == [None]
    (tmp_path / "a.part").write_text("x")
    assert watcher.told.wait_for("")
    (tmp_path / "deep").mkdir()
    end = time.monotonic() + 20
    while "deep" not in watcher.told.folders:  # until the new folder is watched too
        (tmp_path / "a.part").rename(tmp_path / "deep" / "a.obj")
        (tmp_path / "deep" / "a.obj").rename(tmp_path / "a.part")
        assert time.monotonic() < end


def test_lost_events_and_a_dead_watcher_make_it_look_everywhere(watcher, tmp_path):
    watcher.check()
    watcher.told.folders.clear()
    logging.getLogger("watchdog.observers.inotify").warning("Inotify queue overflowed")
    assert watcher.told.folders == [None]
    first = watcher._observer
    for emitter in first.emitters:
        emitter.stop()
        emitter.join()
    assert first.is_alive()  # it does not notice that itself
    assert not watcher.works
    watcher.told.folders.clear()
    assert watcher.check()
    assert watcher.told.folders == [None]
    assert watcher._observer is not first
    assert watcher.check()  # no further one while it works
    assert watcher.told.folders == [None]


def test_another_folder_in_the_place_of_the_watched_one_is_watched(watcher, tmp_path):
    watcher._root = tmp_path / "root"
    watcher._root.mkdir()
    assert watcher.check()
    watcher._root.rename(tmp_path / "old")
    assert not watcher.works
    assert not watcher.check()  # it is not there
    watcher._root.mkdir()
    assert watcher.check()


def test_events_can_be_left_out(tmp_path):
    told = Told()
    silent = Watcher(tmp_path, told, logging.getLogger("test"), "off")
    assert not silent.check()
    assert silent._observer is None
    silent.close()


def test_a_real_overflow_of_the_systems_queue_loses_nothing(running):
    """The daemon stands still while more happens than the system's queue takes; what is lost in it is found at once."""
    limit = int(Path("/proc/sys/fs/inotify/max_queued_events").read_text())
    if limit > 200_000:
        pytest.skip(f"the queue takes {limit} events")
    daemon = running({"watch": {"rescan_s": 3600}})
    until(lambda: daemon.says("watching"))
    os.kill(daemon.process.pid, signal.SIGSTOP)
    here, there = daemon.drop / "x.part", daemon.drop / "y.part"
    here.write_text("x")
    for _ in range(limit // 4 + 100):  # two events each, there and back; alike ones in a row would be made one
        here.rename(there)
        there.rename(here)
    write_obj(daemon.drop / "new" / "late.obj")  # neither the folder nor the file has an event any more
    os.kill(daemon.process.pid, signal.SIGCONT)
    until(lambda: (daemon.out / "new" / "late" / "manifest.json").is_file())
    assert daemon.says("overflow")
    write_obj(daemon.drop / "new" / "later.obj", cells=5)  # the folder is watched from now on
    until(lambda: (daemon.out / "new" / "later" / "manifest.json").is_file())


def test_a_close_and_a_move_say_that_the_writer_is_through(watcher, tmp_path):
    watcher.check()
    ends: dict[str, bool] = {}
    watcher.told.hear = lambda folder, name, closed: ends.__setitem__(f"{folder}/{name}", closed)
    with (tmp_path / "a.obj").open("w") as file:
        file.write("x")
        file.flush()
        assert watcher.told.wait(lambda: ends.get("/a.obj") is False)
    assert watcher.told.wait(lambda: ends.get("/a.obj") is True)
    (tmp_path / "b.part").write_text("x")
    (tmp_path / "b.part").rename(tmp_path / "b.obj")
    assert watcher.told.wait(lambda: ends.get("/b.obj") is True)
