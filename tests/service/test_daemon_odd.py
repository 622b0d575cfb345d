"""Odd names, odd moments and odd neighbours: what a watched folder meets sooner or later."""

from __future__ import annotations

import os
from io import StringIO

import pytest

from chains import write_obj
from daemon_kit import World
from lodpipe.core.errors import OutputError
from lodpipe.reporting.daemon_status import metrics_text, status_lines
from lodpipe.reporting.table import Style
from lodpipe.service import control
from lodpipe.service.job import AGAIN, INPUT, PASSING, Outcome, nature_of, process
from lodpipe.service.root import MARKER


@pytest.fixture
def world(tmp_path):
    return World(tmp_path)


# --- a writer that is through


def glance(world: World, seconds: float = 0.0) -> None:
    """Let time go by, and look where something has been told of."""
    world.clock.now += seconds
    world.daemon.dirty("")
    world.daemon.tick()
    world.daemon.tick()


def test_a_file_that_was_closed_or_renamed_into_place_waits_less(world):
    write_obj(world.drop / "a.obj")
    world.daemon.dirty("", "a.obj", True)
    glance(world)
    glance(world, 0.4)
    assert world.executor.started == []
    glance(world, 0.1)
    assert world.executor.started == ["a.obj"]


def test_a_file_that_was_closed_and_is_written_again_waits_in_full(world):
    path = write_obj(world.drop / "a.obj")
    world.daemon.dirty("", "a.obj", True)
    world.daemon.dirty("", "a.obj", False)  # opened anew, before anybody looked
    glance(world)
    glance(world, 1.9)
    assert world.executor.started == []
    world.daemon.dirty("", "a.obj", True)
    glance(world)
    assert world.executor.started == ["a.obj"]
    world.executor.finish("a.obj")
    world.daemon.tick()
    write_obj(path, cells=6)  # that was another file: what was said of the old one is void
    glance(world)
    glance(world, 1.9)
    assert world.executor.started == ["a.obj"]


def test_lost_events_make_what_was_said_before_void(world):
    write_obj(world.drop / "a.obj")
    world.daemon.dirty("", "a.obj", True)
    world.daemon.dirty(None)
    world.daemon.tick()
    world.clock.now += 1.9
    world.daemon.tick()
    assert world.executor.started == []


def test_of_several_files_the_one_that_rests_last_decides(world):
    (world.drop / "a.mtl").write_text("newmtl m\n")
    write_obj(world.drop / "b.obj")
    text = (world.drop / "b.obj").read_text()
    (world.drop / "b.obj").unlink()
    (world.drop / "a.obj").write_text("mtllib a.mtl\n" + text)
    world.daemon.dirty("", "a.obj", True)
    glance(world)
    glance(world, 1.9)
    assert world.executor.started == []
    glance(world, 0.1)
    assert world.executor.started == ["a.obj"]


# --- a job that has published and could not say so


def test_what_was_published_before_a_crash_counts_and_is_told_once(tmp_path):
    world = World(tmp_path, on_done={"command": ["true"]})
    path = write_obj(world.drop / "a.obj")
    world.work()
    write_obj(path, cells=6)
    world.settle()
    process(world.executor.jobs["a.obj"])
    inode = (world.out / "a").stat().st_ino
    world.kill()
    world.start()
    assert world.work() == []
    assert (world.out / "a").stat().st_ino == inode
    row = world.row("a.obj")
    assert (row.state, row.revision, row.attempts) == ("done", 2, 0)
    assert [data["revision"] for _, _, data in world.table.calls()] == [1, 2]
    assert world.table.fact("done") == 2
    os.utime(path)
    assert world.work() == []
    assert len(world.table.calls()) == 2


def test_a_worker_that_dies_after_publishing_has_not_failed(tmp_path):
    world = World(tmp_path, attempts=1)
    write_obj(world.drop / "a.obj")
    world.settle()
    job = world.executor.jobs["a.obj"]
    process(job)
    (world.out / ".failed" / "a").mkdir(parents=True)  # the record of its death
    world.executor.finish("a.obj", Outcome(job.path, "a", "failed", "", "killed", nature=AGAIN))
    world.daemon.tick()
    assert world.states() == {"a.obj": "done"}
    assert world.row("a.obj").revision == 1
    assert not (world.out / ".failed").exists()


