from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import model_files as files
from lodpipe import io
from lodpipe.core.asset import Asset
from lodpipe.core.mesh import Mesh

ErrorsOf = Callable[[list[Path]], dict[str, list[str]]]


def json_of(path: Path) -> dict[str, Any]:
    data = path.read_bytes()
    return dict(json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]]))


def half(mesh: Mesh) -> Mesh:
    """The mesh with its first face only."""
    return Mesh(
        mesh.positions,
        mesh.faces[:1],
        mesh.wedges[:1],
        mesh.attributes,
        mesh.face_primitive[:1],
        mesh.primitives,
        mesh.name,
    )


def test_levels_of_the_rich_model(tmp_path: Path, errors_of: ErrorsOf) -> None:
    asset = io.load(files.rich().save(tmp_path / "rich.glb"))
    panel, arm, tile = asset.meshes
    levels = [asset.meshes, (half(panel), arm, tile), (half(panel), arm, half(tile))]
    (path,) = io.save_combined(asset, tmp_path / "all.glb", levels, [0.5, 0.2, 0.01])
    tree = json_of(path)
    assert errors_of([path]) == {"all.glb": []}
    assert "MSFT_lod" in tree["extensionsUsed"] and "MSFT_lod" not in tree.get("extensionsRequired", ())
    nodes = tree["nodes"]
    with_levels = {i: n["extensions"]["MSFT_lod"]["ids"] for i, n in enumerate(nodes) if "MSFT_lod" in str(n)}
    assert len(with_levels) == 2, "the arm is the same in all levels"
    for i, ids in with_levels.items():
        assert len(ids) == 2
        assert nodes[i]["extras"]["MSFT_screencoverage"] == [0.5, 0.2, 0.01]
        assert all(tree["meshes"][nodes[k]["mesh"]]["primitives"] for k in ids)
    placed = io.load(path)
    shown = {index for index, _ in placed.instances()}
    coarse = {nodes[k]["mesh"] for ids in with_levels.values() for k in ids if k not in with_levels}
    assert {placed.meshes[i].name for i in shown} == {"panel", "arm", "tile"}
    assert sum(len(placed.meshes[i].faces) for i in shown) == asset.triangles
    root = nodes[0]
    assert "mesh" not in root and nodes[root["children"][-1]]["name"] == "root_mesh", "its children must stay"
    assert (
        nodes[5]["extensions"]["EXT_mesh_gpu_instancing"]
        == nodes[with_levels[5][0]]["extensions"]["EXT_mesh_gpu_instancing"]
    )
    assert coarse


def grid(asset_nodes: list[dict[str, Any]], offset: float = 0.0) -> Asset:
    mesh = Mesh(files.SQUARE.astype(float) * 0.1 + offset, files.SQUARE_FACES.reshape(-1, 3).astype(int), name="m")
    return Asset("a", (mesh,), document={"nodes": asset_nodes, "scenes": [{"nodes": [0]}], "scene": 0})


def test_a_level_has_the_pose_of_its_node(tmp_path: Path) -> None:
    asset = grid([{"mesh": 0, "translation": [1, 2, 3], "rotation": [0, 0, 1, 0], "extras": {"a": 1}, "name": "n"}])
    (path,) = io.save_combined(asset, tmp_path / "a.glb", [asset.meshes, (half(asset.meshes[0]),)], [0.5, 0.1])
    fine, coarse = json_of(path)["nodes"]
    assert fine["extras"] == {"a": 1, "MSFT_screencoverage": [0.5, 0.1]}
    assert coarse == {"name": "n_LOD1", "translation": [1, 2, 3], "rotation": [0, 0, 1, 0], "mesh": 1}
    assert json_of(path)["scenes"] == [{"nodes": [0]}]


