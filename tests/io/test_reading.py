"""All formats together: how `load` treats real models, broken ones, and one model written in each format."""

from __future__ import annotations

import functools
import gzip
import os
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lodpipe import io
from lodpipe.core.asset import Asset
from lodpipe.core.errors import AssetError, InvalidMesh, LimitError, LodpipeError
from lodpipe.core.mesh import Mesh
from lodpipe.io import Limits
from meshes import sphere

ErrorsOf = Callable[[list[Path]], dict[str, list[str]]]

#: file -> triangles of each real model.
DEV = {
    "duck.glb": 4212,
    "flight_helmet/FlightHelmet.gltf": 94722,
    "spot_cow/cow.obj": 5856,
    "fox.glb": 576,
    "barrel.glb": 1148,
    "cube_room/cube-room.gltf": 5364,
    "sheen_chair_scene/MixedLightingExample.gltf": 40898,
    "morph_stress_test/MorphStressTest.gltf": 2412,
    "textured_dragon/dragon.obj": 19332,
    "capsule_grid/capsule.obj": 10200,
    "oculus_touch_left.glb": 12491,
    "spider_backslash/spider.obj": 1368,
    "soccerball_mixed/soccerball.obj": 9048,
    "two_cylinder_engine.glb": 75730,
    "stanford_bunny.obj": 69451,
    "teddy.obj": 9216,
    "horse.ply": 96966,
    "cow.obj": 5804,
    "dolphin.off": 30196,
    "octopus.off": 14256,
    "pig.off": 39930,
    "armadillo.obj": 29170,
    "fandisk.obj": 12946,
    "cad_adis16480.stl": 7436,
    "arm_skeleton/arm.obj": 16618,
}
#: file -> (triangles, part of each warning) of what loads, or (error, part of its line).
BAD: dict[str, tuple[int, list[str]] | tuple[type[LodpipeError], str]] = {
    "m_all_degenerate.glb": (InvalidMesh, "no area"),
    "m_bad_indices.obj": (1, ["1 face with fewer than three corners", "3 faces with an index out of range"]),
    "m_deep_json.gltf": (AssetError, "nested more than 200 deep"),
    "m_duplicate_flipped_faces.obj": (7804, ["2,000 faces that are exact doubles"]),
    "m_fan_edge_nonmanifold.obj": (4, []),
    "m_far_offset.obj": (5804, []),
    "m_file_url_image.gltf": (1, ["is an address or a drive"]),
    "m_garbage_json.glb": (AssetError, "JSON is not UTF-8"),
    "m_glb_named.gltf": (4212, []),
    "m_header_overcount.ply": (AssetError, "its header says 1,000,000 rows of 'vertex'"),
    "m_http_image.gltf": (1, ["is an address or a drive"]),
    "m_huge_coordinates.obj": (5804, []),
    "m_huge_count.glb": (AssetError, "accessors[0]: 3,000,000,000 elements in the 25,272 bytes"),
    "m_joint_out_of_range.glb": (576, ["name a joint beyond the skin's 24", "without a weight", "sum up to 1"]),
    "m_latin1_names/mod.obj": (1, []),
    "m_missing_texture/cow.obj": (5856, ["'cow_texture.png' is missing"]),
    "m_nan_positions.glb": (4070, ["25 positions are not finite; 142 faces"]),
    "m_nan_uv.glb": (4212, ["48 of 2,399 TEXCOORD_0 values are not finite"]),
    "m_nan_vertices.obj": (5761, ["7 positions are not finite; 43 faces"]),
    "m_pixel_bomb/quad.obj": (LimitError, "30000 × 30000 pixels"),
    "m_random_winding.obj": (5804, []),
    "m_single_triangle.obj": (1, []),
    "m_stl_count_wrong.stl": (AssetError, "says 4,000,000,000 facets, but there is data for 100"),
    "m_tiny_scale.obj": (5804, []),
    "m_traversal_buffer.gltf": (AssetError, "leads out of the asset's folder"),
    "m_traversal_image.gltf": (1, ["leads out of the asset's folder"]),
    "m_traversal_mapkd/model.obj": (1, ["leads out of the asset's folder"]),
    "m_traversal_mtllib/model.obj": (1, ["leads out of the asset's folder", "'x' is in no material library"]),
    "m_truncated.glb": (AssetError, "the file is cut off"),
    "m_truncated_texture/cow.obj": (5856, ["the image is cut off"]),
    "m_unicode_name 名前 ö.obj": (1, []),
    "m_unwelded.obj": (5804, []),
    "m_view_out_of_buffer.glb": (AssetError, "bufferViews[0]: bytes 10,000,000"),
    "m_wrong_extension_ply.obj": (AssetError, "it is a PLY file; rename it to .ply"),
    "m_wrong_length.glb": (4212, ["its header says 6,024,200 bytes"]),
    "m_zero_faces.obj": (AssetError, "no triangles"),
    "m_zero_weights.glb": (576, ["1,728 vertices without a weight"]),
    "r_crash_fuzz.ply": (AssetError, "no PLY header"),
    "r_draco_suzanne.glb": (14842, []),
    "r_duplicate_faces_chair.obj": (12748, ["'model.mtl' is missing", *["in no material library"] * 3, "8 faces"]),
    "r_empty_0_bytes.obj": (AssetError, "no vertices"),
    "r_empty_nodes.glb": (AssetError, "no triangles"),
    "r_incorrect_vertex_arrays/Cube.gltf": (46, ["35 indices are not threes"] * 2),
    "r_index_out_of_range/IndexOutOfRange.gltf": (11, ["1 face with an index out of range"]),
    "r_infinite_positions.glb": (AssetError, "no triangles (meshes[0]: 24 positions are not finite"),
    "r_malformed.obj": (8, ["2 faces with an index out of range", "in no material library"]),
    "r_missing_bin/BoxTextured.gltf": (AssetError, "'BoxTextured0.bin' is missing"),
    "r_mode5_strips.gltf": (2786, []),
    "r_mtl_name_mismatch/worm.obj": (1376, ["map_ks", "map_ns", "in no material library", *["is missing"] * 2]),
    "r_nonmanifold_quads.obj": (96000, []),
    "r_nonmanifold_truck.obj": (4770, []),
    "r_obj_line_continuation.obj": (66, ["'00.mtl' is missing"]),
    "r_out_of_memory.off": (AssetError, "says 353,535,235,358 vertices"),
    "r_point_cloud.obj": (AssetError, "no triangles"),
    "r_recursive_nodes.gltf": (AssetError, "the node tree has a cycle"),
    "r_triangle_soup.stl": (100, []),
    "r_tristrips_igea.ply": (268686, []),
    "r_utf16be.obj": (12, ["in no material library"]),
    "r_wrong_type_array/badArray.gltf": (AssetError, "meshes[0].primitives: must be an array"),
}