# --- while it runs


def test_a_file_that_goes_or_gets_another_name_while_it_is_processed(world):
    path = write_obj(world.drop / "a.obj")
    world.settle()
    path.rename(world.drop / "b.obj")
    world.settle()
    assert list(world.executor.jobs) == ["a.obj"]
    world.executor.finish("a.obj")
    assert world.work() == []
    assert world.states() == {"a.obj": "gone", "b.obj": "same"}
    assert [path.name for path in world.out.iterdir() if not path.name.startswith(".")] == ["a"]


def test_a_companion_that_comes_or_changes_later_makes_it_anew(world):
    plain = write_obj(world.root / "x.obj").read_text()
    (world.drop / "a.obj").write_text("mtllib a.mtl\n" + plain)
    (world.drop / "a.mtl").write_text("newmtl m\nmap_Kd skin.png\n")
    world.settle()
    assert world.row("a.obj").missing == ["skin.png"]
    from lodpipe.io.images import encode_png

    (world.drop / "skin.png").write_bytes(encode_png(_picture(9)))
    world.settle()
    assert list(world.executor.jobs) == ["a.obj"]
    (world.drop / "skin.png").write_bytes(encode_png(_picture(200)))  # while it is processed
    world.executor.finish("a.obj")
    assert world.work() == ["a.obj"]
    (world.drop / "a.mtl").write_text("newmtl m\nKd 0.5 0 0\nmap_Kd skin.png\n")
    assert world.work() == ["a.obj"]
    assert world.row("a.obj").reason == "changed: a.mtl"
    assert world.row("a.obj").revision == 3


def _picture(value: int):
    import numpy as np

    return np.full((4, 4, 3), value, np.uint8)


# --- names


NAMES = (
    "-rf.obj",
    "--help.obj",
    "a b'c\"d`e$(f);&|<>*?[x].obj",
    "tab\there\rand\x1b[31mthere.obj",
    "line\nbreak.obj",
    "x" * 251 + ".obj",
    "名" * 83 + ".obj",
    "..a...obj",
    "con.obj",
    "a.obj",
    "a.OBJ",
    "A.obj",
    "a/b/-/c.obj",
)


def test_names_of_all_kinds_are_processed_and_shown_on_one_line_each(world):
    for number, name in enumerate(NAMES):
        write_obj(world.drop / name, cells=2 + number)
    left = [name for name in NAMES if not name.startswith(".")]
    assert sorted(world.work()) == sorted(left)
    assert set(world.states().values()) == {"done"}, world.said.getvalue()
    status = control.status(world.output.state, every=True)
    places = {asset["asset"] for asset in status["assets"]}
    assert len(places) == len(left)
    for place in places:
        manifest = world.manifest(place)
        assert all((world.out / place / entry["path"]).is_file() for entry in manifest["files"])
    text = "\n".join(status_lines(status, Style(StringIO()), every=True))
    assert len(text.splitlines()) == 3 + len(left)
    assert "\x1b" not in text
    assert metrics_text(status, 1)


def test_a_model_in_two_formats_gets_two_places_whichever_comes_first(world):
    write_obj(world.drop / "cup.obj")
    world.work()
    first = world.manifest("cup")["fingerprint"]
    from lodpipe import io

    io.save(io.load(write_obj(world.root / "x.obj", cells=7)), world.root / "cup.glb")
    (world.root / "cup.glb").rename(world.drop / "cup.glb")
    assert world.work() == ["cup.glb"]
    assert world.manifest("cup")["fingerprint"] == first
    assert world.manifest("cup_glb")["inputs"][0]["path"] == "cup.glb"


# --- neighbours


def test_links_to_folders_are_named_where_people_look(world, tmp_path):
    write_obj(tmp_path / "elsewhere" / "x.obj")
    write_obj(world.drop / "a.obj")
    (world.drop / "more").symlink_to(tmp_path / "elsewhere")
    (world.drop / "loop").symlink_to(world.drop)
    assert world.work() == ["a.obj"]
    status = control.status(world.output.state)
    why = "it is a link to a folder, and links to folders are not followed"
    assert status["left_out"] == {"more": why, "loop": why}
    assert f"more: {why}" in "\n".join(status_lines(status, Style(StringIO())))
    assert "lodpipe_folders_left_out 2" in metrics_text(status, 1)
    assert world.said.getvalue().count("more: it is a link") == 1  # not at each look
    (world.drop / "more").unlink()
    world.daemon.dirty("")
    world.daemon.tick()
    assert control.status(world.output.state)["left_out"] == {"loop": why}


