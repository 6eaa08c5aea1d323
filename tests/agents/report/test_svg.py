"""Elements, scales and labels of pictures."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lanebound.agents.report.svg import Frame, Scale, axes, path_of, picture, round_step, span, spread_out, tag, text

VALUES = st.floats(-1e6, 1e6)


def test_words_and_attributes_are_escaped():
    shown = tag("g", tag("title", '</g><script>"x"'), class_='a"><b', stroke_width=1.25, left_out=None)
    parsed = ET.fromstring(shown)
    assert parsed.attrib == {"class": 'a"><b', "stroke-width": "1.2"}
    assert parsed[0].text == '</g><script>"x"'


def test_a_picture_says_what_it_shows():
    parsed = ET.fromstring(picture(30.0, 20.0, "a < b", text(1.0, 2.0, "name", anchor="end")))
    assert parsed.attrib["viewBox"] == "0 0 30 20"
    assert (parsed.attrib["role"], parsed.attrib["aria-label"]) == ("img", "a < b")
    assert parsed[0].attrib == {"x": "1", "y": "2", "text-anchor": "end"}


@given(st.lists(VALUES, min_size=1, max_size=6))
def test_a_span_holds_all_and_is_never_empty(values):
    low, high = span(values)
    assert low <= min(values) <= max(values) <= high
    assert low < high


def test_a_span_leaves_out_what_is_no_number():
    assert span([None, float("inf"), float("nan")]) == (-0.5, 0.5)


@pytest.mark.parametrize(("width", "count", "step"), [(1.0, 5, 0.2), (7.0, 5, 2.0), (100.0, 4, 50.0), (0.03, 3, 0.01)])
def test_steps_are_round(width, count, step):
    assert round_step(width, count) == pytest.approx(step)


@given(VALUES, st.floats(1e-3, 1e6), st.integers(2, 8))
def test_ticks_are_inside_and_few(low, width, count):
    ticks = Scale(low, low + width, 0.0, 100.0).ticks(count)
    assert len(ticks) <= count + 1
    assert all(low - 1e-6 * width <= tick <= low + (1 + 1e-6) * width for tick in ticks)


def test_scales_map_their_ends_and_hold_the_rest():
    frame = Frame(10.0, 20.0, 110.0, 220.0)
    up = frame.up(0.0, 2.0)
    assert (up(0.0), up(2.0), up.held(9.0), frame.across(0.0, 1.0).held(-1.0)) == (220.0, 20.0, 20.0, 10.0)


def test_axes_are_labelled():
    frame = Frame(10.0, 20.0, 110.0, 220.0)
    drawn = "".join(axes(frame, frame.across(0.0, 1.0), frame.up(-1.0, 1.0), "time (s)", "PL (m)"))
    assert "time (s)" in drawn
    assert ">−1<" in drawn


def test_a_path_goes_through_its_points():
    assert path_of([(0.0, 1.0), (2.55, 3.0)]) == "M0 1L2.5 3"


@given(st.lists(st.floats(0, 300), min_size=1, max_size=12))
def test_spread_positions_keep_their_order_and_distance(wanted):
    placed = spread_out(wanted, 15.0)
    order = sorted(range(len(wanted)), key=lambda i: wanted[i])
    gaps = [placed[b] - placed[a] for a, b in pairwise(order)]
    assert all(gap >= 15.0 - 1e-6 for gap in gaps)
    assert sum(placed) == pytest.approx(sum(wanted), abs=1e-6)
