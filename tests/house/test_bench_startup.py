"""The start-up benchmark runs the real program."""

from __future__ import annotations

from lanebound.agents.bench import runner, startup


def test_measures_a_start():
    (row,) = startup.measure(rounds=1)
    assert (row.name, row.unit, row.higher_is_better) == ("cli_start_cached_s", "s", False)
    assert row.value > 0


def test_is_found():
    assert "startup" in runner.benchmark_names()
