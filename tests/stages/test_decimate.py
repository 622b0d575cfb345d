"""The stage: parameters to options, figures and warnings into the report."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from pydantic import ValidationError

from lodpipe.core.asset import Asset, Target
from lodpipe.core.errors import Cancelled
from lodpipe.core.material import Image, Material
from lodpipe.core.mesh import Mesh
from lodpipe.core.skeleton import Importance
from lodpipe.geometry.joined import AttributeWeights
from lodpipe.kernel import QuadricOptions
from lodpipe.stage import Context
from lodpipe.stages.decimate import REASONS, DecimateParams, decimate
from meshes import bumpy, cubes, islands, torus, uv_sphere

HALF = (Target(ratio=0.5), Target(triangles=100))


def run(*meshes, lods=HALF, context=None, **params):
    context = context or Context(lods=lods, threads=1)
    context.lods = lods
    return decimate(Asset(name="a", meshes=meshes), DecimateParams(**params), context), context


def test_one_level_for_each_target_and_the_source():
    asset, context = run(Mesh(*bumpy(3)))
    assert [level.triangles for level in asset.lods] == [512, 256, 100]
    assert asset.lods[0].meshes == asset.meshes and asset.lods[0].stop_reason == "source"
    assert [level.stop_reason for level in asset.lods[1:]] == ["target", "target"]
    assert [(m.name, m.value) for m in context.measurements] == [("lod1.triangles", 256), ("lod2.triangles", 100)]
    assert context.warnings == []


def test_defaults_are_the_kernel_s():
    """Each default stands in one place."""
    params, options, weights = DecimateParams(), QuadricOptions(), AttributeWeights()
    shared = {f.name for f in dataclasses.fields(options)} & set(DecimateParams.model_fields)
    assert {name: getattr(params, name) for name in shared} == {name: getattr(options, name) for name in shared}
    assert params.attributes == options.attribute_cost
    assert (params.uv_weight, params.normal_weight, params.color_weight) == (weights.uv, weights.normal, weights.color)


def test_half_edge_collapses_keep_vertices_of_the_source():
    source = Mesh(*bumpy(3))
    asset, _ = run(source, collapse="half")
    known = {row.tobytes() for row in source.positions}
    assert all(row.tobytes() in known for row in asset.lods[2].meshes[0].positions)


@pytest.mark.parametrize(
    "params",
    [
        {"placement": "midpoint"},
        {"collapse": "half"},
        {"weighting": "uniform"},
        {"attributes": not DecimateParams().attributes},
        {"attributes": True, "uv_weight": 5.0},
        {"attributes": True, "normal_weight": 5.0},
        {"attributes": True, "color_weight": 5.0},
        {"boundary_weight": 0.0},
        {"seam_weight": 40.0},
        {"crease_weight": 40.0, "crease_degrees": 3.0},
        {"round_share": 1.0},
    ],
    ids=str,
)
def test_each_parameter_reaches_the_kernel(params):
    ball = uv_sphere(12, 24)
    rough = ball.positions * (1 + 0.05 * np.random.default_rng(0).random((len(ball.positions), 1)))
    open_ball = dataclasses.replace(
        ball,
        positions=rough,
        faces=ball.faces[30:],
        wedges=ball.wedges[30:],
        face_primitive=ball.face_primitive[30:],
    ).mesh()
    base = {"attributes": True} if len(params) > 1 and "attributes" in params else {}
    plain, other = (
        run(open_ball, **chosen)[0].lods[2].meshes[0].fingerprint() for chosen in (base, {**base, **params})
    )
    assert plain != other


def test_topology_that_is_given_up_is_reported():
    few = (Target(triangles=8),)
    asset, context = run(Mesh(*torus()), lods=few, keep_topology=True, may_relax=True)
    assert asset.lods[1].relaxed and asset.lods[1].triangles <= 8
    assert context.warnings == ["level 1 could only be reached by changing the topology"]
    asset, context = run(Mesh(*torus()), lods=few, keep_topology=True, may_relax=False)
    assert asset.lods[1].stop_reason == "topology" and not asset.lods[1].relaxed
    assert context.warnings == [f"level 1 stopped at {asset.lods[1].triangles} triangles: {REASONS['topology']}"]


def test_a_target_that_cannot_be_reached_is_a_warning_not_an_error():
    asset, context = run(islands(*bumpy(3)).mesh(), collapse="half")
    assert asset.lods[2].triangles > 100 and asset.lods[2].stop_reason != "target"
    assert len(context.warnings) == 2 and context.warnings[1].startswith("level 2 stopped at")


def test_meshes_that_are_kept_are_named():
    kept = Mesh(*bumpy(2), name="arm", keep_reason="it is skinned")
    asset, context = run(kept, Mesh(*bumpy(3)))
    assert all(level.meshes[0] is kept for level in asset.lods)
    assert context.warnings[0] == "mesh 'arm' is not simplified: it is skinned"


def test_a_pair_distance_is_a_share_of_the_diagonal():
    """The gaps between the cubes, 0.2, are 1.5 % of the grid's diagonal."""
    grid = Mesh(*cubes(10, 0.2))
    alone, joined = (
        run(grid, lods=(Target(triangles=1100),), keep_topology=False, pair_distance=percent)[0].lods[1].meshes[0]
        for percent in (1.0, 2.0)
    )

    def reach(mesh):
        cube = np.rint(mesh.positions[mesh.faces][..., :2])
        return int((cube != cube[:, :1]).any(axis=(1, 2)).sum())

    assert reach(alone) == 0 < reach(joined)


