"""The overview of a benchmark: one table, and no more said than the numbers say."""

from __future__ import annotations

from dataclasses import replace

import pytest
from benchmarks import made_up_outcome, made_up_results, made_up_suite

from lanebound.agents.benchmark.results import Results
from lanebound.agents.cli.benchmark_tables import SHOWN, overview_rows, print_overview

AGENTS = ["nominal", "integrity_aware", "oracle"]


def results() -> Results:
    return made_up_results(agents=AGENTS, seeds={"count": 12})


def test_a_row_has_the_means_of_all_cells():
    suite = made_up_suite(agents=AGENTS)
    made = Results.of(suite, [made_up_outcome(t, success=True, collision=False, cost=1.0) for t in suite.tasks()])
    rows = [dict(zip(("agent", *SHOWN), row, strict=True)) for row in overview_rows(made)]
    assert [row["agent"] for row in rows] == AGENTS
    assert (rows[1]["success"], rows[1]["collision"], rows[1]["cost"]) == ("100", "0.0", "1.0")


def test_progress_is_shown_by_throughput_which_an_early_end_does_not_raise():
    suite = made_up_suite(agents=["nominal"], seeds={"count": 2})
    fast = [made_up_outcome(t, mean_speed_mps=14.0, throughput_mps=0.2) for t in suite.tasks()]
    ((_, _, progress, *_),) = overview_rows(Results.of(suite, fast))
    assert "mean_speed" not in SHOWN
    assert progress == "0.2"


def test_it_fits_into_eighty_characters(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    print_overview(results())
    told = capsys.readouterr().out
    table = told.partition("Means over")[2].partition("└")[0]
    assert max(map(len, table.splitlines())) <= 80
    assert "…" not in told
    assert "Means over 4 cells (environments x skies x faults), 12 seeds each" in told


def test_limits_that_were_chosen_under_another_sky_are_told(capsys):
    suite = made_up_suite(envs=["Merge", "LaneKeeping"], skies=["urban"], agents=["nominal"], seeds={"count": 2})
    made = Results.of(suite, [made_up_outcome(task) for task in suite.tasks()])
    print_overview(made)
    told = " ".join(capsys.readouterr().out.split())
    assert "chosen under the sky of the preset, which is another one for Merge-v0 (suburban)." in told
    own = made_up_suite(envs=["Merge"], skies=["suburban"], agents=["nominal"], seeds={"count": 2})
    print_overview(Results.of(own, [made_up_outcome(task) for task in own.tasks()]))
    assert "Cost limits" not in capsys.readouterr().out


def test_means_of_other_cells_are_not_to_be_compared(capsys):
    made = results()
    print_overview(Results.of(made.suite, [o for o in made.outcomes if o.agent == "nominal" or o.sky == "urban"]))
    assert "integrity_aware drove 2 of the 4 cells, oracle drove 2 of the 4 cells: not to be" in capsys.readouterr().out


def test_failures_are_told_beside_the_figures_that_leave_them_out(capsys):
    made = results()
    failing = [replace(o, status="raised") if o.agent == "nominal" and o.seed < 10_003 else o for o in made.outcomes]
    print_overview(Results.of(made.suite, failing))
    told = capsys.readouterr().out
    assert "nominal failed in 12 of 48 episodes: its figures but success leave these out." in told
    assert "No verdict on integrity_aware against nominal in 4 cells: an agent failed there." in told


@pytest.mark.parametrize(("skies", "told"), [(["urban", "dense"], "3 of its 4 cells"), (["dense"], "1 of its 2 cells")])
def test_margins_that_were_not_fitted_are_told(capsys, monkeypatch, skies, told):
    monkeypatch.setattr("lanebound.agents.benchmark.untuned.tuned_places", lambda: (("CarFollowingWorld", "dense"),))
    print_overview(made_up_results(agents=["nominal", "cautious"], skies=skies))
    assert f"cautious is untuned in {told}: its margins were not fitted there." in capsys.readouterr().out


def test_nothing_driven(capsys):
    print_overview(Results.of(made_up_suite(), []))
    assert capsys.readouterr().out == "No episode was driven: there is nothing to show.\n"
