"""`export`: which files are written where, and what the asset knows afterwards."""

from __future__ import annotations

import dataclasses
import json
import struct

import pytest
from pydantic import ValidationError

from chains import asset
from lodpipe import io
from lodpipe.core.asset import Lod
from lodpipe.core.errors import Cancelled, OutputError
from lodpipe.stage import Context
from lodpipe.stages.export import ExportParams, export


def levels():
    source = asset()
    (mesh,) = source.meshes
    coarse = dataclasses.replace(
        mesh, faces=mesh.faces[:6], wedges=mesh.wedges[:6], face_primitive=mesh.face_primitive[:6]
    )
    return dataclasses.replace(source, lods=(Lod((mesh,)), Lod((coarse,), estimate=0.5)))


def names(context: Context) -> list[str]:
    return sorted(path.relative_to(context.output).as_posix() for path in context.output.rglob("*") if path.is_file())


def test_each_level_in_each_format(tmp_path):
    told = []
    context = Context(output=tmp_path, progress=lambda done, total: told.append(done / total))
    export(levels(), ExportParams(formats=("glb", "stl", "glb")), context)
    assert told == [0.25, 0.5, 0.75, 1.0]
    assert names(context) == [f"LOD{n}/box_LOD{n}.{kind}" for n in (0, 1) for kind in ("glb", "stl")]
    assert {n: [path.as_posix() for path in paths] for n, paths in context.files.items()} == {
        0: ["LOD0/box_LOD0.glb", "LOD0/box_LOD0.stl"],
        1: ["LOD1/box_LOD1.glb", "LOD1/box_LOD1.stl"],
    }
    assert [io.load(tmp_path / f"LOD{n}" / f"box_LOD{n}.glb").triangles for n in (0, 1)] == [12, 6]


def test_without_levels_the_source_is_level_0(tmp_path):
    context = Context(output=tmp_path)
    export(asset(), ExportParams(), context)
    assert names(context) == ["LOD0/box_LOD0.glb"]


@pytest.mark.parametrize("kind", io.FORMATS)
def test_every_format_can_be_read_again(tmp_path, kind):
    export(levels(), ExportParams(formats=(kind.lstrip("."),)), Context(output=tmp_path))
    assert io.load(tmp_path / "LOD1" / f"box_LOD1{kind}").triangles == 6


def test_combined_has_all_levels_with_their_coverages(tmp_path):
    context = Context(output=tmp_path)
    result = export(levels(), ExportParams(combined=True), context)
    assert [path.as_posix() for path in context.files[-1]] == ["box.glb"]
    data = (tmp_path / "box.glb").read_bytes()
    tree = json.loads(data[20 : 20 + struct.unpack("<I", data[12:16])[0]])
    (node,) = [node for node in tree["nodes"] if "MSFT_lod" in node.get("extensions", {})]
    assert len(node["extensions"]["MSFT_lod"]["ids"]) == 1
    assert node["extras"]["MSFT_screencoverage"] == pytest.approx([result.lods[1].switch.screen_coverage, 0.0])


def test_what_a_format_cannot_hold_is_warned_of_once(tmp_path):
    source = dataclasses.replace(levels(), document={"skins": [{}]})
    context = Context(output=tmp_path)
    export(source, ExportParams(formats=("stl",)), context)
    assert context.warnings == ["STL has no place for skins; left out"]


def test_the_input_is_unchanged(tmp_path):
    source = levels()
    before = source.fingerprint()
    export(source, ExportParams(combined=True), Context(output=tmp_path))
    assert source.fingerprint() == before


def test_progress_reaches_the_end(tmp_path):
    told = []
    context = Context(output=tmp_path, progress=lambda done, total: told.append((done, total)))
    export(levels(), ExportParams(combined=True), context)
    assert told == [(1, 3), (2, 3), (3, 3)]


def test_it_can_be_cancelled(tmp_path):
    context = Context(output=tmp_path, cancelled=lambda: True)
    with pytest.raises(Cancelled):
        export(levels(), ExportParams(), context)
    assert names(context) == []


def test_without_a_folder_it_is_refused():
    with pytest.raises(OutputError, match="there is no folder to write into; give one, or leave `export` out"):
        export(asset(), ExportParams(), Context())


@pytest.mark.parametrize("formats", [(), ("fbx",), ("GLB",)])
def test_other_formats_are_refused(formats):
    with pytest.raises(ValidationError):
        ExportParams(formats=formats)
