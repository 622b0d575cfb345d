"""What each option and array does, what stops a level, and what is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lodpipe import kernel
from lodpipe.core.errors import InvalidMesh
from lodpipe.kernel import PLACEMENTS, edge_costs
from measures import areas
from meshes import bumpy, grid, islands, sphere, terrain, torus, uv_sphere
from options import SET, options

WEIGHTS = [0.1] * 2 + [0.05] * 3 + [0.1] * 4  # of a uv_sphere's columns


def decimate(positions, faces, targets, setting=SET, **arrays):
    return kernel.decimate(positions, faces, targets, setting, **arrays)


def textured(sphere):
    return {"wedges": sphere.wedges, "values": sphere.values, "column_weights": WEIGHTS}


# --------------------------------------------------------------------------------------------------------- placement


def test_endpoint_placement_keeps_only_what_was_there():
    ball = uv_sphere(16, 24, materials=2)
    setting = options(placement="endpoint")
    level = decimate(ball.positions, ball.faces, [100], setting, **textured(ball)).levels[0]
    assert len(level.faces) <= 100
    assert (level.vertex_source >= 0).all() and (level.wedge_source >= 0).all()
    assert level.positions.tobytes() == ball.positions[level.vertex_source].tobytes()
    assert level.values.tobytes() == ball.values[level.wedge_source].tobytes()
    # a wedge still belongs to the position and the primitive that it belonged to
    belongs = dict(zip(ball.wedges.ravel(), ball.faces.ravel(), strict=True))
    assert [belongs[w] for w in level.wedge_source[level.wedges].ravel()] == list(
        level.vertex_source[level.faces].ravel()
    )
    primitive = dict(zip(ball.wedges.ravel(), np.repeat(ball.face_primitive, 3), strict=True))
    for corner in range(3):
        sources = level.wedge_source[level.wedges[:, corner]]
        assert [primitive[w] for w in sources] == list(ball.face_primitive[level.face_source])


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_what_was_not_moved_is_the_same_to_the_last_bit(placement):
    ball = uv_sphere(16, 24)
    positions = ball.positions / 3 + 1e5  # not representable in 32 bits
    level = decimate(positions, ball.faces, [500], options(placement=placement), **textured(ball)).levels[0]
    kept, wedges = level.vertex_source >= 0, level.wedge_source >= 0
    assert kept.sum() > 50 and wedges.sum() > 50
    assert level.positions[kept].tobytes() == positions[level.vertex_source[kept]].tobytes()
    assert level.values[wedges].tobytes() == ball.values[level.wedge_source[wedges]].tobytes()


def test_midpoint_placement_lies_in_the_middle():
    positions, faces = bumpy(2)
    setting = options(placement="midpoint", record=True)
    record = decimate(positions, faces, [len(faces) - 2], setting).record
    assert record is not None and len(record.removed) == 1
    middle = (positions[record.removed[0]] + positions[record.kept[0]]) / 2
    assert record.positions[0] == pytest.approx(middle, abs=1e-6)


# ------------------------------------------------------------------------------------------------------------ targets


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_targets_are_met_from_one_pass(placement):
    positions, faces = bumpy(4)
    goals = [2047, 1500, 1024, 700, 699, 333, 100, 51, 8]
    levels = decimate(positions, faces, goals, options(placement=placement)).levels
    assert [level.target for level in levels] == goals
    for level in levels:
        assert level.stop == "triangles" and level.target - 1 <= len(level.faces) <= level.target


def test_a_level_does_not_depend_on_those_below_it():
    positions, faces = bumpy(4)
    alone, first = (decimate(positions, faces, goals).levels[0] for goals in ([500], [500, 100, 20]))
    assert alone.positions.tobytes() == first.positions.tobytes() and alone.faces.tobytes() == first.faces.tobytes()


def test_targets_at_the_ends():
    positions, faces = bumpy(2)
    whole, none = decimate(positions, faces, [len(faces) + 7, 0]).levels
    assert len(whole.faces) == len(faces) and (whole.vertex_source >= 0).all() and whole.error == 0
    assert len(none.faces) == len(none.positions) == 0 and none.stop == "triangles"
    last = decimate(positions, faces, [0], options(keep_last=True)).levels[0]
    assert len(last.faces) == 4 and last.stop == "last"
    assert decimate(positions, faces, []).levels == []


def test_a_mesh_without_faces():
    level = decimate(np.zeros((5, 3)), np.zeros((0, 3), np.int32), [10]).levels[0]
    assert level.faces.shape == (0, 3) and level.positions.shape == (0, 3) and level.stop == "triangles"
    assert len(decimate(np.zeros((0, 3)), np.zeros((0, 3), np.int32), [0]).levels[0].faces) == 0
    assert edge_costs(np.zeros((0, 3)), np.zeros((0, 3), np.int32)).edges.shape == (0, 2)


# ------------------------------------------------------------------------------------------------- what stops a level


def test_stopped_by_the_topology():
    level = decimate(*torus(), [8], options(may_relax=False)).levels[0]
    assert level.stop == "topology" and len(level.faces) > 8


def test_stopped_by_flips():
    level = decimate(*bumpy(3, 0.3), [50], options(flip_degrees=4.0, may_relax=False)).levels[0]
    assert level.stop == "flip" and len(level.faces) > 50


def test_stopped_by_the_error():
    positions, faces = bumpy(4)
    sizes = []
    for limit in (1e-4, 1e-3, 1e-2, 5e-2):
        level = decimate(positions, faces, [8], options(max_error=limit)).levels[0]
        assert level.stop == "error" and level.error <= limit
        sizes.append(len(level.faces))
    assert sizes == sorted(sizes, reverse=True) and sizes[0] > 4 * sizes[-1]
    assert decimate(positions, faces, [8], options(max_error=10.0)).levels[0].stop == "triangles"


def test_an_error_of_zero_still_takes_what_is_flat():
    positions, faces = grid(8)
    level = decimate(positions, faces, [2], options(max_error=1e-4, boundary_weight=10)).levels[0]
    assert len(level.faces) < 20
    rough = positions + [0, 0, 0.1] * np.random.default_rng(0).random((len(positions), 1))
    assert len(decimate(rough, faces, [2], options(max_error=1e-4)).levels[0].faces) > 0.9 * len(faces)


def test_islands_cannot_be_crossed_by_half_edges_but_otherwise_they_can():
    patchwork = islands(*bumpy())
    arrays = {"wedges": patchwork.wedges, "values": patchwork.values, "column_weights": [0.1, 0.1]}
    for placement, reached in (("endpoint", False), ("optimal", True), ("midpoint", True)):
        setting = options(placement=placement)
        level = decimate(patchwork.positions, patchwork.faces, [50], setting, **arrays).levels[0]
        assert (len(level.faces) <= 50) == (level.stop == "triangles") == reached, placement


# -------------------------------------------------------------------------------------------- importance and locks


def test_importance_keeps_a_region_finer():
    positions, faces = sphere(5)
    protected = positions[:, 0] > 0

    def share(importance):
        level = decimate(positions, faces, [400], importance=importance).levels[0]
        return float((level.positions[level.faces].mean(axis=1)[:, 0] > 0).mean())

    assert share(None) == pytest.approx(0.5, abs=0.05)
    assert share(np.ones(len(positions), np.float32)) == pytest.approx(0.5, abs=0.05)
    assert share(np.where(protected, 100.0, 1.0).astype(np.float32)) > 0.75


def test_importance_of_the_same_everywhere_changes_nothing():
    positions, faces = bumpy(3)
    plain, four = (decimate(positions, faces, [100], importance=i).levels[0] for i in (None, np.full(258, 4.0)))
    assert plain.positions.tobytes() == four.positions.tobytes()


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_locked_vertices_stay(placement):
    positions, faces = terrain()
    rim = (positions[:, :2] == 0).any(axis=1) | (positions[:, :2] == 1).any(axis=1)
    level = decimate(positions, faces, [40], options(placement=placement), locked=rim).levels[0]
    assert len(level.faces) < 150  # 64 edges round it need at least 62
    assert set(np.flatnonzero(rim)) <= set(level.vertex_source)


def test_a_mesh_of_locked_vertices_is_not_touched():
    positions, faces = bumpy(2)
    level = decimate(positions, faces, [4], locked=np.ones(len(positions), bool)).levels[0]
    assert len(level.faces) == len(faces) and level.stop != "triangles"
    assert np.array_equal(np.sort(level.vertex_source), np.arange(len(positions)))


# ---------------------------------------------------------------------------------------------------------- progress


def test_progress_rises_and_can_stop_the_work():
    positions, faces = bumpy(4)
    calls: list[tuple[int, int]] = []
    decimate(positions, faces, [1000, 100], progress=lambda done, total: calls.append((done, total)) or True)
    done, totals = zip(*calls, strict=True)
    assert list(done) == sorted(done) and done[0] == 0 and set(totals) == {len(faces) - 100}

    seen = []
    cancelled = decimate(positions, faces, [1000, 100], progress=lambda done, total: seen.append(0) or len(seen) < 3)
    assert [level.stop for level in cancelled.levels] == ["cancelled", "cancelled"]
    assert 1000 < len(cancelled.levels[0].faces) < len(faces) and len(seen) == 3


def test_an_exception_in_progress_comes_out():
    def explode(done, total):
        raise KeyError("from the caller")

    with pytest.raises(KeyError, match="from the caller"):
        decimate(*bumpy(3), [10], progress=explode)


# --------------------------------------------------------------------------------------------------- what is refused

GOOD = bumpy(1)
NAN = np.where(np.arange(GOOD[0].size).reshape(GOOD[0].shape) == 4, np.nan, GOOD[0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"positions": NAN}, "positions are not finite"),
        ({"positions": np.where(np.isnan(NAN), np.inf, NAN)}, "positions are not finite"),
        ({"positions": np.zeros((5, 2))}, "positions must be a table of 3 columns"),
        ({"faces": GOOD[1] + 1}, "faces point outside"),
        ({"faces": GOOD[1] - 1}, "faces point outside"),
        ({"faces": GOOD[1].astype(float)}, "faces must be integers"),
        ({"faces": GOOD[1].ravel()}, "faces must be a table"),
        ({"wedges": GOOD[1][1:]}, "faces and 31 rows of wedges"),
        ({"wedges": GOOD[1], "values": np.zeros((3, 1), np.float32), "column_weights": [1]}, "wedges point outside"),
        ({"values": np.full((18, 1), np.nan, np.float32), "column_weights": [1]}, "attribute values are not finite"),
        ({"values": np.zeros((18, 2), np.float32), "column_weights": [1]}, "2 attribute columns and 1 weights"),
        ({"values": np.zeros((18, 1), np.float32), "column_weights": [-1]}, "must be finite and not negative"),
        ({"values": np.zeros((18, 1), np.float32), "column_weights": [np.nan]}, "must be finite and not negative"),
        ({"importance": np.ones(17)}, "importance must have 18 values"),
        ({"importance": np.zeros(18)}, "importance must be finite and positive"),
        ({"importance": np.full(18, np.inf)}, "importance must be finite and positive"),
        ({"locked": np.ones(4, bool)}, "locked must have 18 values"),
        ({"targets": [10, 20]}, "targets must be descending"),
        ({"targets": [-1]}, "targets must be descending and not negative"),
        ({"options": options(chart_column=0)}, "chart_column 0 needs two columns"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(change, message):
    arguments = {"positions": GOOD[0], "faces": GOOD[1], "targets": [8], **change}
    with pytest.raises(InvalidMesh, match=message):
        kernel.decimate(**arguments)


@pytest.mark.parametrize(
    "changes",
    [
        {"placement": "best"},
        {"weighting": "none"},
        {"boundary_weight": -1.0},
        {"seam_weight": float("nan")},
        {"crease_weight": float("inf")},
        {"crease_degrees": 181.0},
        {"flip_degrees": -1.0},
        {"pair_distance": float("nan")},
        {"round_share": 1.5},
        {"max_error": -0.1},
    ],
    ids=str,
)
def test_options_out_of_range_are_refused(changes):
    with pytest.raises(InvalidMesh, match=next(iter(changes))):
        decimate(*bumpy(1), [8], options(**changes))


def test_a_negative_number_of_threads_is_refused():
    with pytest.raises(InvalidMesh, match="threads"):
        decimate(*bumpy(1), [8], options(), threads=-1)


def test_a_wedge_of_two_positions_is_refused():
    """It cannot have one best value: what came out was not a number."""
    positions, faces = bumpy(2)
    arrays = {"values": np.zeros((2, 1), np.float32), "column_weights": [0.1]}
    with pytest.raises(InvalidMesh, match="wedge"):
        decimate(positions, faces, [40], options(), wedges=np.zeros_like(faces), **arrays)


def test_index_arrays_of_other_widths_are_taken():
    expected = decimate(*GOOD, [8]).levels[0]
    for dtype in (np.int64, np.uint32, np.uint8):
        assert decimate(GOOD[0], GOOD[1].astype(dtype), [8]).levels[0].faces.tobytes() == expected.faces.tobytes()
    assert (
        decimate(np.asfortranarray(GOOD[0]), GOOD[1][:, :], [8]).levels[0].faces.tobytes() == expected.faces.tobytes()
    )


def test_the_input_is_not_changed_even_if_it_could_be():
    ball = uv_sphere(12, 16)
    arrays = {**textured(ball), "importance": np.ones(len(ball.positions), np.float32)}
    arrays["locked"] = np.zeros(len(ball.positions), bool)
    given = [ball.positions, ball.faces, *(a for a in arrays.values() if isinstance(a, np.ndarray))]
    before = [a.copy() for a in given]
    for placement in PLACEMENTS:
        decimate(ball.positions, ball.faces, [50, 20], options(placement=placement, record=True), **arrays)
    assert all(a.tobytes() == b.tobytes() for a, b in zip(given, before, strict=True))
    for array in given:
        array.flags.writeable = False
    assert len(decimate(ball.positions, ball.faces, [50], **arrays).levels[0].faces) <= 50


def test_attributes_steer_only_when_they_should():
    """A texture that is bent over a flat square keeps vertices where it is bent, unless it is told not to."""
    positions, faces = grid(16)
    u = np.where(positions[:, 0] < 0.5, positions[:, 0] ** 2 * 8, 2.0)
    arrays = {"values": u[:, None].astype(np.float32), "column_weights": [1.0]}
    steered = decimate(positions, faces, [100], **arrays).levels[0]
    left = steered.positions[steered.faces].mean(axis=1)[:, 0] < 0.5
    assert left.mean() > 0.7
    free = decimate(positions, faces, [100], options(attribute_cost=False), **arrays).levels[0]
    alone = decimate(positions, faces, [100]).levels[0]
    assert (alone.positions[alone.faces].mean(axis=1)[:, 0] < 0.5).mean() < 0.6
    assert free.positions.tobytes() == alone.positions.tobytes() and free.values.shape == (len(free.positions), 1)
    weightless = decimate(positions, faces, [100], **{**arrays, "column_weights": [0.0]}).levels[0]
    assert weightless.values.tobytes() == free.values.tobytes()


def test_carried_attributes_follow_the_surface():
    """An attribute that is linear in space stays so, to 32 bits, though it has no share in the cost."""
    positions, faces = grid(16)
    values = (positions @ [[1.0, -2.0], [3.0, 0.5], [0.0, 0.0]]).astype(np.float32)
    level = decimate(positions, faces, [40], values=values, column_weights=[0.0, 1.0]).levels[0]
    found = level.positions[level.faces] @ [[1.0, -2.0], [3.0, 0.5], [0.0, 0.0]]
    assert level.values[level.wedges] == pytest.approx(found, abs=1e-4)


def test_every_option_does_something():
    """Each field changes the result of this mesh; `record`, `follow` and `pair_distance` have tests of their own."""
    ball = uv_sphere(12, 16)
    positions = ball.positions * (1 + 0.1 * np.random.default_rng(0).random((len(ball.positions), 1)))
    faces, wedges = ball.faces[20:], ball.wedges[20:]
    base = options(crease_degrees=20.0, round_share=0.1)
    other = {
        "placement": "midpoint",
        "weighting": "uniform",
        "boundary_weight": 0.0,
        "seam_weight": 50.0,
        "crease_weight": 50.0,
        "crease_degrees": 170.0,
        "attribute_cost": False,
        "keep_topology": False,
        "may_relax": False,
        "flip_degrees": 20.0,
        "round_share": 0.9,
        "max_error": 0.01,
        "keep_last": True,
        "chart_column": 0,
    }
    fields = {field.name for field in dataclasses.fields(SET)}
    assert fields == {*other, "record", "follow", "pair_distance"}

    def run(setting):
        level = decimate(
            positions, faces, [40, 0], setting, wedges=wedges, values=ball.values, column_weights=WEIGHTS
        ).levels
        return [(one.positions.tobytes(), one.values.tobytes(), one.stop, one.relaxed) for one in level]

    plain = run(base)
    assert [name for name, value in other.items() if run(dataclasses.replace(base, **{name: value})) == plain] == []


def test_faces_sources_tell_where_a_face_came_from():
    positions, faces = bumpy(3)
    level = decimate(positions, faces, [100]).levels[0]
    assert len(set(level.face_source)) == len(level.faces) == 100
    assert areas(level.positions, level.faces).min() > 0
    unmoved = level.vertex_source[level.faces]
    rows, corners = np.nonzero(unmoved >= 0)
    # a corner that was never moved is a corner of a face that stood at the original vertex, or was drawn to it
    assert set(unmoved[rows, corners]) <= set(range(len(positions)))