def test_cancelling_comes_through():
    with pytest.raises(Cancelled):
        run(Mesh(*bumpy(3)), context=Context(cancelled=lambda: True))


@pytest.mark.parametrize(
    "params",
    [
        {"boundary_weight": -1},
        {"crease_degrees": 181},
        {"round_share": 0},
        {"round_share": 1.1},
        {"pair_distance": 101},
        {"collapse": "quarter"},
        {"no_such": 1},
    ],
)
def test_parameters_out_of_range_are_refused(params):
    with pytest.raises(ValidationError):
        DecimateParams(**params)


def test_ray_metrics_reach_their_kernel():
    ball = uv_sphere(12, 16).mesh()
    made = {}
    for metric in ("ray", "texture_deviation", "image"):
        asset, context = run(ball, metric=metric, collapse="half", image_size=32, views=4)
        assert [level.triangles for level in asset.lods[1:]] == [len(ball.faces) // 2, 100]
        assert context.warnings == []
        made[metric] = asset.lods[2].meshes[0].fingerprint()
    for change in (
        {"reference": "previous"},
        {"correspondence": "uv"},
        {"views": 5},
        {"penalty": "view"},
        {"spacing": 0.5},
    ):
        asset, _ = run(ball, metric="ray", collapse="half", **{"views": 4, **change})
        made[str(change)] = asset.lods[2].meshes[0].fingerprint()
    assert len(set(made.values())) == len(made)


def test_pins_that_a_ray_metric_does_not_know_are_told():
    ball = Mesh(*bumpy(2))
    ones, none = (np.ones(len(ball.positions), np.float32),), np.zeros((0, 3), np.int32)
    pinned = (np.ones(len(ball.positions), bool),)
    asset = Asset("ball", (ball,), importance=Importance(ones, ones, none, none[:, 0], pinned=pinned))
    for metric, expected in (("ray", 1), ("quadric", 0)):
        context = Context(lods=HALF)
        decimate(asset, DecimateParams(metric=metric, views=2), context)
        assert sum("pinned parts" in text for text in context.warnings) == expected


def test_a_missing_texture_is_told_and_its_factor_stands_in():
    texture = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "baseColorFactor": [0.5, 0.5, 0.5, 1.0]}}
    asset = Asset(
        "a",
        (uv_sphere(12, 16).mesh(),),
        (Material(texture),),
        (Image(problem="skin.png is missing"),),
        {"textures": [{"source": 0}], "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}], "scene": 0},
    )
    context = Context(lods=(Target(triangles=50),), threads=1)
    made = decimate(asset, DecimateParams(metric="ray", views=3), context)
    assert made.lods[1].triangles == 50
    assert context.warnings == ["skin.png is missing: the material's factor colour stands in for it"]
