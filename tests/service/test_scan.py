"""The listing, the settling rule and the copy: what is seen, when it is at rest, and that a copy is of one moment."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from chains import write_obj
from lodpipe.core.errors import AssetError
from lodpipe.io.limits import DEFAULT
from lodpipe.io.needs import Needs
from lodpipe.service import snapshot
from lodpipe.service.scan import RootGone, Tree
from lodpipe.service.settle import Seen, Signature, judge, note
from lodpipe.service.snapshot import Changed, take


def sign(path: Path) -> Signature:
    status = path.stat()
    return Signature(status.st_size, status.st_mtime_ns, status.st_ino)


@given(st.lists(st.tuples(st.floats(0.01, 5.0), st.booleans()), min_size=1, max_size=30))
def test_a_file_is_ready_only_after_it_has_been_the_same_for_the_whole_time(steps):
    now, size, seen, last_change = 0.0, 0, None, 0.0
    for pause, changes in steps:
        now += pause
        if changes or seen is None:
            size, last_change = size + 1, now
        seen = note(seen, Signature(size, 0, 1), now)
        verdict = judge(seen, {}, (), now, settle_s=2.0, closed_s=0.5, wait_s=9.0)
        assert verdict.ready == (now - last_change >= 2.0)
        assert verdict.ready or verdict.due == last_change + 2.0


def test_the_youngest_member_decides_and_an_absent_one_ends_it():
    old, young = Seen(Signature(9, 0, 1), 0.0), Seen(Signature(5, 0, 2), 10.0)
    options = {"settle_s": 2.0, "closed_s": 0.5, "wait_s": 100.0}
    assert judge(old, {"b": (young, 0)}, (), 11.0, **options).due == 12.0
    assert judge(old, {"b": (young, 0)}, (), 12.0, **options).ready
    short = judge(old, {"b": (young, 6)}, ("c",), 12.0, **options)
    assert (short.ready, short.missing, short.given_up) == (False, ("c", "b (5 of 6 bytes)"), False)
    assert judge(old, {"b": (young, 6)}, (), 110.0, **options).given_up


@pytest.fixture
def tree(tmp_path):
    root = (tmp_path / "drop").resolve()
    root.mkdir()
    return Tree(root, ignore=("old/*", "*.bak.obj"))


def test_a_listing_finds_what_no_event_has_told(tree):
    write_obj(tree.root / "a" / "b" / "x.obj")
    for name in ("old/x.obj", "x.bak.obj", ".x.obj", "x.obj~", "Thumbs.db"):
        write_obj(tree.root / name)
    assert tree.scan(1.0)
    assert list(tree) == ["a/b/x.obj"]
    assert not tree.scan(2.0)
    first = tree.get("a/b/x.obj")
    write_obj(tree.root / "y.obj")
    assert not tree.scan(3.0, {"a/b"})  # not looked at
    assert tree.scan(4.0, {""})
    assert (tree.get("y.obj").since, tree.get("a/b/x.obj")) == (4.0, first)


def test_partial_listings_find_new_folders_and_forget_those_that_are_gone(tree):
    write_obj(tree.root / "a" / "x.obj")
    tree.scan(1.0)
    write_obj(tree.root / "new" / "deep" / "y.obj")
    tree.scan(2.0, {""})
    assert list(tree) == ["a/x.obj", "new/deep/y.obj"]
    write_obj(tree.root / "later" / "z.obj")
    tree.scan(3.0, {"later"})  # an event in a folder that has not been seen yet: its parent is listed
    assert "later/z.obj" in list(tree)
    (tree.root / "new").rename(tree.root / ".hidden")
    tree.scan(4.0, {""})
    assert list(tree) == ["a/x.obj", "later/z.obj"]
    tree.scan(5.0, {".hidden/deep"})
    assert list(tree) == ["a/x.obj", "later/z.obj"]


def test_a_folder_that_cannot_be_listed_keeps_what_was_known(tree, monkeypatch):
    write_obj(tree.root / "a" / "x.obj")
    tree.scan(1.0)
    scandir = os.scandir

    def broken(path):
        if str(path).endswith("/a"):
            raise OSError(5, "Input/output error")
        return scandir(path)

    monkeypatch.setattr("lodpipe.service.scan.os.scandir", broken)
    tree.scan(2.0)
    assert list(tree) == ["a/x.obj"]
    assert tree.problems == {"a": "Input/output error"}


def test_a_root_that_is_gone_is_told_and_what_was_known_stays(tree):
    write_obj(tree.root / "x.obj")
    tree.scan(1.0)
    tree.root.rename(tree.root.parent / "gone")
    with pytest.raises(RootGone):
        tree.scan(2.0)
    assert list(tree) == ["x.obj"]


def test_a_file_that_changes_while_it_is_copied(tmp_path, monkeypatch):
    root = tmp_path.resolve() / "drop"
    path = write_obj(root / "a.obj")
    expected = {"a.obj": sign(path)}

    def during(handle, *rest, check=snapshot._check_opened):
        check(handle, *rest)
        with path.open("a") as file:
            file.write("v 9 9 9\n")

    monkeypatch.setattr(snapshot, "_check_opened", during)
    with pytest.raises(Changed):
        take(root, "a.obj", Needs(), expected, tmp_path / "one", DEFAULT)
    monkeypatch.undo()
    with pytest.raises(Changed):  # it is another one than was queued
        take(root, "a.obj", Needs(), expected, tmp_path / "two", DEFAULT)
    copy = take(root, "a.obj", Needs(), {"a.obj": sign(path)}, tmp_path / "three", DEFAULT)
    assert copy.path.read_bytes() == path.read_bytes()
    path.unlink()
    with pytest.raises(Changed):
        take(root, "a.obj", Needs(), {"a.obj": expected["a.obj"]}, tmp_path / "four", DEFAULT)


def test_a_member_that_changes_while_another_is_copied(tmp_path, monkeypatch):
    root = tmp_path.resolve() / "drop"
    write_obj(root / "a.obj")
    (root / "a.mtl").write_text("newmtl a\n")
    expected = {name: sign(root / name) for name in ("a.obj", "a.mtl")}
    copy = snapshot._copy

    def after(*arguments):
        digest = copy(*arguments)
        if arguments[1] == "a.mtl":
            write_obj(root / "a.obj", cells=5)
        return digest

    monkeypatch.setattr(snapshot, "_copy", after)
    with pytest.raises(Changed):
        take(root, "a.obj", Needs({"a.mtl": 0}), expected, tmp_path / "copy", DEFAULT)


def test_a_folder_that_becomes_a_link_in_between_reads_nothing_outside(tmp_path, monkeypatch):
    root = tmp_path.resolve() / "drop"
    path = write_obj(root / "a" / "x.obj")
    secret = tmp_path / "secret"
    write_obj(secret / "x.obj")
    expected = {"a/x.obj": sign(path)}
    opened = os.open

    def swap(name, flags, *rest):
        if str(name).endswith("a/x.obj") and not flags & os.O_CREAT:
            (root / "a").rename(root / "b")
            (root / "a").symlink_to(secret)
        return opened(name, flags, *rest)

    monkeypatch.setattr("lodpipe.service.snapshot.os.open", swap)
    with pytest.raises(Changed):
        take(root, "a/x.obj", Needs(), expected, tmp_path / "copy", DEFAULT)


def test_a_link_that_leads_out_is_not_opened(tmp_path):
    root = tmp_path.resolve() / "drop"
    root.mkdir()
    (root / "a.obj").symlink_to("/etc/hostname")
    with pytest.raises(AssetError, match="leads out of the watched folder"):
        take(root, "a.obj", Needs(), {"a.obj": sign(root / "a.obj")}, tmp_path / "copy", DEFAULT)
