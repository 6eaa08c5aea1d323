"""The cautious driver's margins are as much care as it takes to do no more harm, found on training seeds alone."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from benchmarks import made_up_outcome, made_up_suite
from typer.testing import CliRunner

from lanebound.agents.benchmark.suite import TRAIN
from lanebound.agents.benchmark.tuning import GOAL, LADDER, cautious_at, choose, measured, tuning_suite
from lanebound.agents.cli import app
from lanebound.agents.drivers import make_agent
from lanebound.agents.episodes import open_env
from lanebound.integrity.core.errors import ConfigError, InputError


def _measured(harm: float, throughput_mps: float) -> dict[str, float]:
    return {"harm": harm, "throughput": throughput_mps}


def test_caution_slows_and_widens_from_the_nominal_driver_on():
    nominal, most = cautious_at(0.0), cautious_at(1.0)
    assert (nominal.speed_share, nominal.gap_m, nominal.lane_m) == (1.0, 0.0, 0.0)
    assert (most.speed_share, most.gap_m, most.lane_m) == (pytest.approx(0.3), 10.0, 1.0)


def test_the_ladder_is_driven_on_training_seeds_with_its_margins():
    suite = tuning_suite("CarFollowing", "dense", 5)
    assert set(suite.seeds.seeds) <= set(TRAIN)
    assert len(suite.agents) == 1 + len(LADDER)
    env = open_env("CarFollowing", {"sky": "dense"})
    chosen = suite.agents["caution_0.5"]
    driver = make_agent(chosen.agent, env, chosen.figures)
    assert driver.plan.config.speed_share == pytest.approx(cautious_at(0.5).speed_share)


def test_the_least_caution_without_more_harm_is_chosen_though_harm_is_not_monotone():
    ladder = {0.0: _measured(9.0, 10.0), 0.25: _measured(5.0, 8.0), 0.5: _measured(6.0, 6.0), 1.0: _measured(1.0, 3.0)}
    assert choose(_measured(5.5, 9.0), ladder) == (0.25, "harm")
    assert choose(_measured(2.0, 9.0), ladder) == (1.0, "harm")
    assert choose(_measured(0.5, 7.0), ladder) == (0.375, "throughput")
    assert choose(_measured(0.5, 20.0), ladder) == (0.0, "throughput")


def test_of_several_cautions_of_the_same_throughput_that_of_least_harm_is_chosen():
    """Crashes end episodes early, so that more caution first gets further and then less far."""
    ladder = {
        0.0: _measured(40.0, 5.0),
        0.25: _measured(30.0, 7.0),
        0.5: _measured(20.0, 6.0),
        1.0: _measured(10.0, 3.0),
    }
    caution, matched = choose(_measured(1.0, 5.25), ladder)
    assert (caution, matched) == (pytest.approx(0.625), "throughput")
    assert choose(_measured(1.0, 6.5), ladder)[0] == pytest.approx(0.375)
    assert choose(_measured(1.0, 2.0), ladder) == (1.0, "throughput")


def test_what_is_measured_is_not_distorted_by_early_ends_nor_by_the_weights_of_costs():
    tasks = [task for task in made_up_suite(agents=["nominal"], envs=["LaneKeeping"], skies=["urban"]).tasks()][:2]
    early = {"collision": True, "mean_speed_mps": 20.0, "throughput_mps": 1.0, "costs": {"cost_lane": 3.0}}
    late = {"collision": False, "mean_speed_mps": 8.0, "throughput_mps": 8.0, "costs": {"cost_lane": 1.0}}
    outcomes = [made_up_outcome(task, cost=7.0, **given) for task, given in zip(tasks, (early, late), strict=True)]
    found = measured(outcomes)
    assert (found["harm"], found["throughput"], found["mean_speed"]) == (27.0, 4.5, 14.0)
    assert (found["collision"], found["off_road"], found["cost_lane"], found["episodes"]) == (0.5, 0.0, 2.0, 2)
    failed = replace(outcomes[0], status="raised", message="no idea")
    with pytest.raises(InputError, match=r"got 1 of 2 that failed, LaneKeeping-v0/.* \(no idea\): mend the driver"):
        measured([failed, outcomes[1]])


def test_figures_that_an_agent_does_not_have_are_refused():
    env = open_env("CarFollowing", {"sky": "open"})
    with pytest.raises(ConfigError, match="speed_shar is not a known key"):
        make_agent("cautious", env, {"speed_shar": 0.5})
    with pytest.raises(InputError, match="figures must be empty for 'random'"):
        make_agent("random", env, {"x": 1})
    with pytest.raises(InputError, match="only agents of ours have figures"):
        make_agent("json:loads", env, {"x": 1})


def test_the_command_drives_and_says_what_it_chose(tmp_path, monkeypatch):
    monkeypatch.setattr("lanebound.agents.benchmark.tuning.LADDER", (0.0, 1.0))
    monkeypatch.setattr("lanebound.agents.benchmark.tuning.EPISODE", {"duration_s": 2.0})
    args = ["tune", "cautious", "CarFollowing", "--sky", "open", "--seeds", "1", "--jobs", "1", "--out", str(tmp_path)]
    result = CliRunner().invoke(app, args)
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert set(found["ladder"]) == {"0.0", "1.0"}
    assert found[GOAL]["episodes"] == 1
    assert found["matched"] in ("harm", "throughput")
    assert set(found) == {
        "environment", "base", "sky", "seeds", GOAL, "ladder", "caution", "matched", "figures",
    }  # fmt: skip
    assert set(found[GOAL]) >= {"harm", "collision", "lane_departure", "cost_lane", "mean_speed", "throughput"}
    assert found["figures"]["speed_share"] == pytest.approx(1.0 - 0.7 * found["caution"], abs=1e-3)
