"""What goes wrong: missing members, poison, passing trouble, a root that is gone, crashes between any two steps."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from chains import CHAIN, write_obj
from daemon_kit import World
from lodpipe.service import control, intake
from lodpipe.service import daemon as daemon_module
from lodpipe.service.job import AGAIN, INPUT, PASSING
from lodpipe.service.publish import Output


@pytest.fixture
def world(tmp_path):
    return World(tmp_path)


def write_gltf(folder: Path, name: str = "a", *, scale: float = 1.0) -> dict[str, bytes]:
    """The files of a glTF with a buffer and an image beside it; nothing is written but the folder."""
    import numpy as np

    from lodpipe.io.images import encode_png

    folder.mkdir(parents=True, exist_ok=True)
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], np.float32) * scale
    faces = np.array([0, 1, 2, 2, 1, 3], np.uint16)
    data = corners.tobytes() + faces.tobytes()
    tree = {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": f"{name}.bin", "byteLength": len(data)}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 12},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
        "images": [{"uri": "tex/my%20skin.png"}],
        "textures": [{"source": 0}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    }
    picture = encode_png(np.full((4, 4, 3), 200, np.uint8))
    return {f"{name}.gltf": json.dumps(tree).encode(), f"{name}.bin": data, "tex/my skin.png": picture}


def put(folder: Path, name: str, data: bytes) -> None:
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(data)


# --- several files


@pytest.mark.parametrize("order", [(0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)])
def test_the_files_of_an_asset_may_come_in_any_order(world, order):
    files = list(write_gltf(world.drop).items())
    for index in order[:-1]:
        put(world.drop, *files[index])
        world.settle()
    assert world.executor.started == []
    if order[-1] != 0:
        assert world.states() == {"a.gltf": "waiting"}
        assert world.row("a.gltf").missing == [("a.gltf", "a.bin", "tex/my skin.png")[order[-1]]]
    put(world.drop, *files[order[-1]])
    assert world.work() == ["a.gltf"]
    assert [entry["path"] for entry in world.manifest("a")["inputs"]] == ["a.gltf", "a.bin", "tex/my skin.png"]
    assert world.row("a.gltf").warnings == 0


def test_a_buffer_that_is_too_short_is_not_all_there_yet(world):
    files = write_gltf(world.drop)
    for name, data in files.items():
        put(world.drop, name, data)
    put(world.drop, "a.bin", files["a.bin"][:20])
    world.settle()
    assert world.row("a.gltf").missing == ["a.bin (20 of 60 bytes)"]
    put(world.drop, "a.bin", files["a.bin"])
    assert world.work() == ["a.gltf"]


def test_what_never_comes_is_named_in_quarantine_and_taken_up_when_it_does(tmp_path):
    world = World(tmp_path, wait_s=100)
    files = write_gltf(world.drop)
    put(world.drop, "a.gltf", files["a.gltf"])
    world.settle()
    world.look(97)
    assert world.states() == {"a.gltf": "waiting"}
    world.look(2)
    assert world.states() == {"a.gltf": "failed"}
    error = json.loads((world.out / ".failed" / "a" / "error.json").read_text())
    assert error["cause"] == "missing: a.bin, tex/my skin.png"
    assert (world.drop / "a.gltf").is_file()
    for name, data in files.items():
        put(world.drop, name, data)
    assert world.work() == ["a.gltf"]
    assert world.states() == {"a.gltf": "done"}
    assert not (world.out / ".failed").exists()


def test_it_can_be_done_without_what_never_comes(tmp_path):
    world = World(tmp_path, wait_s=10, missing="process")
    files = write_gltf(world.drop)
    put(world.drop, "a.gltf", files["a.gltf"])
    put(world.drop, "a.bin", files["a.bin"])
    world.settle()
    world.look(10)
    world.work()
    assert world.states() == {"a.gltf": "done"}
    assert world.row("a.gltf").warnings == 1
    put(world.drop, "tex/my skin.png", files["tex/my skin.png"])
    assert world.work() == ["a.gltf"]
    assert world.row("a.gltf").warnings == 0


def test_a_changed_texture_is_a_new_revision(world):
    for name, data in write_gltf(world.drop).items():
        put(world.drop, name, data)
    world.work()
    import numpy as np

    from lodpipe.io.images import encode_png

    put(world.drop, "tex/my skin.png", encode_png(np.zeros((4, 4, 3), np.uint8)))
    assert world.work() == ["a.gltf"]
    assert world.row("a.gltf").reason == "changed: tex/my skin.png"


# --- poison


@pytest.mark.parametrize("nature", [AGAIN, INPUT])
def test_poison_is_tried_so_often_then_quarantined_and_left_alone(world, nature):
    write_obj(world.drop / "a.obj")
    world.settle()
    attempts = {AGAIN: 2, INPUT: 1}[nature]
    for attempt in range(attempts):
        assert world.executor.jobs["a.obj"].records == ((INPUT, AGAIN) if attempt == 1 else (INPUT,))
        world.executor.end_badly("a.obj", nature)
        world.daemon.tick()
        world.daemon.tick()
    assert world.states() == {"a.obj": "failed"}
    for _ in range(3):
        assert world.work() == []
    os.utime(world.drop / "a.obj")
    assert world.work() == []
    assert world.states() == {"a.obj": "failed"}
    write_obj(world.drop / "a.obj", cells=5)
    assert world.work() == ["a.obj"]
    assert world.states() == {"a.obj": "done"}


def test_poison_does_not_stop_the_others_and_a_configuration_gives_it_another_chance(tmp_path):
    world = World(tmp_path, CHAIN | {"stages": [{"fail": {"only": "b"}}, "thin", "export"]})
    for number, name in enumerate("abc"):
        write_obj(world.drop / f"{name}.obj", cells=3 + number)
    world.work()
    assert world.states() == {"a.obj": "done", "b.obj": "failed", "c.obj": "done"}
    record = world.out / ".failed" / "b"
    assert json.loads((record / "error.json").read_text())["cause"] == "two and two is five"
    assert {path.name for path in record.iterdir()} == {"error.json", "report.json", "lodpipe.log", "b.obj"}
    assert (record / "b.obj").resolve() == (world.drop / "b.obj").resolve()
    world.chain = CHAIN
    world.daemon.apply(world.recipe())
    world.work()
    assert set(world.states().values()) == {"done"}
    assert not record.exists()


def test_higher_limits_give_what_failed_another_chance(tmp_path):
    world = World(tmp_path, CHAIN | {"limits": {"input_bytes": 100}})
    write_obj(world.drop / "a.obj")
    assert world.work() == []
    world.chain = CHAIN
    world.daemon.apply(world.recipe())
    assert world.work() == ["a.obj"]
    assert world.states() == {"a.obj": "done"}


def test_an_asset_that_the_daemon_itself_dies_of_is_poison_too(world):
    write_obj(world.drop / "a.obj")
    write_obj(world.drop / "b.obj", cells=5)
    for _ in range(6):
        world.settle()
        assert "a.obj" in world.executor.jobs
        world.kill()
        world.start()
    assert world.states()["a.obj"] == "failed"
    assert "the daemon has died 6 times" in world.row("a.obj").message
    assert world.work() == ["b.obj"]
    assert control.retry(world.output.state) == ["a.obj"]
    assert world.work() == ["a.obj"]


def test_retry_does_it_again_whether_the_daemon_runs_or_not(world):
    write_obj(world.drop / "a.obj")
    world.settle()
    world.executor.end_badly("a.obj", INPUT)
    world.daemon.tick()
    world.kill()
    assert control.retry(world.output.state) == ["a.obj"]
    world.start()
    assert world.work() == ["a.obj"]
    assert control.retry(world.output.state) == []
    assert control.retry(world.output.state, ["a"]) == ["a.obj"]
    assert world.work() == []  # it is there
    assert control.retry(world.output.state, ["*.obj"], force=True) == ["a.obj"]
    assert world.work() == ["a.obj"]
    assert world.row("a.obj").reason == "asked for"
    with pytest.raises(control.AssetError, match="nothing: there is no such asset"):
        control.retry(world.output.state, ["nothing"])


# --- passing trouble


def test_passing_trouble_is_put_off_longer_and_longer_and_burns_no_attempt(world):
    write_obj(world.drop / "a.obj")
    world.settle()
    for pause in (2, 4, 8, 16, 32, 60, 60):
        world.executor.end_badly("a.obj", PASSING, "No space left on device")
        world.daemon.tick()
        row = world.row("a.obj")
        assert (row.state, row.attempts, row.message) == ("queued", 0, "put off: No space left on device")
        world.clock.now += pause - 0.1
        world.daemon.tick()
        assert world.executor.jobs == {}
        world.clock.now += 0.2
        world.daemon.tick()
        world.daemon.tick()
        assert list(world.executor.jobs) == ["a.obj"]
    world.work()
    assert world.states() == {"a.obj": "done"}
    assert not (world.out / ".failed").exists()


def test_no_space_for_the_copy_is_passing_trouble_too(world, monkeypatch):
    write_obj(world.drop / "a.obj")

    def full(*args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(intake, "take", full)
    world.settle()
    assert world.row("a.obj").message.endswith("No space left on device")
    assert list(world.output.state.glob("tmp-*")) == []
    monkeypatch.undo()
    world.look(2.1)
    assert world.work() == ["a.obj"] or world.states() == {"a.obj": "done"}


def test_no_space_for_the_record_of_a_failure_keeps_it_queued(world, monkeypatch):
    (world.drop / "a.obj").symlink_to("/etc/hostname")

    def full(*args, **options):
        raise daemon_module.LodpipeError("cannot be written (No space left on device)")

    monkeypatch.setattr(daemon_module, "fail", full)
    world.settle()
    assert world.states() == {"a.obj": "queued"}
    monkeypatch.undo()
    world.look(3)
    world.look()
    assert world.states() == {"a.obj": "failed"}


# --- the watched folder itself


def test_a_folder_that_is_gone_is_waited_for(world):
    write_obj(world.drop / "a.obj")
    world.work()
    world.drop.rename(world.root / "elsewhere")
    world.look(100)
    assert "cannot be reached" in world.daemon.problem
    assert world.states() == {"a.obj": "done"}
    assert world.table.fact("problem") == world.daemon.problem
    (world.root / "elsewhere").rename(world.drop)
    write_obj(world.drop / "b.obj", cells=5)
    assert world.work() == ["b.obj"]
    assert world.states() == {"a.obj": "done", "b.obj": "done"}


def test_the_empty_mount_point_of_a_share_is_no_mass_deletion(world):
    write_obj(world.drop / "a.obj")
    world.work()
    world.drop.rename(world.root / "share")
    world.drop.mkdir()  # what is seen where nothing is mounted
    world.look(100)
    assert "is its share mounted?" in world.daemon.problem
    assert world.states() == {"a.obj": "done"}
    world.kill()
    world.start()  # nor after a restart
    world.look(100)
    assert world.states() == {"a.obj": "done"}
    world.drop.rmdir()
    (world.root / "share").rename(world.drop)
    world.look(100)
    assert world.daemon.problem == ""
    assert world.work() == []


def test_resume_takes_another_folder_as_it_is(world):
    write_obj(world.drop / "a.obj")
    world.work()
    world.drop.rename(world.root / "old")
    world.drop.mkdir()
    write_obj(world.drop / "b.obj", cells=5)
    world.look(100)
    assert world.daemon.problem
    control.resume(world.output.state)
    assert world.work() == ["b.obj"]
    assert world.states() == {"a.obj": "gone", "b.obj": "done"}


def test_a_result_stays_when_its_input_goes_or_is_archived(tmp_path):
    for name, how in (("one", "keep"), ("two", "archive")):
        (tmp_path / name).mkdir()
        world = World(tmp_path / name, on_removed=how)
        write_obj(world.drop / "a.obj")
        world.work()
        (world.drop / "a.obj").unlink()
        world.look()
        assert world.states() == {"a.obj": "gone"}
        assert (world.out / "a" / "manifest.json").exists() is (how == "keep")
        assert (world.out / ".archive" / "a" / "manifest.json").exists() is (how == "archive")


# --- afterwards


@pytest.mark.parametrize("how", ["move", "delete"])
def test_inputs_go_only_after_success(tmp_path, how):
    world = World(tmp_path, CHAIN | {"stages": [{"fail": {"only": "bad"}}, "thin", "export"]}, on_success=how)
    for name, data in write_gltf(world.drop).items():
        put(world.drop, name, data)
    write_obj(world.drop / "bad.obj")
    world.work()
    assert world.states() == {"a.gltf": "done", "bad.obj": "failed"}
    assert sorted(path.name for path in world.drop.rglob("*") if path.is_file()) == [".lodpipe-root", "bad.obj"]
    moved = world.out / ".done"
    assert sorted(path.name for path in moved.rglob("*") if path.is_file()) == (
        ["a.bin", "a.gltf", "my skin.png"] if how == "move" else []
    )
    world.look(100)
    assert world.states() == {"a.gltf": "done", "bad.obj": "failed"}


def test_what_another_asset_needs_or_has_changed_is_not_deleted(tmp_path):
    world = World(tmp_path, on_success="delete")
    for name, data in (write_gltf(world.drop) | write_gltf(world.drop, "b", scale=2.0)).items():
        put(world.drop, name, data)
    world.settle()
    world.executor.finish("a.gltf")
    world.daemon.tick()
    assert sorted(path.name for path in world.drop.iterdir()) == [".lodpipe-root", "b.bin", "b.gltf", "tex"]
    assert (world.drop / "tex" / "my skin.png").is_file()
    world.daemon.tick()
    put(world.drop, "b.bin", write_gltf(world.drop, "b", scale=3.0)["b.bin"])
    world.executor.finish("b.gltf")
    world.daemon.tick()
    assert (world.drop / "b.gltf").is_file()
    world.work()
    assert [path.name for path in world.drop.rglob("*") if path.is_file()] == [".lodpipe-root"]
    assert world.row("b.gltf").revision == 2


def test_nothing_is_deleted_when_the_result_is_not_as_it_was_written(tmp_path):
    world = World(tmp_path, on_success="delete")
    write_obj(world.drop / "a.obj")
    world.settle()
    job = world.executor.jobs["a.obj"]
    from lodpipe.service.job import process

    outcome = process(job)
    (world.out / "a" / "LOD1" / "a_LOD1.glb").write_bytes(b"")
    world.executor.finish("a.obj", outcome)
    world.daemon.tick()
    assert (world.drop / "a.obj").is_file()


# --- crashes


def test_a_kill_after_any_step_loses_nothing_and_publishes_once(tmp_path):
    """The daemon dies after each change of the table in turn; the next one finishes the work."""
    published = 0
    for step in range(40):
        (tmp_path / str(step)).mkdir()
        world = World(tmp_path / str(step))
        write_obj(world.drop / "a.obj")
        left = [step]
        put_row = world.table.put

        def counted(row, left=left, put_row=put_row):
            if left[0] == 0:
                raise KeyboardInterrupt
            left[0] -= 1
            put_row(row)

        world.table.put = counted
        try:
            world.work()
            done = True
        except KeyboardInterrupt:
            done = False
        stamp = (world.out / "a" / "manifest.json").stat().st_mtime_ns if (world.out / "a").exists() else None
        world.kill()
        world.start()
        world.work()
        assert world.states() == {"a.obj": "done"}, step
        assert list(world.output.state.glob("tmp-*")) == []
        if stamp:
            published += 1
            assert (world.out / "a" / "manifest.json").stat().st_mtime_ns == stamp  # not a second time
        if done:
            break
    assert done
    assert published >= 2


def test_a_kill_in_the_middle_of_publishing_leaves_the_old_result_or_the_new_one(world, monkeypatch):
    path = write_obj(world.drop / "a.obj")
    world.work()
    old = world.manifest("a")["fingerprint"]
    write_obj(path, cells=6)
    world.settle()

    def die(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(Output, "_put", die)
    with pytest.raises(KeyboardInterrupt):
        world.executor.finish("a.obj")
    monkeypatch.undo()
    assert world.manifest("a")["fingerprint"] == old
    world.kill()
    world.start()
    assert world.row("a.obj").state == "queued"
    assert world.work() == ["a.obj"]
    assert world.manifest("a")["fingerprint"] != old


def test_a_damaged_table_is_set_aside_and_what_is_published_is_recognised(world):
    write_obj(world.drop / "a.obj")
    world.work()
    world.kill()
    for tail in ("", "-wal", "-shm"):
        path = world.output.state / f"jobs.sqlite{tail}"
        if path.exists():
            path.write_bytes(b"not a database, " * 1000 if not tail else b"")
    world.start()
    assert world.table.set_aside.name == "jobs.sqlite.broken1"
    assert world.work() == []
    assert world.states() == {"a.obj": "done"}


# --- untrusted files


def test_links_that_lead_out_are_refused_and_read_nothing(world, tmp_path):
    secret = write_obj(tmp_path / "secret" / "s.obj")
    (world.drop / "a.obj").symlink_to(secret)
    (world.drop / "folder").symlink_to(tmp_path / "secret")
    (world.drop / "b.obj").write_text("mtllib b.mtl\n" + write_obj(tmp_path / "x.obj").read_text())
    (world.drop / "b.mtl").symlink_to(tmp_path / "secret" / "s.obj")
    world.work()
    assert world.executor.started == ["b.obj"]
    assert world.row("a.obj").message.endswith(
        "it is a link that leads out of the watched folder; copy the file itself"
    )
    assert [entry["path"] for entry in world.manifest("b")["inputs"]] == ["b.obj"]
    assert world.row("b.obj").warnings == 1


def test_a_job_sees_a_copy_with_only_its_members(world):
    for name, data in write_gltf(world.drop).items():
        put(world.drop, name, data)
    put(world.drop, "other.txt", b"private")
    world.settle()
    job = world.executor.jobs["a.gltf"]
    assert job.path == str(world.drop / "a.gltf")
    copy = Path(job.read_from)
    assert copy.is_relative_to(world.output.state)
    names = sorted(path.relative_to(copy.parent).as_posix() for path in copy.parent.rglob("*") if path.is_file())
    assert names == ["a.bin", "a.gltf", "tex/my skin.png"]
    world.executor.finish("a.gltf")
    world.daemon.tick()
    assert not copy.exists()
    report = json.loads((world.out / "a" / "report.json").read_text())
    assert report["source"]["file"] == report["input"] == str(world.drop / "a.gltf")


def test_too_many_bytes_are_refused_before_they_are_copied(tmp_path):
    world = World(tmp_path, CHAIN | {"limits": {"input_bytes": 100}})
    write_obj(world.drop / "a.obj")
    assert world.work() == []
    assert "more than the limit of 100" in world.row("a.obj").message


def test_a_pipe_with_a_models_name_is_not_waited_for(world):
    os.mkfifo(world.drop / "a.obj")
    assert world.work() == []
    assert world.states() == {}
