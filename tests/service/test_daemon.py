"""The daemon's decisions, with a clock that the test moves: what is taken, when, how often, and what is left alone."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from chains import CHAIN, write_obj
from daemon_kit import World


@pytest.fixture
def world(tmp_path):
    return World(tmp_path)


def test_a_file_is_taken_when_it_has_been_quiet_and_its_result_appears(world):
    write_obj(world.drop / "a.obj")
    world.look()
    assert (world.states(), world.executor.started) == ({"a.obj": "settling"}, [])
    world.look(1.9)
    assert world.executor.started == []
    world.look(0.1)
    assert world.executor.started == ["a.obj"]
    assert not (world.out / "a").exists()
    world.executor.finish("a.obj")
    world.daemon.tick()
    assert world.states() == {"a.obj": "done"}
    assert world.manifest("a")["inputs"][0]["path"] == "a.obj"
    assert world.row("a.obj").revision == 1


def test_a_slow_writer_is_waited_for(world):
    path = write_obj(world.drop / "a.obj")
    whole = path.read_bytes()
    path.write_bytes(b"")
    for step in range(8):
        world.look(1.9)
        with path.open("ab") as file:
            file.write(whole[step * len(whole) // 8 : (step + 1) * len(whole) // 8])
    assert world.executor.started == []
    assert world.work() == ["a.obj"]
    assert (world.drop / "a.obj").read_bytes() == whole
    assert world.states() == {"a.obj": "done"}


def test_what_is_there_at_the_start_settles_too(tmp_path):
    write_obj(tmp_path / "drop" / "a.obj")
    world = World(tmp_path)
    world.look()
    assert world.executor.started == []
    assert (world.row("a.obj").state, world.row("a.obj").changed_at) == ("settling", world.clock.time())
    assert world.work() == ["a.obj"]


def test_a_temporary_name_is_not_looked_at_until_it_is_renamed(world):
    for name in ("a.obj.part", ".a.obj", "~$a.obj", "a.glb.tmp", "a.obj.crdownload", ".hidden/a.obj"):
        write_obj(world.drop / name)
    assert world.work() == []
    assert world.states() == {}
    (world.drop / "a.obj.part").rename(world.drop / "a.obj")
    assert world.work() == ["a.obj"]


def test_a_tree_keeps_its_folders(world):
    write_obj(world.drop / "farm" / "animals" / "cow.obj")
    write_obj(world.drop / "farm" / "cow.obj", cells=5)
    assert sorted(world.work()) == ["farm/animals/cow.obj", "farm/cow.obj"]
    assert world.manifest("farm/animals/cow")["asset"] == "cow"


def test_a_touch_or_the_same_content_again_is_no_new_work(world):
    path = write_obj(world.drop / "a.obj")
    world.work()
    stamp = (world.out / "a" / "manifest.json").stat().st_mtime_ns
    os.utime(path)
    assert world.work() == []
    content = path.read_bytes()
    path.unlink()
    world.look()
    assert world.states() == {"a.obj": "gone"}
    path.write_bytes(content)
    assert world.work() == []
    assert world.states() == {"a.obj": "done"}
    assert (world.out / "a" / "manifest.json").stat().st_mtime_ns == stamp


def test_a_rename_and_a_copy_are_no_new_work(world):
    path = write_obj(world.drop / "a.obj")
    world.work()
    path.rename(world.drop / "b.obj")
    assert world.work() == []
    assert world.states() == {"a.obj": "gone", "b.obj": "same"}
    assert world.row("b.obj").same_as == "a"
    write_obj(world.drop / "deep" / "c.obj")
    assert world.work() == []
    assert not (world.out / "b").exists()
    assert (world.out / "a" / "manifest.json").is_file()


def test_two_of_the_same_content_at_once_are_published_once(tmp_path):
    world = World(tmp_path, workers=2)
    write_obj(world.drop / "a.obj")
    write_obj(world.drop / "b.obj")
    assert len(world.work()) == 1
    assert sorted(world.states().values()) == ["done", "same"]


def test_copies_get_results_of_their_own_where_that_is_asked_for(tmp_path):
    world = World(tmp_path, same_content="publish")
    write_obj(world.drop / "a.obj")
    write_obj(world.drop / "b.obj")
    assert sorted(world.work()) == ["a.obj", "b.obj"]


def test_what_was_the_same_is_done_when_the_other_changes(world):
    write_obj(world.drop / "a.obj")
    world.work()
    write_obj(world.drop / "b.obj")
    world.work()
    assert world.states()["b.obj"] == "same"
    write_obj(world.drop / "a.obj", cells=5)
    assert world.work() == ["a.obj", "b.obj"]
    assert world.states() == {"a.obj": "done", "b.obj": "done"}
    assert world.row("b.obj").reason == "a has another content now"


def test_a_changed_file_is_a_new_revision_and_the_old_one_stays_until_then(world):
    path = write_obj(world.drop / "a.obj")
    world.work()
    first = world.manifest("a")["fingerprint"]
    write_obj(path, cells=6)
    world.settle()
    assert world.executor.started == ["a.obj", "a.obj"]
    assert world.manifest("a")["fingerprint"] == first
    world.executor.finish("a.obj")
    world.daemon.tick()
    assert world.manifest("a")["fingerprint"] != first
    assert world.row("a.obj").revision == 2
    assert world.row("a.obj").reason == "changed: a.obj"


def test_an_edit_while_it_is_processed_is_a_further_revision(world):
    path = write_obj(world.drop / "a.obj")
    world.settle()
    assert list(world.executor.jobs) == ["a.obj"]
    write_obj(path, cells=6)
    world.look()
    world.executor.finish("a.obj")  # of the copy: the old content
    assert world.work() == ["a.obj"]
    assert world.row("a.obj").revision == 2
    assert world.states() == {"a.obj": "done"}
    assert world.work() == []


def test_an_edit_between_queue_and_job_settles_again(world):
    write_obj(world.drop / "a.obj")
    paths = [write_obj(world.drop / name, cells=cells) for name, cells in (("b.obj", 5), ("c.obj", 6))]
    world.settle()
    assert world.states() == {"a.obj": "running", "b.obj": "queued", "c.obj": "queued"}
    for path in paths:  # b is copied already and c is not
        write_obj(path, cells=9 + paths.index(path))
    world.executor.finish("a.obj")
    world.daemon.tick()
    assert world.executor.jobs == {}
    assert sorted(world.work()) == ["b.obj", "c.obj"]
    assert [world.row(key).revision for key in ("b.obj", "c.obj")] == [1, 1]


def test_a_touch_while_queued_does_it_once(world):
    write_obj(world.drop / "a.obj")
    path = write_obj(world.drop / "b.obj", cells=5)
    world.settle()
    os.utime(path)
    world.look()
    world.work()
    assert world.executor.started == ["a.obj", "b.obj"]
    assert world.row("b.obj").revision == 1


def test_a_file_that_goes_while_queued_is_forgotten_and_one_in_work_is_published(world):
    first, second = write_obj(world.drop / "a.obj"), write_obj(world.drop / "b.obj", cells=5)
    world.settle()
    first.unlink()
    second.unlink()
    world.look()
    assert world.work() == []
    assert world.states() == {"a.obj": "gone"}
    assert (world.out / "a" / "manifest.json").is_file()


def test_a_changed_configuration_does_what_it_changes_again(world):
    write_obj(world.drop / "a.obj")
    world.work()
    world.watch["settle_s"] = 5.0
    world.daemon.apply(world.recipe())
    assert world.work() == []  # nothing in `watch` changes a result
    world.chain["lods"] = [{"ratio": 0.3}]
    world.daemon.apply(world.recipe())
    assert world.work() == ["a.obj"]
    assert world.row("a.obj").reason == "the configuration changed"
    assert world.row("a.obj").revision == 2


def test_results_of_run_are_recognised(world, tmp_path):
    import lodpipe

    write_obj(world.drop / "a.obj")
    lodpipe.run([world.drop], CHAIN, world.out, plugins=[tmp_path / "stages_for_tests"])
    assert world.work() == []
    assert world.states() == {"a.obj": "done"}


def test_the_same_in_two_runs_is_the_same_bytes(tmp_path):
    hashes = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        world = World(tmp_path / name)
        write_obj(world.drop / "a.obj")
        world.work()
        files = world.manifest("a")["files"]
        hashes.append([(entry["path"], entry["sha256"]) for entry in files if entry["path"].startswith("LOD")])
    assert hashes[0] == hashes[1]
    assert len(hashes[0]) == 3


def test_names_of_any_bytes_and_of_one_folded_case_are_kept_apart(world):
    odd = os.fsdecode(b"caf\xe9 \n.obj")
    for number, name in enumerate(("Cup.obj", "cup.obj", odd, "名前 ö.obj", "cup/x.obj")):
        write_obj(world.drop / name, cells=3 + number)
    assert len(world.work()) == 5
    assert set(world.states().values()) == {"done"}
    places = [world.row(key).place for key in world.states()]
    assert len({place.casefold() for place in places}) == 5
    assert all((world.out / place / "manifest.json").is_file() for place in places)


def test_an_output_folder_in_the_watched_one_is_left_out(tmp_path):
    world = World(tmp_path)
    world.out = world.drop / "lods"
    world.start()
    write_obj(world.drop / "a.obj")
    world.work()
    assert (world.drop / "lods" / "a" / "LOD1" / "a_LOD1.glb").is_file()
    assert world.work() == []
    assert list(world.states()) == ["a.obj"]


def test_priorities_go_first_small_ones_next_and_nobody_waits_for_ever(tmp_path):
    world = World(tmp_path, priorities={"hero/*": 10, "*.ply": -1000})
    write_obj(world.drop / "big.obj", cells=40)
    write_obj(world.drop / "small.obj", cells=2)
    write_obj(world.drop / "hero" / "h.obj", cells=30)
    world.daemon.table.set_facts(paused=True)
    world.daemon._changes = -1
    world.settle()
    world.daemon.table.set_facts(paused=False)
    world.daemon._changes = -1
    assert world.work() == ["hero/h.obj", "small.obj", "big.obj"]


def test_ageing_lets_a_large_asset_pass_a_small_one_that_came_later():
    from lodpipe.service.priority import rank
    from lodpipe.service.table import Row

    large = Row("large", "large", size=100_000_000, queued_at=0.0)
    assert rank(Row("b", "b", size=1000, queued_at=50.0)) < rank(large)
    assert rank(large) < rank(Row("b", "b", size=1000, queued_at=101.0))


def test_pause_begins_nothing_and_resume_goes_on(world):
    from lodpipe.service import control

    control.pause(world.output.state)
    write_obj(world.drop / "a.obj")
    assert world.work() == []
    assert world.states() == {"a.obj": "queued"}
    control.resume(world.output.state)
    assert world.work() == ["a.obj"]


def test_stopping_begins_nothing_and_what_is_stopped_stays_queued(world):
    write_obj(world.drop / "a.obj")
    world.settle()
    world.daemon.draining = True
    write_obj(world.drop / "b.obj", cells=5)
    world.settle()
    assert world.executor.started == ["a.obj"]
    world.daemon.stop_jobs()
    world.daemon.tick()
    assert world.states() == {"a.obj": "queued", "b.obj": "queued"}
    assert world.row("a.obj").attempts == 0
    world.kill()
    world.start()
    assert sorted(world.work()) == ["a.obj", "b.obj"]


def test_the_input_is_left_as_it_is(world):
    path = write_obj(world.drop / "a.obj")
    before = (path.read_bytes(), path.stat().st_mtime_ns)
    world.work()
    assert (path.read_bytes(), path.stat().st_mtime_ns) == before
    assert {path.name for path in Path(world.drop).iterdir()} == {"a.obj", ".lodpipe-root"}
