"""`--set`: what it may name, what it puts there, and what it says of mistakes."""

from __future__ import annotations

import pytest

from lodpipe.config import overrides
from lodpipe.config.load import bind
from lodpipe.config.problems import ConfigErrors
from lodpipe.config.source import Source, read_text

TEXT = "version: 1\nlods: [{ratio: 0.5}]\nstages: [export, {report: {samples: 500}}, export, recolour]\n"


def applied(*settings: str):
    return overrides.apply(read_text(TEXT, "chain.yaml"), settings).data


@pytest.mark.parametrize(
    ("setting", "path", "value"),
    [
        ("seed=7", ("seed",), 7),
        ("limits.minutes=2.5", ("limits",), {"minutes": 2.5}),
        ("lods=[{ratio: 0.1}, {error: 1}]", ("lods",), [{"ratio": 0.1}, {"error": 1}]),
        ("lods[0].ratio=0.25", ("lods", 0), {"ratio": 0.25}),
        ("report.samples=900", ("stages", 1, "report"), {"samples": 900}),
        ("report.new=[1, a]", ("stages", 1, "report"), {"samples": 500, "new": [1, "a"]}),
        ("recolour.mode=off", ("stages", 3, "recolour"), {"mode": "off"}),
        ("stages[2].formats=[obj]", ("stages", 2, "export"), {"formats": ["obj"]}),
        ("stages[2].export.formats=[obj]", ("stages", 2, "export"), {"formats": ["obj"]}),
        ("report.name='1'", ("stages", 1, "report", "name"), "1"),
        ("report.name=a=b", ("stages", 1, "report", "name"), "a=b"),
        ("report.name=", ("stages", 1, "report", "name"), None),
        ("budgets.levels.1.bytes=3", ("budgets", "levels", "1", "bytes"), 3),
    ],
)
def test_a_value_is_put_in_its_place(setting, path, value):
    data = applied(setting)
    for step in path:
        data = data[step]
    assert data == value


def test_the_later_one_wins_and_the_source_is_untouched():
    source = read_text(TEXT, "x")
    assert overrides.apply(source, ["seed=1", "seed=2"]).data["seed"] == 2
    assert source.data == read_text(TEXT, "x").data


@pytest.mark.parametrize(
    ("setting", "line"),
    [
        ("report.samples", "--set report.samples: must have the form stage.param=value"),
        (
            "raport.samples=1",
            "--set raport.samples: the configuration has no stage or key 'raport'; did you mean 'report'?",
        ),
        (
            "limit.minutes=1",
            "--set limit.minutes: the configuration has no stage or key 'limit'; did you mean 'limits'?",
        ),
        (
            "export.formats=[obj]",
            "--set export.formats: 'export' stands 2 times in the chain; say which: stages[0].formats or ",
        ),
        ("report.samples.deep=1", "--set report.samples.deep: 'samples' has no parts that could be set"),
        ("lods[1].triangles=9", "--set lods[1].triangles: there is no [1]: the list has 1 entries"),
        ("stages[9].x=1", "--set stages[9].x: there is no [9]: the list has 4 entries"),
        ("lods.ratio=1", "--set lods.ratio: 'ratio' does not fit here: a list"),
        ("seed=[1", "--set seed:1:3: is not valid YAML"),
        ("..=1", "--set ..: '..' is not a path such as decimate.metric or lods[0].ratio"),
        ("=1", "--set : '' is not a path"),
    ],
)
def test_mistakes_are_told(setting, line):
    with pytest.raises(ConfigErrors) as caught:
        applied(setting)
    assert str(caught.value).startswith(line)


def test_all_mistakes_are_told():
    with pytest.raises(ConfigErrors) as caught:
        applied("a", "b")
    assert len(str(caught.value).splitlines()) == 2


def test_a_wrong_value_is_told_with_the_setting_as_its_place():
    from lodpipe.stages.report import report

    source = overrides.apply(read_text("stages: [report]", "x"), ["report.samples=-4", "report.sampels=1"])
    with pytest.raises(ConfigErrors) as caught:
        bind(source, {"report": report})
    assert sorted(str(caught.value).splitlines()) == [
        "--set report.sampels: stages[0].report: unknown key 'sampels'; did you mean 'samples'?",
        "--set report.samples: stages[0].report.samples: must be at least 100 (got -4)",
    ]


def test_a_mapping_says_the_same():
    settings = overrides.settings_of({"report.samples": 900, "lods": [{"ratio": 0.1}], "report.name": "true"})
    data = overrides.apply(read_text(TEXT, "x"), settings).data
    assert data["stages"][1]["report"] == {"samples": 900, "name": "true"}
    assert data["lods"] == [{"ratio": 0.1}]


def test_a_configuration_given_as_data_can_be_overridden():
    assert overrides.apply(Source("config", {"stages": ["report"]}), ["report.samples=200"]).data["stages"] == [
        {"report": {"samples": 200}}
    ]
