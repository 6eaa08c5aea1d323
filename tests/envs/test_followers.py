"""Followers on a motorway: who stops at once may be hit from behind, who drives on is not."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

from lanebound.envs import IDS, DrivingEnv, make_config
from lanebound.envs.worlds.followers import LateDriver
from lanebound.integrity.core.errors import ConfigError

GIVEN: dict[str, Any] = {
    "sky": "open", "navigation": {"source": "perfect"}, "perception": {"source": "truth"},
    "observation": {"form": "flat"}, "world": {"vehicles_count": 3},
}  # fmt: skip
IDLE, SLOWER = 1, 4


def followed(behind: int = 2, **changes: Any) -> DrivingEnv:
    """A motorway with followers."""
    return DrivingEnv(make_config("lanebound/Highway-v0", {**GIVEN, "traffic": {"behind": behind, **changes}}))


def test_followers_begin_behind_the_ego_at_the_stated_gaps() -> None:
    env = followed(3, gap_s=[1.0, 1.2])
    for seed in range(6):
        env.reset(seed=seed)
        ego, late = env.world.vehicle, [v for v in env.world.road.vehicles if isinstance(v, LateDriver)]
        assert len(late) == 3
        assert late[0].lane_index == ego.lane_index
        stations = [float(v.position[0]) for v in (ego, *late)]
        gaps = -np.diff(stations) - ego.LENGTH
        assert np.all((gaps >= 1.0 * ego.speed - 1e-9) & (gaps <= 1.2 * ego.speed + 1e-9))


def test_without_followers_a_seed_gives_the_same_vehicles_as_before() -> None:
    poses = []
    for behind in (0, 2):
        env = followed(behind)
        env.reset(seed=4)
        poses.append([tuple(v.position) for v in env.world.road.vehicles if not isinstance(v, LateDriver)])
    assert poses[0] == poses[1]


def test_what_a_late_driver_decides_takes_effect_with_a_lag() -> None:
    """A step of its decision from 0 has taken effect by 1 - 1/e after the time constant, within a step of 20 Hz."""
    env = followed(1, reaction_s=1.0)
    env.reset(seed=1)
    driver = next(v for v in env.world.road.vehicles if isinstance(v, LateDriver))
    driver.road.vehicles = [driver]
    driver.target_speed = driver.speed = 20.0
    driver.felt_mps2, found = -4.0, list[float]()
    for _ in range(20):
        driver.speed = driver.target_speed  # so that it decides 0
        driver.act()
        found.append(float(driver.action["acceleration"]))
    assert found[-1] == pytest.approx(-4.0 * np.exp(-1.0), rel=0.05)


@pytest.mark.parametrize(("every", "least", "most"), [(1, 10, 12), (6, 0, 0), (99, 0, 0)])
def test_to_stop_at_once_is_a_hazard_and_to_slow_down_is_not(every: int, least: int, most: int) -> None:
    """12 starts with one follower and nobody else; 5 m/s less at every so many decisions, of 0.5 s."""
    hit = 0
    env = DrivingEnv(make_config("lanebound/Highway-v0", {**GIVEN, "world": {"vehicles_count": 0},
                                                          "traffic": {"behind": 1}}))  # fmt: skip
    for seed in range(12):
        env.reset(seed=seed)
        for k in range(20):
            *_, terminated, truncated, info = env.step(IDLE if k % every else SLOWER)
            if terminated or truncated:
                break
        hit += info["crashed"]
        assert info["cost_collision"] == info["crashed_now"]
    assert least <= hit <= most


@pytest.mark.parametrize("action", [SLOWER, IDLE])
def test_the_engine_has_the_same_followers(action: int) -> None:
    config = {**GIVEN, "traffic": {"behind": 3}}
    env = DrivingEnv(make_config("lanebound/Highway-v0", config))
    engine = gymnasium.make_vec("lanebound/Highway-v0", num_envs=2, config=config, autoreset_mode="Disabled")
    for seed in (5, 8):
        one, _ = env.reset(seed=seed)
        many, _ = engine.reset(seed=seed)
        for _ in range(24):
            np.testing.assert_allclose(many[0], one, atol=2e-5)
            one, _, terminated, truncated, info = env.step(action)
            many, *_, infos = engine.step(np.array([action, action]))
            assert infos["crashed"][0] == info["crashed"]
            if terminated or truncated:
                break
    engine.close()


@pytest.mark.parametrize("env_id", [name for name in IDS if "Highway" not in name])
def test_where_there_is_no_room_followers_are_refused(env_id: str) -> None:
    with pytest.raises(ConfigError, match=r"traffic\.behind must be 0 in"):
        make_config(env_id, {"traffic": {"behind": 1}})


def test_gaps_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"traffic\.gap_s must be two numbers from 0\.3 to 10"):
        make_config("lanebound/Highway-v0", {"traffic": {"gap_s": [2.0, 1.0]}})