def test_a_marker_that_somebody_else_has_put_there_is_not_followed(tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("mine")
    (tmp_path / "drop").mkdir()
    (tmp_path / "drop" / MARKER).symlink_to(victim)
    world = World(tmp_path)
    write_obj(world.drop / "a.obj")
    assert world.work() == ["a.obj"]
    assert victim.read_text() == "mine"
    (world.drop / MARKER).unlink()
    os.mkfifo(world.drop / MARKER)
    write_obj(world.drop / "b.obj", cells=5)
    assert world.work() == ["b.obj"]  # nor waited for


def test_two_daemons_may_watch_one_folder_for_two_outputs(tmp_path):
    one = World(tmp_path)
    write_obj(one.drop / "a.obj")
    one.work()
    two = World(tmp_path)
    two.out = tmp_path / "out2"
    two.start()
    assert two.work() == ["a.obj"]
    for world in (one, two):  # each knows it again after its share was mounted anew
        world.table.set_facts(root_device=[0, 0])
        world.look(100)
        assert world.daemon.problem == ""


# --- trouble of the machine


def test_a_clock_that_jumps_puts_nothing_off_for_longer(world):
    write_obj(world.drop / "a.obj")
    world.settle()
    world.executor.end_badly("a.obj", PASSING)
    world.daemon.tick()
    world.clock.time = lambda: 1.0  # back to 1970, as machines without a battery are
    world.daemon.tick()
    world.daemon.tick()
    assert world.work() == ["a.obj"] or world.states() == {"a.obj": "done"}
    world.clock.time = lambda: 4e9
    write_obj(world.drop / "a.obj", cells=6)
    assert world.work() == ["a.obj"]
    assert "–" not in "\n".join(status_lines(control.status(world.output.state), Style(StringIO())))


@pytest.mark.parametrize("number", [1, 13, 30])  # EPERM, EACCES, EROFS
def test_an_output_folder_that_may_not_be_written_is_the_machines_fault(number):
    def failing(kind):
        try:
            raise kind("cannot be written") from OSError(number, os.strerror(number))
        except kind as error:
            return nature_of(error)

    from lodpipe.core.errors import AssetError

    assert failing(OutputError) == PASSING
    assert failing(AssetError) == (PASSING if number == 30 else INPUT)


def test_a_file_that_may_not_be_read_yet_is_waited_for(world, monkeypatch):
    write_obj(world.drop / "a.obj")
    write_obj(world.drop / "b.obj", cells=5)
    opened = os.open

    def refuse(path, flags, *rest, **more):
        if str(path).endswith("drop/a.obj") and not flags & os.O_CREAT:
            raise PermissionError(13, "Permission denied", str(path))
        return opened(path, flags, *rest, **more)

    monkeypatch.setattr("lodpipe.service.snapshot.os.open", refuse)
    assert world.work() == ["b.obj"]
    assert world.states() == {"a.obj": "queued", "b.obj": "done"}
    assert "Permission denied" in world.row("a.obj").message
    monkeypatch.undo()
    world.look(60)
    assert world.work() == ["a.obj"] or world.states()["a.obj"] == "done"


def test_the_daemon_looks_seldom_at_what_is_at_rest(tmp_path):
    """A tick with nothing to do costs the same whatever the number of assets that are done."""
    world = World(tmp_path)
    write_obj(world.drop / "a.obj")
    world.work()
    assert world.daemon._ledger.open == {}
    write_obj(world.drop / "b.obj", cells=5)
    world.look()
    assert list(world.daemon._ledger.open) == ["b.obj"]
    world.work()
    assert (world.daemon._ledger.open, len(world.daemon._sight._needs)) == ({}, 0)
    world.kill()
    world.start()
    assert world.daemon._ledger.open == {}
