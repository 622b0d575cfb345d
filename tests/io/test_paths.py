from __future__ import annotations

from pathlib import Path

import pytest

from lodpipe.core.errors import AssetError, LimitError
from lodpipe.io import Limits
from lodpipe.io.paths import Folder


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    inside = tmp_path / "asset"
    (inside / "sub dir").mkdir(parents=True)
    (inside / "m.obj").write_bytes(b"12345")
    (inside / "sub dir" / "t.png").write_bytes(b"abc")
    (tmp_path / "secret").write_bytes(b"no")
    return Folder(inside / "m.obj", Limits(input_bytes=10))


@pytest.mark.parametrize(
    "name",
    [
        "../secret",
        "sub dir/../../secret",
        "..\\secret",
        "/etc/passwd",
        "\\etc\\passwd",
        "file:///etc/passwd",
        "http://localhost/x",
        "C:\\x",
        "link",
        "linked/secret",
        "a\0b",
        "x" * 5000,
    ],
)
def test_nothing_outside_the_folder_is_read(folder: Folder, name: str) -> None:
    root = folder.path.parent
    (root / "link").symlink_to(root.parent / "secret")
    (root / "linked").symlink_to(root.parent)
    with pytest.raises(AssetError) as caught:
        folder.read(name)
    assert folder.members == [] and len(str(caught.value)) < 300
    assert "missing" not in str(caught.value)


@pytest.mark.parametrize(
    "uri", ["..%2Fsecret", "%2e%2e/secret", "..%5Csecret", "%2Fetc%2Fpasswd", "file%3A///etc/passwd"]
)
def test_nor_by_percent_signs(folder: Folder, uri: str) -> None:
    with pytest.raises(AssetError, match=r"leads out|not a relative path|is an address"):
        folder.read_uri(uri)
    with pytest.raises(AssetError, match="not UTF-8"):
        folder.read_uri("%ff%fe")


def test_what_is_inside_is_found_and_noted(folder: Folder) -> None:
    root = folder.path.parent
    (root / "inner").symlink_to("sub dir")
    target = root / "sub dir" / "t.png"
    assert folder.read_asset() == b"12345"
    assert folder.read("sub dir\\t.png") == b"abc"
    assert folder.members == [folder.path, target]
    folder = Folder(folder.path, Limits())
    assert folder.read_uri("sub%20dir/t.png") == folder.read("inner/t.png") == b"abc"
    assert folder.members == [target]


def test_limits_and_missing_files(folder: Folder) -> None:
    folder.read_asset()
    folder.read("sub dir/t.png")
    with pytest.raises(LimitError, match="11 bytes, more than the limit of 10"):
        folder.read("sub dir/t.png")
    with pytest.raises(AssetError, match=r"'gone\.png' is missing"):
        folder.read("gone.png")
    with pytest.raises(AssetError, match="is missing"):
        folder.read("sub dir")
    with pytest.raises(AssetError, match="no such file"):
        Folder(folder.path.with_name("none.obj"), Limits()).read_asset()
    with pytest.raises(AssetError, match="not a regular file"):
        Folder(folder.path.parent, Limits()).read_asset()


def test_the_case_of_letters_does_not_count_where_one_file_is_meant(folder: Folder) -> None:
    root = folder.path.parent
    assert folder.read("SUB dir\\T.PNG") == b"abc"
    assert folder.members == [root / "sub dir" / "t.png"] and folder.missing == []
    (root / "sub dir" / "T.png").write_bytes(b"other")
    with pytest.raises(AssetError, match="is missing"):
        folder.read("sub dir/T.PNG")
    assert folder.find("sub dir/T.png").read_bytes() == b"other"
    (root / "Linked").symlink_to(root.parent)
    with pytest.raises(AssetError, match="is missing"):
        folder.read("linked/SECRET")
