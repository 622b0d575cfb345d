import dataclasses

import numpy as np
import pytest

import limbs
from lodpipe.core.asset import Target
from lodpipe.geometry.decimate import decimate_asset
from lodpipe.geometry.extreme import NEAR, strength_at
from lodpipe.geometry.importance import ImportanceOptions, importance
from lodpipe.geometry.segment import segment
from lodpipe.geometry.skeleton import skeleton


def shaped(mesh, **options):
    asset = limbs.asset(mesh)
    asset = dataclasses.replace(asset, skeleton=skeleton(asset))
    asset = dataclasses.replace(asset, segments=segment(asset, asset.skeleton))
    return dataclasses.replace(asset, importance=importance(asset, ImportanceOptions(**options)))


def lost(asset, level):
    tips = asset.meshes[0].positions[asset.importance.reserved[:, 0]]
    away = np.linalg.norm(tips[:, None] - level.meshes[0].positions[None], axis=2).min(axis=1)
    return int((away > NEAR * np.linalg.norm(np.ptp(asset.meshes[0].positions, axis=0))).sum())


def test_the_skeleton_counts_more_the_fewer_triangles_there_are():
    shares = [strength_at(t, 100_000, 5) for t in (10, 120, 200, 300, 400, 20_000)]
    assert shares[0] == shares[1] == 1
    assert shares == sorted(shares, reverse=True)
    assert shares[-2:] == [0, 0]
    assert strength_at(30, 300, 5) == 0  # a tenth of the source: plain
    assert strength_at(10, 100_000, 0) == 0


def test_arms_survive_where_plain_decimation_loses_them():
    asset = shaped(limbs.star(6, radius=0.08))
    goals = [Target(triangles=40), Target(triangles=24)]
    plain = decimate_asset(dataclasses.replace(asset, importance=None), goals)
    better = decimate_asset(asset, goals)
    for one, other in zip(plain[1:], better[1:], strict=True):
        assert other.triangles <= one.target.triangles
        assert lost(asset, one) > 0
        assert lost(asset, other) == 0


def test_moderate_levels_are_the_plain_ones():
    asset = shaped(limbs.star(3))
    goals = [Target(ratio=0.5), Target(ratio=0.1)]
    plain = decimate_asset(dataclasses.replace(asset, importance=None), goals)
    better = decimate_asset(asset, goals)
    for one, other in zip(plain[1:], better[1:], strict=True):
        assert one.meshes[0].fingerprint() == other.meshes[0].fingerprint()


def test_strength_zero_is_plain():
    asset = shaped(limbs.star(4), strength=0.0)
    plain = decimate_asset(dataclasses.replace(asset, importance=None), [Target(triangles=20)])
    assert plain[1].meshes[0].fingerprint() == decimate_asset(asset, [Target(triangles=20)])[1].meshes[0].fingerprint()


def test_same_bytes_for_any_threads():
    asset = shaped(limbs.star(4))
    one, two = (decimate_asset(asset, [Target(triangles=20)], threads=n)[1].meshes[0] for n in (1, 2))
    assert one.fingerprint() == two.fingerprint()


@pytest.mark.parametrize("way", ["quadric", "visual"])
def test_painted_weights_keep_triangles(way):
    mesh = limbs.star(2)
    weight = np.where(mesh.positions[:, 0] > 0, 100.0, 1.0)
    asset = limbs.asset(mesh)
    plain = decimate_asset(asset, [Target(ratio=0.2)], metric=way)[1].meshes[0]
    held = dataclasses.replace(importance(asset), weight=(weight.astype(np.float32),))
    kept = decimate_asset(dataclasses.replace(asset, importance=held), [Target(ratio=0.2)], metric=way)[1].meshes[0]

    def right(m):
        return int((m.positions[:, 0] > 0).sum())

    assert right(kept) > 1.3 * right(plain)
