"""Figures as inline SVG, ranges and places of labels."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lanebound.agents.report.charts import STAND_INS, Box, colour, new_axes, new_figure, span, spread_out, to_svg

VALUES = st.floats(-1e6, 1e6)
EVIL = '</g><script>"x"</script>'


def a_picture(label: str = "a < b", note: str = "so much") -> str:
    figure = new_figure(200.0, 100.0)
    axes = new_axes(figure, Box(40.0, 20.0, 190.0, 60.0), (-1.0, 1.0), (0.0, 1e9), labels=("time (s)", f"PL {EVIL}"))
    axes.plot([-9.0, 9.0], [0.5, 0.5], color=colour("level"), gid="line")
    return to_svg(figure, label, {"line": note}, "chart small")


def test_a_picture_says_what_it_shows_and_scales() -> None:
    parsed = ET.fromstring(a_picture())
    assert (parsed.attrib["viewBox"], parsed.attrib["width"]) == ("0 0 200 100", "200")
    assert (parsed.attrib["role"], parsed.attrib["aria-label"]) == ("img", "a < b")
    assert parsed.attrib["class"] == "chart small"
    assert [str(e.text) for e in parsed.iter("title")] == ["so much"]


def test_words_are_escaped() -> None:
    drawn = a_picture(EVIL, EVIL)
    assert "<script>" not in drawn
    parsed = ET.fromstring(drawn)
    assert parsed.attrib["aria-label"] == EVIL
    assert EVIL in [e.text for e in parsed.iter("title")]
    assert f"PL {EVIL}" in [e.text for e in parsed.iter("text")]


def test_a_picture_needs_the_page_alone() -> None:
    """Text stays text, colours are variables of the style, nothing is fetched, and no two pictures share ids."""
    drawn = a_picture()
    assert not re.search(r"https?://|url\(|font-family|@import", drawn)
    assert not any(stand_in in drawn for stand_in in STAND_INS.values())
    assert {"var(--soft)", "var(--grid)", "var(--level)"} <= set(re.findall(r"var\(--\w+\)", drawn))
    assert {"−1", "time (s)"} <= {e.text for e in ET.fromstring(drawn).iter("text")}
    assert not re.search(r"\d\.\d\d", re.sub(r'style="[^"]*"', "", drawn))


def test_ids_of_markers_differ_from_picture_to_picture() -> None:
    def marked(label: str) -> set[str]:
        figure = new_figure(50.0, 50.0)
        new_axes(figure, Box(5.0, 5.0, 45.0, 45.0), (0.0, 1.0), (0.0, 1.0)).plot([0.5], [0.5], "o")
        return set(re.findall(r'id="(\w+)"', to_svg(figure, label)))

    assert marked("one")
    assert not marked("one") & marked("two")


@given(st.lists(VALUES, min_size=1, max_size=6))
def test_a_span_holds_all_and_is_never_empty(values: list[float]) -> None:
    low, high = span(values)
    assert low <= min(values) <= max(values) <= high
    assert low < high


def test_a_span_leaves_out_what_is_no_number() -> None:
    assert span([None, float("inf"), float("nan")]) == (-0.5, 0.5)


@given(st.lists(st.floats(0, 300), min_size=1, max_size=12))
def test_spread_positions_keep_their_order_and_distance(wanted: list[float]) -> None:
    placed = spread_out(wanted, 15.0)
    order = sorted(range(len(wanted)), key=lambda i: wanted[i])
    gaps = [placed[b] - placed[a] for a, b in pairwise(order)]
    assert all(gap >= 15.0 - 1e-6 for gap in gaps)
    assert sum(placed) == pytest.approx(sum(wanted), abs=1e-6)
