"""The runner: what a stage is given, what comes back, and where errors are said to be."""

from __future__ import annotations

import dataclasses
import math

import pytest

from chains import asset, plugin_folder
from lodpipe.config.source import Source
from lodpipe.core.asset import ErrorFigures, Lod, Switch
from lodpipe.core.errors import InvalidMesh
from lodpipe.core.report import Report
from lodpipe.pipeline import Pipeline, StageFailed
from lodpipe.plugins import find_stages
from lodpipe.stage import Context, Params, stage


@pytest.fixture
def known(tmp_path):
    return find_stages([plugin_folder(tmp_path)], installed=False)


def pipeline(known, *stages, **rest):
    return Pipeline.load(Source("test", {"stages": list(stages), **rest}), known)


class NoParams(Params):
    """None."""


def test_a_stage_is_given_what_the_configuration_says(known, tmp_path):
    seen: list[Context] = []

    @stage("spy")
    def spy(asset, params: NoParams, context: Context):
        """Look."""
        seen.append(context)
        return asset

    chain = pipeline(known | {"spy": spy}, "spy", lods=[{"ratio": 0.5}], seed=5, threads=3)
    chain.run(asset(), tmp_path, scratch=tmp_path / "scratch")
    (context,) = seen
    assert [target.ratio for target in context.lods] == [0.5]
    assert (context.seed, context.threads, context.output) == (5, 3, tmp_path)
    assert context.rng.integers(1 << 30) == context.rng.integers(1 << 30)


def test_the_report_tells_what_happened(known):
    source = dataclasses.replace(asset(), warnings=("a hole",), format="obj")
    before = source.fingerprint()
    chain = pipeline(known, {"thin": {"say": "beware"}}, lods=[{"ratio": 0.5}, {"ratio": 0.25}])
    result, report = chain.run(source)
    assert source.fingerprint() == before
    assert [level.triangles for level in result.lods] == [12, 6, 3]
    assert report.outcome == "warnings"
    assert report.warnings == ["a hole"]
    assert (report.source["triangles"], report.source["format"]) == (12, "obj")
    (part,) = report.stages
    assert (part.name, part.params, part.warnings) == ("thin", {"say": "beware"}, ["beware"])
    assert [(m.name, m.value) for m in part.measurements] == [("levels", 3)]
    assert part.seconds > 0
    assert [(level.level, level.triangles, level.stop_reason) for level in report.lods] == [
        (0, 12, "source"),
        (1, 6, "target"),
        (2, 3, "target"),
    ]
    assert report.lods[1].target == {"ratio": 0.5}
    assert report.lods[1].error is None


def test_without_levels_the_report_lists_the_source(known):
    result, report = pipeline(known, "thin").run(asset())
    assert [level.level for level in report.lods] == [0]
    assert report.outcome == "ok"
    assert result.lods[0].triangles == 12


def test_progress_is_told_by_stage(known):
    told = []
    pipeline(known, "thin", lods=[{"ratio": 0.5}]).run(
        asset(), progress=lambda index, name, share: told.append((index, name, share))
    )
    assert told == [(0, "thin", 0.0), (0, "thin", 1.0), (0, "thin", 1.0)]


def test_an_error_comes_with_asset_and_stage_and_the_report_so_far(known):
    report = Report("")
    with pytest.raises(InvalidMesh) as caught:
        pipeline(known, "thin", "fail").run(asset(), report=report)
    assert str(caught.value) == "box: fail: meshes[0]: two and two is five; count again"
    assert [part.name for part in report.stages] == ["thin", "fail"]


def test_a_bug_is_told_apart(known):
    with pytest.raises(StageFailed, match="box: fail: TypeError: a bug on purpose") as caught:
        pipeline(known, {"fail": {"how": "bug"}}).run(asset())
    assert isinstance(caught.value.error, TypeError)


def test_the_resolved_configuration_makes_the_same_pipeline(known):
    chain = pipeline(known, {"thin": {"say": "x"}}, "export", lods=[{"error": 1}])
    assert Pipeline.load(Source("again", chain.resolved()), known) == chain


def measured(mean: float, largest: float):
    @stage("measured")
    def give(asset, params: NoParams, context: Context):
        """Give figures."""
        levels = [Lod(asset.meshes), Lod(asset.meshes, error=ErrorFigures(mean, mean, largest), switch=Switch(0.5, 2))]
        return dataclasses.replace(asset, lods=tuple(levels))

    return {"measured": give}


@pytest.mark.parametrize(
    ("budget", "ok"),
    [
        ({"levels": {"1": {"max_error": 2}}}, True),
        ({"levels": {"1": {"max_error": 1.9}}}, False),
        ({"levels": {"1": {"mean_error": 1, "rms_error": 1, "triangles": 12, "vertices": 8}}}, True),
        ({"levels": {"1": {"triangles": 11}}}, False),
        ({"levels": {"0": {"triangles": 12}}}, True),
        ({"levels": {"0": {"max_error": 5}}}, False),
        ({"levels": {"7": {"triangles": 5}}}, False),
    ],
)
def test_budgets_decide_the_outcome(budget, ok):
    _, report = pipeline(measured(1.0, 2.0), "measured", budgets=budget).run(asset())
    assert report.outcome == ("ok" if ok else "over_budget")
    assert all(entry["ok"] for entry in report.budgets) is ok
    assert all(entry["value"] is not None or entry["value_reason"] for entry in report.budgets)


def test_a_figure_that_is_no_number_is_over_any_budget():
    chain = pipeline(measured(math.nan, math.inf), "measured", budgets={"levels": {"1": {"mean_error": 5}}})
    assert chain.run(asset())[1].outcome == "over_budget"


def test_error_and_switch_are_in_the_report():
    _, report = pipeline(measured(1.0, 2.0), "measured").run(asset())
    assert report.lods[1].error == {
        "unit": "percent_of_diagonal",
        "mean": 1.0,
        "rms": 1.0,
        "max": 2.0,
        "normal_degrees": None,
    }
    assert report.lods[1].switch == {"screen_coverage": 0.5, "distance": 2}
