import json

import limbs
from lodpipe.geometry.segment import segment
from lodpipe.geometry.skeleton import skeleton
from lodpipe.reporting.skeleton import skeleton_data, skeleton_text


def test_data_and_text():
    asset = limbs.asset(limbs.star(3))
    found = skeleton(asset)
    data = skeleton_data(found, segment(asset, found), 0.25)
    assert json.loads(json.dumps(data)) == data
    (part,) = data["components"]
    assert (part["ends"], part["joints"], part["cycle_rank"], part["genus"]) == (3, 1, 0, 0)
    assert sum(node["type"] == "end" for node in part["nodes"]) == 3
    assert len(part["edges"]) == len(part["nodes"]) - 1
    assert sum(s["vertices"] for s in part["segments"]) == len(asset.meshes[0].positions)
    text = skeleton_text(data)
    assert text[0].startswith("component 1: 3 ends, 1 joint, 0 loops (genus 0)")
    assert text[-1] == "geodesic, 0.25 s"
