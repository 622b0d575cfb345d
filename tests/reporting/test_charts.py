"""Line charts."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lodpipe.reporting.charts import HEIGHT, WIDTH, Series, chart

CURVE = [(100.0, 1.0), (1000.0, 0.1), (10_000.0, 0.01)]


def dots(markup):
    return [(float(x), float(y)) for x, y in re.findall(r'<circle cx="([^"]+)" cy="([^"]+)"', markup)]


def test_a_power_law_is_a_straight_line():
    (ax, ay), (bx, by), (cx, cy) = dots(chart("t", "x", "y", [Series("s", CURVE)]))
    assert ax < bx < cx
    assert ay < by < cy
    assert bx == pytest.approx((ax + cx) / 2, abs=0.2)
    assert by == pytest.approx((ay + cy) / 2, abs=0.2)


def test_the_points_can_be_read():
    text = chart("t", "x", "y", [Series("mean", CURVE)])
    assert "<title>mean: 0.1 at 1,000</title>" in text
    assert ">1 k</text>" in text


def test_what_has_no_logarithm_is_left_out():
    assert len(dots(chart("t", "x", "y", [Series("s", [*CURVE, (500.0, 0.0)])]))) == 3
    assert len(dots(chart("t", "x", "y", [Series("s", [*CURVE, (500.0, 0.0)])], log_y=False))) == 4


@pytest.mark.parametrize("points", [[], [(5.0, 1.0)], [(5.0, 0.0), (6.0, 0.0)]])
def test_less_than_two_points_are_no_line(points):
    assert chart("t", "x", "y", [Series("s", points)]) == ""


def test_words_are_escaped():
    text = chart("<t>", "x", "y", [Series("<script>", CURVE)])
    assert "<script>" not in text
    assert "<t>" not in text


@given(st.lists(st.tuples(st.floats(1, 1e9), st.floats(1e-9, 1e9)), min_size=2, max_size=6), st.booleans())
def test_every_chart_is_well_formed_and_inside_its_frame(points, log_y):
    text = chart("t", "x", "y", [Series("s", points)], log_y=log_y)
    ElementTree.fromstring(text)
    assert all(0 <= x <= WIDTH and 0 <= y <= HEIGHT for x, y in dots(text))
    assert 1 <= text.count('class="y"') <= 12
