"""Numbers and who is best, as people read them."""

from __future__ import annotations

import doctest

import pytest

from lanebound.agents.report import charts, style
from lanebound.agents.report.style import SHARE, clear_best, interval, plain, shorten, signed


@pytest.mark.parametrize("module", [charts, style])
def test_the_examples_hold(module):
    found = doctest.testmod(module)
    assert found.attempted > 0
    assert found.failed == 0


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.0, "0.000"), (-0.5, "−0.500"), (9.994, "9.99"), (12.34, "12.3"), (99.94, "99.9"), (123.4, "123"),
        (1e6, "1,000,000"), (3e-5, "3e−05"), (float("inf"), "–"), (float("nan"), "–"),
    ],
)  # fmt: skip
def test_three_digits(value, shown):
    assert plain(value) == shown


def test_shares_are_percentages_and_rare_events_are_not_none():
    assert [plain(v, SHARE) for v in (0.0, 1.0, 0.5, 0.0003)] == ["0.0 %", "100 %", "50.0 %", "0.03 %"]


def test_signs_and_intervals():
    assert signed(0.0) == "0.000"
    assert interval(-0.1, -0.2, None, SHARE, signed) == "−10.0 % [−20.0 %, –]"


def test_names_keep_both_ends():
    assert shorten("short", 10) == "short"
    assert len(shorten("a.very.long.module:driver", 10)) == 10


def test_best_is_who_is_clear_of_all_others():
    assert clear_best([("a", 1.0, 2.0), ("b", 3.0, 4.0), ("c", 0.0, 2.9)], "higher") == "b"
    assert clear_best([("a", 1.0, 2.0), ("b", 3.0, 4.0), ("c", 0.0, 3.1)], "higher") is None
    assert clear_best([("a", 1.0, 2.0), ("b", 3.0, 4.0)], None) is None
    assert clear_best([("a", 1.0, 2.0), ("b", None, None)], "higher") is None
    assert clear_best([("a", 1.0, 1.0), ("b", 1.0, 1.0)], "lower") is None
