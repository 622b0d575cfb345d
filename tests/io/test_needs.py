"""The files that an asset needs, found without reading it: the same ones that the readers read."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from lodpipe import io
from lodpipe.core.errors import LodpipeError
from lodpipe.io.limits import DEFAULT
from lodpipe.io.needs import contained, find_needs
from lodpipe.service.snapshot import needs_of

ASSETS = Path(__file__).parents[3] / "shared" / "assets"


def needs(path: Path, text: str | bytes):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return find_needs(path, DEFAULT)


def test_gltf_names_buffers_with_their_length_and_images(tmp_path):
    (tmp_path / "a b.png").write_bytes(b"x")
    tree = {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": "a.bin", "byteLength": 10}, {"uri": "data:;base64,AA==", "byteLength": 1}],
        "images": [{"uri": "a%20b.png"}, {"bufferView": 0}, {"uri": "http://x/y.png"}, {"uri": "../out.png"}],
    }
    found = needs(tmp_path / "a.gltf", json.dumps(tree))
    assert found.members == {"a b.png": 0}
    assert found.missing == ["a.bin"]
    (tmp_path / "a.bin").write_bytes(b"123")
    assert find_needs(tmp_path / "a.gltf", DEFAULT).members == {"a.bin": 10, "a b.png": 0}


def test_obj_names_libraries_and_their_maps_wherever_the_line_stands(tmp_path):
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib" / "m.mtl").write_text(
        "newmtl a\nmap_Kd -s 2 2 2 skin.png\nmap_Kd other.png\nmap_Bump C:\\x\\b.png\n"
    )
    (tmp_path / "lib" / "skin.png").write_bytes(b"x")
    body = "v 0 0 0\n" * 300_000  # more than is read at once
    found = needs(tmp_path / "a.obj", f"{body}mtllib lib\\m.mtl\nmtllib gone.mtl\n")
    assert found.members == {"lib/m.mtl": 0, "lib/skin.png": 0}
    assert found.missing == ["lib/b.png", "gone.mtl"]
    assert "b.png" in found.wanted


def test_maps_that_lead_out_are_not_waited_for(tmp_path):
    (tmp_path / "m.mtl").write_text("newmtl a\nmap_Kd ../../../../etc/passwd\n")
    found = needs(tmp_path / "a.obj", "mtllib m.mtl\nmtllib ../x.mtl\nmtllib /etc/passwd\n")
    assert (found.members, found.missing) == ({"m.mtl": 0}, [])


@pytest.mark.parametrize(
    "text", [b"", b"\0\1\2", b"{", b"[" * 100_000, b"glTF\2\0\0\0", b'{"buffers": [3, {"uri": 4}]}']
)
def test_what_cannot_be_understood_needs_nothing(tmp_path, text):
    for name in ("a.gltf", "a.glb", "a.obj", "a.stl"):
        assert needs(tmp_path / name, text) == find_needs(tmp_path / "none.stl", DEFAULT)


def test_large_json_is_looked_through_elsewhere(tmp_path):
    tree = {"buffers": [{"uri": "a.bin", "byteLength": 9}], "extras": "x" * (5 << 20)}
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    assert needs_of(tmp_path / "a.gltf", DEFAULT).missing == ["a.bin"]


def test_places_stay_inside():
    assert contained("tex/../a.png", "duck") == "duck/a.png"
    assert contained("../duck/a.png", "duck") == "duck/a.png"
    assert contained("../a.png", "duck") == ""


@pytest.mark.skipif(not ASSETS.is_dir(), reason="the shared assets are not there")
@pytest.mark.parametrize("folder", ["dev", "bad"])
def test_it_finds_what_the_readers_read(folder):
    checked = 0
    for path in sorted((ASSETS / folder).rglob("*")):
        if path.suffix not in (".obj", ".gltf", ".glb") or path.stat().st_size > 1_000_000:
            continue
        try:
            asset = io.load(path)
        except LodpipeError:
            continue
        found = find_needs(path, DEFAULT)
        home = path.parent.resolve()
        read = {member.resolve().relative_to(home).as_posix() for member in asset.members[1:]}
        assert read <= {(home / name).resolve().relative_to(home).as_posix() for name in found.members}, path
        checked += bool(read)
    assert checked > 1