@pytest.mark.parametrize("name", DEV)
def test_real_models(assets: Path, name: str, tmp_path: Path) -> None:
    asset = io.load(assets / "dev" / name)
    assert asset.triangles == DEV[name]
    assert [w for w in asset.warnings if "no length" not in w] == []
    assert all(image.data for image in asset.images)
    assert asset.members[0] == assets / "dev" / name
    if asset.format in ("glb", "gltf"):
        (path,) = io.save(asset, tmp_path / "again.glb")
        again = io.load(path)
        for key in ("nodes", "scenes", "scene", "textures", "samplers", "cameras", "extensions", "extensionsRequired"):
            assert again.document.get(key) == asset.document.get(key), key
        assert [m.gltf for m in again.materials] == [m.gltf for m in asset.materials]
        assert [i.data for i in again.images] == [i.data for i in asset.images]
        assert again.vertices == asset.vertices
        for one, two in zip(asset.meshes, again.meshes, strict=True):
            assert (one.primitives, one.name, one.keep_reason) == (two.primitives, two.name, two.keep_reason)
            assert np.array_equal(one.positions[one.faces], two.positions[two.faces])
            for attribute, values in one.attributes.items():
                same = np.abs(values[one.wedges] - two.attributes[attribute][two.wedges]).max()
                assert same <= (1e-3 if attribute in ("NORMAL", "TANGENT") else 0), attribute


def test_real_models_written_in_each_format_are_valid(assets: Path, tmp_path: Path, errors_of: ErrorsOf) -> None:
    written = []
    for number, name in enumerate(DEV):
        if name in ("stanford_bunny.obj", "horse.ply", "armadillo.obj", "pig.off", "dolphin.off"):
            continue  # one plain scan is like the other
        asset = io.load(assets / "dev" / name)
        folder = tmp_path / str(number)
        folder.mkdir()
        written += io.save(asset, folder / f"{number}.glb")[:1]
        written += io.save(asset, folder / f"{number}.gltf")[:1]
    assert len(written) == 2 * (len(DEV) - 5)
    assert {name: errors for name, errors in errors_of(written).items() if errors} == {}


