"""The start-up benchmark runs the real program."""

from __future__ import annotations

from lanebound.agents.bench import environments, runner


def test_measures_a_start():
    (row,) = environments.measure_startup(rounds=1)
    assert (row.name, row.unit, row.higher_is_better) == ("cli_start_cached_s", "s", False)
    assert row.value > 0


def test_is_found():
    assert runner.select(["startup"]) == ["startup"]
