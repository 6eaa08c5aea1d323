"""Deliberately bad policies: they do what their names say, and are left out where no action allows it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lanebound.agents.benchmark.suite import load_suite
from lanebound.agents.drivers import make_agent
from lanebound.agents.drivers.base import Reader
from lanebound.agents.drivers.degenerate import WeaveConfig
from lanebound.agents.episodes import open_env
from lanebound.envs import IDS
from lanebound.integrity.core.errors import InputError

GIVEN: dict[str, Any] = {"navigation": {"source": "perfect"}, "perception": {"source": "truth"}, "sky": "open"}


def driven(name: str, agent: str, figures: dict[str, Any] | None, seconds: float) -> tuple[np.ndarray, Any]:
    """Speed and offset in the lane at each decision, and the environment."""
    env = open_env(name, GIVEN | {"duration_s": seconds})
    policy, reader = make_agent(agent, env, figures), Reader(env.config.observation)
    observation, _ = env.reset(seed=1)
    rows, state, start = [], None, np.ones(1, dtype=np.bool_)
    for _ in range(int(seconds / env.dt_s)):
        action, state = policy.predict(observation, state=state, episode_start=start)
        observation, _, terminated, truncated, _ = env.step(action)
        rows.append([reader.value(observation, f"ego.{entry}") for entry in ("speed", "lateral_offset", "lane_share")])
        start = np.zeros(1, dtype=np.bool_)
        if terminated or truncated:
            break
    return np.array(rows), env


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5])
def test_a_constant_share_of_the_limit_is_driven(share: float) -> None:
    rows, env = driven("LaneKeeping", "constant", {"share": share}, 20.0)
    limit = env.world.vehicle.lane.speed_limit
    assert rows[-20:, 0] == pytest.approx(share * limit, abs=0.6)


@pytest.mark.parametrize(
    ("name", "speeds"), [("Roundabout", [0.0, 4.0, 4.0, 8.0]), ("Intersection", [0.0, 2.0, 4.0, 6.0])]
)
def test_shares_are_of_the_fastest_speed_that_an_id_has(name: str, speeds: list[float]) -> None:
    """Half of Roundabout's limit of 16 m/s would be its largest target speed, as full throttle is."""
    env = open_env(name, GIVEN | {"duration_s": 5.0})
    observation, _ = env.reset(seed=1)
    shares = (0.0, 0.25, 0.5, 5.0)
    wanted = [float(make_agent("constant", env, {"share": share}).plan.wanted_speed(observation)) for share in shares]
    assert wanted == speeds


def test_full_throttle_ignores_the_vehicle_ahead() -> None:
    rows, env = driven("CarFollowing", "constant", {"share": 5.0, "accelerate_mps2": 6.0}, 20.0)
    assert env.world.vehicle.crashed
    assert rows[:, 0].max() > 10.0


def test_the_bank_drives_and_then_stands() -> None:
    rows, env = driven("LaneKeeping", "bank", {"time_share": 0.6}, 40.0)
    stops = int(0.6 * 40.0 / env.dt_s)
    assert rows[stops - 10 : stops, 0].min() > 5.0
    assert rows[-5:, 0].max() < 0.1


def test_the_bank_begins_anew_with_an_episode() -> None:
    env = open_env("LaneKeeping", GIVEN)
    policy = make_agent("bank", env)
    observation, _ = env.reset(seed=1)
    go, _ = policy.predict(observation, state=(np.zeros(()),))
    stop, state = policy.predict(observation, state=(np.array(1e6),))
    anew, _ = policy.predict(observation, state=state, episode_start=np.ones(1, dtype=np.bool_))
    assert go[0] > stop[0]
    assert np.array_equal(go, anew)


def test_weaving_crosses_the_lane_from_side_to_side() -> None:
    rows, _ = driven("LaneKeeping", "weave", None, 30.0)
    assert rows[:, 1].max() > 0.5 * WeaveConfig().turn_m
    assert rows[:, 1].min() < -0.5 * WeaveConfig().turn_m


def test_weaving_changes_lanes_by_meta_actions() -> None:
    rows, _ = driven("UrbanCanyon", "weave", None, 30.0)
    assert len(set(rows[:, 2].round(3))) > 1


def test_the_suite_covers_all_ids_and_leaves_out_what_cannot_be_commanded() -> None:
    suite = load_suite("degenerate")
    assert {f"lanebound/{env}" for env in suite.envs} == set(IDS)
    assert suite.references == ("integrity_aware",)
    with pytest.raises(InputError, match="steer or change lanes"):
        make_agent("weave", open_env("Intersection", GIVEN))
    for agent in ("bank", "constant"):
        with pytest.raises(InputError, match="commands speed"):
            make_agent(agent, open_env("Racetrack", GIVEN))
    make_agent("weave", open_env("Racetrack", GIVEN))
