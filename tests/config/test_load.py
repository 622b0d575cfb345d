"""Every kind of mistake in a configuration: its line, its words, all of them at once."""

from __future__ import annotations

from typing import Annotated, Literal

import pytest
from pydantic import Field

from lodpipe.config.load import bind, resolved
from lodpipe.config.problems import ConfigErrors
from lodpipe.config.source import Source, read_text
from lodpipe.core.asset import Asset, Target
from lodpipe.stage import Context, Params, stage


class CutParams(Params):
    """Parameters of `cut`."""

    ratios: tuple[Annotated[float, Field(lt=1)], ...] = ()
    """Shares."""
    mode: Literal["full", "half"] = "full"
    """Which."""
    count: int = 1
    """How many."""
    size: Literal["auto"] | int = "auto"
    """How large."""
    deep: bool = False
    """Whether."""


@stage("cut")
def cut(asset: Asset, params: CutParams, context: Context) -> Asset:
    """Cut."""
    return asset


class NeedyParams(Params):
    """Parameters of `needy`."""

    must: int
    """Has no default."""


@stage("needy")
def needy(asset: Asset, params: NeedyParams, context: Context) -> Asset:
    """Need."""
    return asset


KNOWN = {"cut": cut, "needy": needy}


def problems(text: str) -> list[str]:
    with pytest.raises(ConfigErrors) as caught:
        bind(read_text(text, "chain.yaml"), KNOWN)
    return str(caught.value).splitlines()


def stages(params: str) -> str:
    return f"stages:\n  - cut: {params}\n"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "chain.yaml: must be a mapping with the keys version, lods, stages"),
        ("[1]", "chain.yaml: must be a mapping with the keys version"),
        ("version: 1", "chain.yaml:1:1: 'stages' is missing"),
        ("version: 2\nstages: [cut]", "chain.yaml:1:10: version: must be 1 (got 2)"),
        ("stages: []", "chain.yaml:1:9: stages: must have at least 1 (got 0)"),
        ("stages: cut", "chain.yaml:1:9: stages: must be a list (got 'cut')"),
        ("stages:\n  - cuts:\n", "chain.yaml:2:5: stages[0]: unknown stage 'cuts'; did you mean 'cut'?"),
        ("stages: [zzz]", "chain.yaml:1:10: stages[0]: unknown stage 'zzz'; known: cut, needy"),
        ("stages: [7]", "chain.yaml:1:10: stages[0]: must be a stage's name, or one name with its parameters"),
        ("stages:\n  - cut:\n    count: 2", "chain.yaml:2:5: stages[0]: must be a stage's name, or one name with its"),
        (stages("[1]"), "chain.yaml:2:10: stages[0].cut: must be a mapping (key: value) (got [1])"),
        (stages("{ratios: [0.5, 2]}"), "chain.yaml:2:25: stages[0].cut.ratios.1: must be less than 1 (got 2)"),
        (stages("{ratios: 0.5}"), "chain.yaml:2:19: stages[0].cut.ratios: must be a list (got 0.5)"),
        (stages("{count: many}"), "chain.yaml:2:18: stages[0].cut.count: must be a whole number (got 'many')"),
        (stages("{count: 1.5}"), "chain.yaml:2:18: stages[0].cut.count: must be a whole number (got 1.5)"),
        (stages("{count: true}"), "chain.yaml:2:18: stages[0].cut.count: must be a whole number (got true)"),
        (stages("{count: '1'}"), "chain.yaml:2:18: stages[0].cut.count: must be a whole number (got '1')"),
        (stages("{count: }"), "chain.yaml:2:17: stages[0].cut.count: must be a whole number (got nothing)"),
        (stages("{deep: yes}"), "chain.yaml:2:17: stages[0].cut.deep: must be true or false (got 'yes')"),
        (
            stages("{mode: halve}"),
            "chain.yaml:2:17: stages[0].cut.mode: must be 'full' or 'half' (got 'halve'); did you mean 'half'?",
        ),
        (stages("{size: big}"), "chain.yaml:2:17: stages[0].cut.size: must be 'auto' or a whole number (got 'big')"),
        (stages("{cuont: 1}"), "chain.yaml:2:11: stages[0].cut: unknown key 'cuont'; did you mean 'count'?"),
        ("stages: [needy]", "chain.yaml:1:10: stages[0].needy: 'must' is missing"),
        ("stages: [cut]\nlod: 1", "chain.yaml:2:1: unknown key 'lod'; did you mean 'lods'?"),
        ("stages: [cut]\nlods: [{ratio: 0}]", "chain.yaml:2:16: lods[0].ratio: must be more than 0 (got 0)"),
        ("stages: [cut]\nlods: [{ratio: 1.5}]", "chain.yaml:2:16: lods[0].ratio: must be at most 1 (got 1.5)"),
        ("stages: [cut]\nlods: [{triangles: 0}]", "chain.yaml:2:20: lods[0].triangles: must be at least 1 (got 0)"),
        ("stages: [cut]\nlods: [{rato: 0.5}]", "chain.yaml:2:9: lods[0]: unknown key 'rato'; did you mean 'ratio'?"),
        ("stages: [cut]\nlods: [0.5]", "chain.yaml:2:8: lods[0]: must be a mapping (key: value) (got 0.5)"),
        ("stages: [cut]\nlods: [{}]", "chain.yaml:2:8: lods[0]: must have exactly one of ratio, triangles, error"),
        (
            "stages: [cut]\nlods: [{ratio: 0.5, error: 1}]",
            "chain.yaml:2:8: lods[0]: must have exactly one of ratio, triangles, error, or pixels and screen (got",
        ),
        (
            "stages: [cut]\nlods: [{pixels: 1}]",
            "chain.yaml:2:8: lods[0]: must have exactly one of ratio, triangles, error, or pixels and screen (got",
        ),
        (
            "stages: [cut]\nlods: [{pixels: 1, screen: 0.5, ratio: 0.5}]",
            "chain.yaml:2:8: lods[0]: must have exactly one of ratio, triangles, error, or pixels and screen (got",
        ),
        ("stages: [cut]\nlods: [{pixels: 1, screen: 1.5}]", "chain.yaml:2:28: lods[0].screen: must be at most 1"),
        (
            "stages: [cut]\nlods: [{pixels: 1, screen: 0.1}, {pixels: 2, screen: 0.5}]",
            "chain.yaml:2:7: lods: levels must go from fine to coarse (screen / pixels 0.25 follows 0.1)",
        ),
        (
            "stages: [cut]\nlods: [{ratio: 0.1}, {triangles: 9}, {ratio: 0.5}]",
            "chain.yaml:2:7: lods: levels must go from fine to coarse (ratio 0.5 follows 0.1)",
        ),
        (
            "stages: [cut]\nlods: [{error: 1}, {error: 0.5}]",
            "chain.yaml:2:7: lods: levels must go from fine to coarse (error 0.5 follows 1)",
        ),
        (
            "stages: [cut]\nlimits: {memory: 1}",
            "chain.yaml:2:10: limits: unknown key 'memory'; did you mean 'memory_gb'?",
        ),
        ("stages: [cut]\nlimits: {minutes: 0}", "chain.yaml:2:19: limits.minutes: must be more than 0 (got 0)"),
        (
            "stages: [cut]\nbudgets: {levels: {1: {max_eror: 1}}}",
            "chain.yaml:2:24: budgets.levels.1: unknown key 'max_eror'; did you mean 'max_error'?",
        ),
        (
            "stages: [cut]\nbudgets: {levels: {x: {bytes: 1}}}",
            "chain.yaml:2:20: budgets.levels.x: must be a whole number (got 'x')",
        ),
        ("stages: [cut]\nseed: -1", "chain.yaml:2:7: seed: must be at least 0 (got -1)"),
        ("stages: [cut]\nplugins: here", "chain.yaml:2:10: plugins: must be a list (got 'here')"),
    ],
)
def test_one_mistake_is_one_line_at_its_place(text, line):
    (got,) = problems(text)
    assert got.startswith(line)