@pytest.mark.parametrize("name", BAD)
def test_broken_models(assets: Path, name: str, tmp_path: Path) -> None:
    want, said = BAD[name]
    path = assets / "bad" / name
    start = time.monotonic()
    if isinstance(want, type):
        with pytest.raises(want) as caught:
            io.load(path)
        assert str(said) in str(caught.value)
        assert str(caught.value).startswith(path.name) and "\n" not in str(caught.value)
    else:
        asset = io.load(path)
        assert asset.triangles == want
        assert len(asset.warnings) == len(said), asset.warnings
        assert all(part in warning for part, warning in zip(said, asset.warnings, strict=True)), asset.warnings
        again = io.load(io.save(asset, tmp_path / "m.glb", warn=lambda text: None)[0])
        assert again.triangles == want
    assert time.monotonic() - start < 10
    for member in getattr(locals().get("asset"), "members", ()):
        assert member.resolve().is_relative_to(path.parent.resolve())


def test_the_table_of_broken_models_is_complete(assets: Path) -> None:
    listed = [line.split("\t")[0] for line in (assets / "bad" / "MANIFEST.tsv").read_text("utf-8").splitlines()[1:]]
    assert set(listed) == set(BAD)


def test_broken_models_that_load_are_written_validly(assets: Path, tmp_path: Path, errors_of: ErrorsOf) -> None:
    written = []
    for number, (name, (want, _)) in enumerate(BAD.items()):
        if not isinstance(want, type):
            asset = io.load(assets / "bad" / name)
            written += io.save(asset, tmp_path / f"{number}.glb", warn=lambda text: None)
    assert {name: errors for name, errors in errors_of(written).items() if errors} == {}


def test_broken_models_need_little_memory(assets: Path) -> None:
    """The worst of them in one fresh process, all together."""
    if not Path("/proc/self/status").exists():
        pytest.skip("this system does not tell a process's peak memory in /proc")
    worst = ["m_pixel_bomb/quad.obj", "r_out_of_memory.off", "m_huge_count.glb", "m_stl_count_wrong.stl"]
    worst += ["m_header_overcount.ply", "m_deep_json.gltf", "r_tristrips_igea.ply", "r_nonmanifold_quads.obj"]
    code = (
        "import sys\nfrom pathlib import Path\nfrom lodpipe import io\n"
        "from lodpipe.core.errors import LodpipeError\n"
        "for name in sys.argv[1:]:\n    try: io.load(Path(name))\n    except LodpipeError: pass\n"
        "print(open('/proc/self/status').read().split('VmHWM:')[1].split()[0])\n"
    )
    command = [sys.executable, "-c", code, *(str(assets / "bad" / name) for name in worst)]
    result = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert int(result.stdout) < 300_000  # kB


def test_every_format_holds_a_sphere(tmp_path: Path) -> None:
    points, faces = sphere(2)
    points = points.astype(np.float32).astype(float)
    asset = Asset("ball", (Mesh(points, faces),))
    for suffix in io.FORMATS:
        path = tmp_path / f"ball{suffix}"
        assert io.is_asset(path) and io.is_asset(path.with_suffix(suffix.upper()))
        io.save(asset, path)
        mesh = io.load(path).meshes[0]
        assert len(mesh.positions) == len(points), suffix
        assert np.array_equal(mesh.positions[mesh.faces].astype(np.float32), points[faces]), suffix
    assert not io.is_asset(tmp_path / "ball.fbx")


def test_limits_and_unknown_formats(tmp_path: Path) -> None:
    points, faces = sphere(2)
    for suffix in io.FORMATS:
        (path, *_) = io.save(Asset("ball", (Mesh(points, faces),)), tmp_path / f"ball{suffix}")
        with pytest.raises(LimitError, match=f"^{path.name}: .*{len(faces)} triangles"):
            io.load(path, Limits(triangles=len(faces) - 1))
        with pytest.raises(LimitError, match="bytes, more than the limit"):
            io.load(path, Limits(input_bytes=100))
    with pytest.raises(AssetError, match="not a model format"):
        io.load(tmp_path / "x.fbx")
    with pytest.raises(AssetError, match="no such file"):
        io.load(tmp_path / "x.ply")
    (tmp_path / "folder.glb").mkdir()
    with pytest.raises(AssetError, match="not a regular file"):
        io.load(tmp_path / "folder.glb")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.glb")
        with pytest.raises(AssetError, match="not a regular file"):
            io.load(tmp_path / "pipe.glb")


