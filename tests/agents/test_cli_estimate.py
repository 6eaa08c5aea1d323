"""The estimate tells nothing of a first part, the rest at the pace of those after it, and not too often."""

from __future__ import annotations

import doctest

from lanebound.agents.cli import estimate


def test_its_examples() -> None:
    found = doctest.testmod(estimate)
    assert found.attempted > 3
    assert found.failed == 0


def test_parts_of_an_earlier_run_say_nothing_of_the_pace() -> None:
    now = [0.0]
    pace = estimate.Estimate(lambda: now[0])
    said = []
    for done in range(90, 101):
        said.append(pace.line(done, 100))
        now[0] += 30.0
    assert [line for line in said if line] == ["93 of 100 parts done, about 4 min left"]


def test_parts_that_all_end_at_once_leave_no_pace() -> None:
    pace = estimate.Estimate(lambda: 1.0)
    assert [pace.line(done, 20) for done in (0, 8, 20)] == [None, None, None]