def test_animated_nodes_keep_their_motion_for_all_levels(tmp_path: Path) -> None:
    g = files.Gltf()
    g.mesh(g.square())
    output = g.array(np.zeros((1, 3), np.float32))
    sampler = {"input": g.array(np.zeros(1, np.float32)), "output": output}
    channel = {"sampler": 0, "target": {"node": 0, "path": "translation"}}
    g.tree["animations"] = [{"samplers": [sampler], "channels": [channel]}]
    asset = io.load(g.save(tmp_path / "m.glb"))
    (path,) = io.save_combined(asset, tmp_path / "a.glb", [asset.meshes, (half(asset.meshes[0]),)], [0.5, 0.1])
    mover, fine, coarse = json_of(path)["nodes"]
    assert mover == {"children": [1]} and fine["extensions"]["MSFT_lod"]["ids"] == [2] and coarse["mesh"] == 1


def test_a_level_without_faces_is_an_empty_node(tmp_path: Path, errors_of: ErrorsOf) -> None:
    asset = grid([{"mesh": 0}])
    none = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    (path,) = io.save_combined(asset, tmp_path / "a.glb", [asset.meshes, (none,)], [0.5, 0.1])
    assert json_of(path)["nodes"][1] == {"name": "node_LOD1"}
    assert errors_of([path]) == {"a.glb": []}


def test_far_levels_take_their_offset_along(tmp_path: Path) -> None:
    asset = grid([{"mesh": 0, "scale": [2, 2, 2]}], offset=3e7)
    levels = [asset.meshes, (half(asset.meshes[0]),)]
    (path,) = io.save_combined(asset, tmp_path / "a.glb", levels, [0.5, 0.1], warn=lambda text: None)
    tree = json_of(path)
    node, fine, coarse = tree["nodes"]
    assert node == {"scale": [2, 2, 2], "children": [1]}
    again = io.load(path)
    for holder in (fine, coarse):
        mesh = again.meshes[holder["mesh"]]
        world = mesh.positions + holder["translation"]
        want = asset.meshes[0].positions
        assert np.abs(world - want[: len(world)]).max() < 1e-6


def test_own_levels_are_kept(tmp_path: Path) -> None:
    g = files.Gltf()
    g.mesh(g.square())
    g.tree["nodes"] = [{"mesh": 0, "extensions": {"MSFT_lod": {"ids": [1]}}}, {"mesh": 0}]
    g.tree["extensionsUsed"] = ["MSFT_lod"]
    asset = io.load(g.save(tmp_path / "m.glb"))
    said: list[str] = []
    levels = [asset.meshes, (half(asset.meshes[0]),)]
    (path,) = io.save_combined(asset, tmp_path / "a.glb", levels, [0.5, 0.1], warn=said.append)
    assert json_of(path)["nodes"][0]["extensions"] == {"MSFT_lod": {"ids": [1]}} and "levels of its own" in said[0]


def test_coverages_must_fit(tmp_path: Path) -> None:
    asset = grid([{"mesh": 0}])
    for coverages in ([0.5], [0.5, 0.5], [0.1, 0.5], [0.5, 0.2, 0.1]):
        with pytest.raises(ValueError, match="need as many coverages, descending"):
            io.save_combined(asset, tmp_path / "a.glb", [asset.meshes, asset.meshes], coverages)


def test_pointers_of_animations_follow_the_meshes(tmp_path: Path) -> None:
    g = files.Gltf()
    g.mesh(g.square())
    g.mesh({**g.square(), "targets": [{"POSITION": g.array(files.SQUARE)}]}, weights=[0.5])
    g.tree["nodes"] = [{"mesh": 0}, {"mesh": 1}]
    pointer = {"KHR_animation_pointer": {"pointer": "/meshes/1/weights"}}
    channel = {"sampler": 0, "target": {"path": "pointer", "extensions": pointer}}
    times = g.array(np.zeros(1, np.float32))
    g.tree["animations"] = [{"samplers": [{"input": times, "output": times}], "channels": [channel]}]
    g.tree["extensionsUsed"] = ["KHR_animation_pointer"]
    asset = io.load(g.save(tmp_path / "m.glb"))
    gone = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
    (path,) = io.save(asset, tmp_path / "a.glb", meshes=(gone, asset.meshes[1]))
    assert "/meshes/0/weights" in json.dumps(json_of(path)["animations"])
