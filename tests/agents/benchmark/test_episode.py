"""One episode: what agents may do wrong is found, told and kept apart."""

from __future__ import annotations

import re

import bad_agents
import numpy as np
import pytest
from gymnasium import spaces

from lanebound.agents.benchmark.episode import run_episode
from lanebound.agents.benchmark.metrics import metric_named
from lanebound.agents.benchmark.outcome import Outcome, Place, Task
from lanebound.agents.drivers import make_agent
from lanebound.agents.episodes import open_env
from lanebound.agents.episodes.guard import AgentFailure, checked
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.sensors.fault_registry import fault_kinds

GIVEN = {"sky": "open", "navigation": {"source": "perfect"}, "perception": {"source": "truth"}, "duration_s": 2.0}
DRAWING = ("random", "bad_agents:draws", "bad_agents:samples")
TASK = Task(Place("LaneKeeping-v0", "open", "none"), "it", 10_000)


@pytest.fixture(scope="module")
def env():
    return open_env("LaneKeeping", GIVEN)


def test_a_sound_agent(env):
    rows, outcome = run_episode(env, lambda e: make_agent("nominal", e), TASK)
    assert (outcome.status, outcome.message, outcome.ended, outcome.steps) == ("ok", "", "time up", 10)
    assert len(rows) == 11
    assert outcome.allotted_s == 2.0
    assert outcome.cost_limit == env.config.cost_limit
    assert 0.0 < outcome.solve_ms_median <= outcome.solve_ms_p99
    assert outcome.lasting() == run_episode(env, lambda e: make_agent("nominal", e), TASK)[1].lasting()


def test_an_outcome_tells_the_one_fault_of_its_episode():
    struck = open_env("LaneKeeping", {"sky": "open", "cities": {"count": 1}, "faults": "one", "duration_s": 1.0})
    _, outcome = run_episode(struck, lambda e: make_agent("nominal", e), TASK)
    _, info = struck.reset(seed=TASK.seed)
    assert outcome.fault_kind == fault_kinds()[int(info["fault_kind"])].name
    for name in ("fault_onset_s", "fault_weight", "fault_probability", "no_fault_probability"):
        assert getattr(outcome, name) == info[name]
    assert Outcome.from_dict(outcome.to_dict()) == outcome


@pytest.mark.parametrize(
    ("maker", "status", "message"),
    [
        ("raises", "raised", r"ValueError: no idea what to do \(bad_agents.py:\d+\)"),
        ("leaves", "raised", "SystemExit: 3"),
        ("not_a_number", "not_finite", "action must be finite, got array"),
        ("short", "wrong_shape", r"action must be float32 numbers of shape \(2,\), got array"),
        ("says_words", "wrong_shape", "got 'left'"),
        ("too_much", "outside_space", "action must lie in Box"),
    ],
)
def test_a_bad_agent_is_named_and_what_it_drove_is_kept(env, maker, status, message):
    rows, outcome = run_episode(env, getattr(bad_agents, maker), TASK)
    assert outcome.status == status
    assert outcome.failed
    assert (outcome.steps, len(rows), outcome.ended) == (bad_agents.AFTER, bad_agents.AFTER + 1, "stopped")
    assert not outcome.success
    assert re.search(message, outcome.message)


def test_an_agent_that_cannot_be_made_or_returns_no_pair(env):
    rows, outcome = run_episode(env, bad_agents.unmade, TASK)
    assert (rows, outcome.status, outcome.steps) == ([], "raised", 0)
    assert "could not be made" in outcome.message
    assert run_episode(env, bad_agents.no_pair, TASK)[1].message.startswith("predict must return (action, state), got")


def test_what_goes_wrong_in_the_environment_is_not_put_on_the_agent(env, monkeypatch):
    def broken(action):
        raise ValueError("a broken world")

    monkeypatch.setattr(env, "step", broken)
    outcome = run_episode(env, lambda e: make_agent("nominal", e), TASK)[1]
    assert (outcome.status, outcome.message[:32]) == ("raised", "in the environment: ValueError: ")


def test_agents_that_draw_depend_on_the_seed_alone(env):
    def driven(maker, seed):
        return run_episode(env, maker, TASK._replace(seed=seed))[1].total_return

    random, draws, samples = (lambda e, name=name: make_agent(name, e) for name in DRAWING)
    for maker in (random, draws, samples):
        first = driven(maker, 10_000)
        assert driven(maker, 10_001) != first
        assert driven(maker, 10_000) == first


@pytest.mark.parametrize("action", [1, np.int64(2), np.array([0]), np.array(4, dtype=np.int32)])
def test_meta_actions_may_be_of_any_integer(action):
    assert checked(action, spaces.Discrete(5)) is action


@pytest.mark.parametrize(
    ("action", "status"),
    [
        (5, "outside_space"),
        (1.0, "outside_space"),
        ([1, 2], "wrong_shape"),
        (None, "wrong_shape"),
        ([[1], 2], "wrong_shape"),
    ],
)
def test_bad_meta_actions(action, status):
    with pytest.raises(AgentFailure) as failure:
        checked(action, spaces.Discrete(5))
    assert failure.value.status == status


@pytest.mark.parametrize(
    ("counts", "expected"),
    [
        ({"decisions": 10, "lane infeasible": 3, "following infeasible": 2, "infeasible": 4, "relaxed": 5}, (4, 5)),
        ({"decisions": 10, "following changed": 3}, (0, 0)),
        ({"infeasible": 4}, (None, None)),
        (None, (None, None)),
    ],
)
def test_what_an_agent_counts_of_its_decisions_comes_by_rates(env, counts, expected):
    def make(e):
        agent = make_agent("nominal", e)
        agent.counts = counts
        return agent

    outcome = run_episode(env, make, TASK)[1]
    assert (outcome.infeasible, outcome.relaxed) == expected
    rates = [None if count is None else count / 10.0 for count in expected]
    assert [metric_named(key).take(outcome) for key in ("infeasible", "relaxed")] == rates


@pytest.mark.parametrize("name", ["cbf", "mpc"])
def test_ours_that_count_are_counted(env, name):
    outcome = run_episode(env, lambda e: make_agent(name, e), TASK)[1]
    assert (outcome.status, outcome.infeasible, outcome.relaxed) == ("ok", 0, 0)
    assert run_episode(env, lambda e: make_agent("nominal", e), TASK)[1].relaxed is None


def test_unknown_agents_are_refused_by_name(env):
    with pytest.raises(InputError, match="agent 'nominl' is unknown: did you mean 'nominal'"):
        make_agent("nominl", env)
