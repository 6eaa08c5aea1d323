"""Verdicts: who harms less is found, who harms more or fails is not praised, and chance is not taken for safety."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from benchmarks import made_up_outcome, made_up_suite

from lanebound.agents.benchmark.outcome import Outcome, Task
from lanebound.agents.benchmark.results import Results
from lanebound.agents.benchmark.statistics import seeds_to_exclude
from lanebound.agents.benchmark.verdicts import LEVEL, MARGIN, RULE, conclusions, verdicts

SAFE: dict[str, Any] = {"collision": False, "lane_departure": False, "success": True, "ended": "time up"}
FIRST = 10_000


def outcome(task: Task, crashed: bool = False, off_road: bool = False, lane_m2: float = 0.0, **changes: Any) -> Outcome:
    """An episode of which only what the true car did is told, with a little spread in the figures."""
    jitter = 1e-3 * ((task.seed * 7 + len(task.agent)) % 5)
    costs = {"cost_collision": float(crashed), "cost_off_road": float(off_road), "cost_lane": lane_m2 + jitter}
    given = SAFE | {"collision": crashed, "costs": costs, "throughput_mps": 10.0 + jitter, "cost": 60.0 + jitter}
    return made_up_outcome(task, **(given | changes))


def driven(made: Callable[[Task], Outcome], seeds: int = 60, **changes: Any) -> Results:
    """Results of one cell, unless ``changes`` say otherwise."""
    one = {"envs": ["LaneKeeping"], "skies": ["urban"], "agents": ["nominal", "mine"], "seeds": {"count": seeds}}
    suite = made_up_suite(**(one | changes))
    return Results.of(suite, [made(task) for task in suite.tasks()])


def test_less_harm_with_no_more_crashes_is_safer_and_its_price_is_told():
    def made(task: Task) -> Outcome:
        if task.agent == "mine":
            return outcome(task, throughput_mps=6.0 + 1e-3 * (task.seed % 3))
        return outcome(task, crashed=task.seed % 3 == 0, lane_m2=5.0)

    results = driven(made, skies=["urban", "dense"])
    safer, price, rule = conclusions(results)
    assert safer == "Clearly safer than nominal: mine in 2 of 2 cells."
    assert price == "Throughput against nominal, over all cells: mine -4.0 m/s."
    assert rule == RULE


def test_a_lower_cost_is_no_safety_and_crashes_are_not_outweighed():
    """0 of 8 against 4 of 8 collisions and a cost of 109 against about 70: once called clearly safer."""

    def made(task: Task) -> Outcome:
        if task.agent == "mine":
            return outcome(task, crashed=task.seed % 2 == 0, cost=57.0 + 3.0 * (task.seed % 8))
        return outcome(task, cost=109.0 + 0.1 * (task.seed % 4))

    results = driven(made, seeds=8)
    assert results.paired[0].n == 8
    assert next(p for p in results.paired if p.metric == "cost").clear
    assert not any(verdict.safer for verdict in verdicts(results))
    (line,) = conclusions(results)
    assert line.startswith("With 8 seeds no agent can be called safer than nominal")
    assert f"takes {seeds_to_exclude(MARGIN)} seeds at least" in line


@pytest.mark.parametrize("end", ["crashed", "off_road"])
def test_ends_that_may_have_risen_by_more_than_the_margin_forbid_praise(end):
    """Far less departed, but 4 of 60 ended where nobody did before: not clearly more, and not shown to be no more."""

    def made(task: Task, ends: int) -> Outcome:
        if task.agent == "mine":
            return outcome(task, **{end: task.seed < FIRST + ends})
        return outcome(task, lane_m2=300.0, lane_departure=True)

    results = driven(lambda task: made(task, 4))
    pairs = {p.metric: p for p in results.paired}
    assert pairs["harm"].clear
    assert pairs["harm"].difference < 0.0
    assert not pairs["collision"].clear
    assert not pairs["off_road"].clear
    assert not verdicts(results)[0].safer
    assert verdicts(driven(lambda task: made(task, 0)))[0].safer


def test_an_agent_that_fails_on_the_hard_seeds_is_not_praised():
    """20 seeds: the reference collides on ten hard ones, and the agent raises on exactly these."""

    def made(task: Task) -> Outcome:
        hard = task.seed < FIRST + 100
        if task.agent == "mine":
            found = outcome(task)
            return replace(found, status="raised", success=False) if hard and fails else found
        return outcome(task, crashed=hard, lane_m2=0.0 if hard else 20.0, lane_departure=not hard)

    fails = True
    results = driven(made, seeds=200)
    assert results.cell(results.suite.places[0], "mine").metrics["collision"].mean == 0.0
    pair = next(p for p in results.paired if p.metric == "harm")
    assert (pair.n, pair.failed, pair.clear) == (100, 100, False)
    assert pair.high < 0.0
    assert conclusions(results) == ["No verdict on mine against nominal in 1 cell: an agent failed there."]
    fails = False
    assert conclusions(driven(made, seeds=200))[0] == "Clearly safer than nominal: mine in 1 of 1 cell."


def test_who_never_ends_well_and_who_sees_the_truth_are_not_praised():
    def made(task: Task) -> Outcome:
        bad = task.agent == "nominal"
        return outcome(task, lane_m2=30.0 * bad, lane_departure=bad, success=bad, ended="time up")

    assert conclusions(driven(made)) == [
        "With 60 seeds no agent is clearly safer than nominal in any cell; more seeds may show more (--seeds)."
    ]
    for agent in ("oracle", {"agent": "nominal", "config": {"observation": {"integrity": "oracle"}}}):
        assert verdicts(driven(made, agents={"nominal": "nominal", "mine": agent})) == []


def test_both_references_are_compared_with_and_each_has_its_line():
    level = {"nominal": 30.0, "cautious": 15.0, "mine": 1.0}
    results = driven(
        lambda task: outcome(task, lane_m2=level[task.agent]), agents=list(level), reference=["nominal", "cautious"]
    )
    assert [(v.agent, v.against, bool(v.safer), bool(v.worse)) for v in verdicts(results)] == [
        ("cautious", "nominal", True, False),
        ("mine", "nominal", True, False),
        ("mine", "cautious", True, False),
        ("nominal", "cautious", False, True),
    ]
    lines = [line for line in conclusions(results) if line.startswith("Clearly")]
    assert lines == [
        "Clearly safer than nominal: cautious in 1 of 1 cell, mine in 1 of 1 cell.",
        "Clearly safer than cautious: mine in 1 of 1 cell.",
    ]


def test_throughput_is_over_all_cells_and_not_those_of_the_praise():
    """Safer and no slower under one sky, neither safer nor as fast under the other."""

    def made(task: Task) -> Outcome:
        bad, slow = (
            task.agent == "nominal" and task.place.sky == "urban",
            task.agent != "nominal" and task.place.sky == "dense",
        )
        return outcome(task, lane_m2=30.0 * bad, throughput_mps=10.0 - 8.0 * slow)

    safer, price, _ = conclusions(driven(made, skies=["urban", "dense"]))
    assert safer == "Clearly safer than nominal: mine in 1 of 2 cells."
    assert price == "Throughput against nominal, over all cells: mine -4.0 m/s."


def test_harm_in_another_cell_is_told_with_the_praise():
    def made(task: Task) -> Outcome:
        bad = (task.agent == "nominal") == (task.place.sky == "urban")
        return outcome(task, lane_m2=30.0 * bad)

    assert conclusions(driven(made, skies=["urban", "dense"]))[0] == (
        "Clearly safer than nominal: mine in 1 of 2 cells (clearly worse in 1)."
    )


def test_chance_is_not_taken_for_safety_over_many_comparisons():
    """8 families of 24 comparisons of equals: some intervals are clear, by Holm's method no figure is; P(any) < 0.3."""
    clear, wrong = 0, 0
    for family in range(8):
        rng = np.random.default_rng(family)

        def made(task: Task, rng: np.random.Generator = rng) -> Outcome:
            return outcome(task, lane_m2=float(rng.normal(10.0, 3.0)), lane_departure=bool(rng.random() < 0.5))

        results = driven(made, seeds=40, agents=["nominal", "a", "b", "c", "d"], skies=["open", "urban", "dense"])
        asked = [p for p in results.paired if p.metric in ("harm", "lane_departure")]
        clear += sum(p.clear and p.difference < 0.0 for p in asked)
        wrong += any(verdict.safer for verdict in verdicts(results))
    assert clear >= 1
    assert wrong == 0
    assert LEVEL == 0.05