def test_triangles_are_counted_before_they_are_cut(tmp_path: Path) -> None:
    """A file of many more faces than allowed ends before memory is taken for its triangles."""
    rows = 200_000
    (tmp_path / "m.obj").write_bytes(b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + b"f 1 2 3\n" * rows)
    tracemalloc.start()
    with pytest.raises(LimitError, match="200,000 triangles"):
        io.load(tmp_path / "m.obj", Limits(triangles=1000))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 3 * rows * len("f 1 2 3\n")


@given(st.sampled_from(sorted(io.FORMATS)), st.data())
def test_damage_in_any_format_is_an_error_of_ours(
    tmp_path_factory: pytest.TempPathFactory, suffix: str, data: st.DataObject
) -> None:
    """Bytes of a small file changed, taken out or doubled at random: it loads, or it raises one of our errors."""
    whole = bytearray(small_files()[suffix])
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(whole) - 1))
        end = at + data.draw(st.integers(1, 20))
        how = data.draw(st.sampled_from(["any", "likely", "double", "drop"]))
        if how == "any":
            whole[at] = data.draw(st.integers(0, 255))
        elif how == "likely":
            whole[at] = data.draw(st.sampled_from(b"0123456789-+./# \n\rnaife\xff"))
        elif how == "double":
            whole[at:at] = whole[at:end]
        elif len(whole) > 100:
            del whole[at:end]
    path = tmp_path_factory.getbasetemp() / f"damaged{suffix}"
    path.write_bytes(whole)
    try:
        assert io.load(path).triangles > 0
    except LodpipeError as error:
        assert "\n" not in str(error)


@functools.cache
def small_files() -> dict[str, bytes]:
    """A coloured tetrahedron with UVs in each format."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    table = {"TEXCOORD_0": points[:, :2], "NORMAL": points * 0 + (0, 0, 1), "COLOR_0": points}
    asset = Asset("m", (Mesh(points, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], attributes=table),))
    with tempfile.TemporaryDirectory() as folder:
        paths = [io.save(asset, Path(folder) / f"m{s}", warn=lambda text: None)[0] for s in io.FORMATS]
        return {path.suffix: path.read_bytes() for path in paths}


def test_the_same_file_gives_the_same_asset(assets: Path) -> None:
    path = assets / "dev" / "sheen_chair_scene" / "MixedLightingExample.gltf"
    assert io.load(path).fingerprint() == io.load(path).fingerprint()


@pytest.mark.parametrize(
    ("data", "cause"),
    [
        (gzip.compress(b"glTF"), "compressed with gzip; unpack it"),
        (b"PK\3\4" + bytes(40), "a ZIP archive"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:a\n", "a Git LFS pointer"),
        (b"<!DOCTYPE html><html>404</html>", "a web page; download"),
        (b"Kaydara FBX Binary  \0", "an FBX file; convert"),
    ],
)
@pytest.mark.parametrize("suffix", [".glb", ".obj"])
def test_what_else_a_file_may_be_is_said(tmp_path: Path, data: bytes, cause: str, suffix: str) -> None:
    (tmp_path / f"m{suffix}").write_bytes(data)
    with pytest.raises(AssetError, match=cause):
        io.load(tmp_path / f"m{suffix}")


def test_coordinates_beyond_all_reason(tmp_path: Path) -> None:
    path = tmp_path / "m.obj"
    path.write_text("v 1e308 0 0\nv -1e308 0 0\nv 0 1e308 0\nf 1 2 3\n")
    with pytest.raises(AssetError, match=r"m.obj: it has coordinates of 1e\+308; scale it down"):
        io.load(path)


def test_every_error_says_what_to_do(tmp_path: Path) -> None:
    path = tmp_path / "m.gltf"
    path.write_text('{"asset": {"version": "2.0"}, "nodes": "x"}')
    with pytest.raises(AssetError, match=r"nodes: must be an array, not a text; check it in a 3-D program, or export"):
        io.load(path)
