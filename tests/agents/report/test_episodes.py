"""What is taken from stored episodes, and which are the worst."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks import LIMITS_M, made_up_folder, made_up_outcome, made_up_rows, made_up_suite

from lanebound.agents.benchmark.results import Results
from lanebound.agents.benchmark.store import EpisodeStore
from lanebound.agents.report.style import actors_of
from lanebound.agents.report.views import pooled, trace_of, what_happened, worst_of

SUITE = made_up_suite(
    envs=["LaneKeeping"], skies=["urban"], seeds={"count": 3}, agents=["random", "nominal", "cautious"]
)


def outcomes(**by_agent):
    """Outcomes of the suite's tasks; the costs of an agent, seed by seed, may be given."""
    costs = {name: list(given) for name, given in by_agent.items()}
    return [
        made_up_outcome(task, ended="time up", success=True, **({"cost": costs[task.agent].pop(0)} if costs else {}))
        for task in SUITE.tasks()
    ]


def test_an_episode_is_read_without_its_start(tmp_path):
    results = made_up_folder(tmp_path, seeds={"count": 1})
    outcome = results.outcomes[0]
    driven = trace_of(results, outcome)
    rows = made_up_rows(outcome)[1:]
    assert (driven.al_at_m, driven.al_ct_m) == LIMITS_M
    np.testing.assert_allclose(driven.record.time_s, [row["time_s"] for row in rows])
    np.testing.assert_array_equal(driven.record.pl_at_m, [row["pl_at_m"] for row in rows])
    np.testing.assert_array_equal(driven.record.alert, [row["alert"] for row in rows])
    assert {mode.key for mode in driven.record.modes_present()} == {"rtk", "doppler"}


def test_episodes_are_pooled_with_all_their_decisions(tmp_path):
    results = made_up_folder(tmp_path, seeds={"count": 2})
    some = results.outcomes[:3]
    assert pooled(results, some).record.epochs == sum(o.steps for o in some)
    assert pooled(results, []) is None


def test_other_alert_limits_keep_their_ratio(tmp_path):
    store = EpisodeStore(tmp_path)
    store.claim(SUITE)
    tasks = list(SUITE.tasks())[:2]
    for task, limit in zip(tasks, (1.0, 2.0), strict=True):
        rows = [
            row | {"al_at_m": limit, "err_at_m": 0.5 * limit, "pl_at_m": 0.8 * limit}
            for row in made_up_rows(made_up_outcome(task))
        ]
        store.write(rows, made_up_outcome(task))
    results = Results.load(tmp_path)
    driven = pooled(results, results.outcomes)
    assert driven.al_at_m == 1.0
    np.testing.assert_allclose(driven.record.error_at_m, 0.5)
    np.testing.assert_allclose(driven.record.pl_at_m, 0.8)


def test_nothing_is_kept_of_results_that_were_made_up():
    made_up = outcomes()
    assert trace_of(Results.of(SUITE, made_up), made_up[0]) is None


def test_the_worst_of_each_agent_but_not_of_chance():
    found = worst_of(outcomes(random=[99, 99, 99], nominal=[1, 5, 2], cautious=[7, 3, 4]), actors_of(SUITE), 3)
    assert [(o.agent, o.cost) for o in found] == [("cautious", 7), ("nominal", 5)]
    alone = [o for o in outcomes() if o.agent == "random"]
    assert [o.agent for o in worst_of(alone, actors_of(SUITE), 3)] == ["random"]


def test_bad_ends_are_worse_than_any_cost():
    task = next(t for t in SUITE.tasks() if t.agent == "nominal")
    other = next(t for t in SUITE.tasks() if t.agent == "cautious")
    crashed, costly = (
        made_up_outcome(task, ended="collision", cost=1.0),
        made_up_outcome(other, ended="time up", cost=9),
    )
    failed = made_up_outcome(other, ended="collision", status="raised", cost=50.0)
    assert worst_of([costly, failed, crashed], actors_of(SUITE), 2) == [crashed, costly]


def test_drives_that_are_the_same_are_shown_once():
    tasks = [task for task in SUITE.tasks() if task.seed == 10000 and task.agent != "random"]
    same = [made_up_outcome(task, cost=3.0, total_return=2.0, ended="time up") for task in tasks]
    assert [o.agent for o in worst_of(same, actors_of(SUITE), 3)] == ["nominal"]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"success": True, "ended": "time up"}, ""),
        ({"success": False, "ended": "time up"}, "no success (time up)"),
        ({"success": False, "ended": "off road"}, "off road"),
        ({"success": False, "status": "wrong_shape", "message": "got 3"}, "wrong shape: got 3"),
        ({"success": False, "status": "timeout"}, "timeout"),
    ],
)
def test_what_happened(given, words):
    assert what_happened(made_up_outcome(next(iter(SUITE.tasks())), **given)) == words