def test_all_mistakes_are_told_in_the_order_of_the_lines():
    text = "version: 1\nlods: [{ratio: 2}]\nstages:\n  - cutt\n  - cut: {count: x, extra: 1}\nseeds: 1\n"
    assert [line.split(": ")[0] for line in problems(text)] == [
        "chain.yaml:2:16",
        "chain.yaml:4:5",
        "chain.yaml:5:18",
        "chain.yaml:5:21",
        "chain.yaml:6:1",
    ]


def test_a_good_one_is_bound_and_resolved():
    text = "lods: [{ratio: 0.5}, {triangles: 10}, {error: 2}]\nstages: [cut, {cut: {count: 3}}, {cut: }]\n"
    config, steps = bind(read_text(text, "x"), KNOWN)
    assert config.targets() == (Target(ratio=0.5), Target(triangles=10), Target(error=2.0))
    assert [step.params.count for step in steps] == [1, 3, 1]
    data = resolved(config)
    assert data["stages"][1] == {"cut": {"ratios": [], "mode": "full", "count": 3, "size": "auto", "deep": False}}
    assert data["limits"]["minutes"] == 30
    assert data["lods"] == [{"ratio": 0.5}, {"triangles": 10}, {"error": 2.0}]


def test_the_resolved_configuration_resolves_to_itself():
    text = "lods: [{ratio: 0.5}]\nbudgets: {bytes: 9, levels: {1: {max_error: 2}}}\nstages: [{cut: {size: 4}}]\nseed: 3"
    first, _ = bind(read_text(text, "x"), KNOWN)
    again, _ = bind(Source("again", resolved(first)), KNOWN)
    assert again == first
    assert resolved(again) == resolved(first)
