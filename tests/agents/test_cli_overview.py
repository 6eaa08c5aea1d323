"""The overview of a benchmark: one table, and no more said than the numbers say."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from benchmarks import made_up_outcome, made_up_suite

from lanebound.agents.benchmark.results import Results
from lanebound.agents.cli.overview import SHOWN, conclusions, overview_rows, print_overview

AGENTS = ["nominal", "integrity_aware", "oracle"]
BETTER = {"cost": 1.0, "collision": False, "lane_departure": False, "mean_speed_mps": 8.0}
WORSE = {"cost": 30.0, "collision": False, "lane_departure": False, "mean_speed_mps": 12.0}


def results(ours: dict[str, Any], seeds: int = 12) -> Results:
    """A reference of constant figures with a little noise in its cost, an agent with ``ours``, and the bound."""
    suite = made_up_suite(agents=AGENTS, seeds={"count": seeds})
    given = {"nominal": WORSE, "integrity_aware": ours, "oracle": BETTER}
    found = []
    for task in suite.tasks():
        outcome = made_up_outcome(task, success=True, **(given[task.agent]))
        jitter = 1e-3 * ((task.seed * 7 + len(task.agent)) % 5)
        speed = (outcome.mean_speed_mps or 0.0) + jitter
        found.append(replace(outcome, cost=outcome.cost + jitter, mean_speed_mps=speed))
    return Results.of(suite, found)


def test_a_row_has_the_means_of_all_cells():
    rows = overview_rows(results(BETTER))
    assert [row[0] for row in rows] == AGENTS
    assert all(len(row) == 1 + len(SHOWN) for row in rows)
    assert (rows[1][1], rows[1][4]) == ("100", "1.0")


def test_who_is_safer_is_said_with_the_cells_and_the_price_in_speed_and_the_bound_is_not_ranked():
    assert conclusions(results(BETTER)) == [
        "Clearly safer than nominal (collisions, departures or cost): integrity_aware in 4 of 4 cells.",
        "Mean speed in these cells against nominal: integrity_aware -4.0 m/s.",
    ]


@pytest.mark.parametrize("ours", [WORSE, BETTER | {"success": False}, BETTER | {"collision": True}])
def test_no_praise_without_success_or_with_more_of_another_harm(ours):
    made = results({key: value for key, value in ours.items() if key != "success"})
    if "success" in ours:
        outcomes = [replace(o, success=o.success and o.agent != "integrity_aware") for o in made.outcomes]
        made = Results.of(made.suite, outcomes)
    assert conclusions(made) == [
        "With 12 seeds no agent is clearly safer than nominal in any cell; --seeds takes more."
    ]


def test_it_fits_into_eighty_characters(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    print_overview(results(BETTER))
    told = capsys.readouterr().out
    table = told.partition("└")[0]
    assert max(map(len, table.splitlines())) <= 80
    assert "…" not in told
    assert "Means over 4 cells (environments x skies x faults), 12 seeds each" in told


def test_means_of_other_cells_are_not_to_be_compared(capsys):
    made = results(BETTER)
    print_overview(Results.of(made.suite, [o for o in made.outcomes if o.agent == "nominal" or o.sky == "urban"]))
    assert "integrity_aware drove 2 of the 4 cells, oracle drove 2 of the 4 cells: not to be" in capsys.readouterr().out


def test_nothing_driven(capsys):
    print_overview(Results.of(made_up_suite(), []))
    assert capsys.readouterr().out == "No episode was driven: there is nothing to show.\n"
