"""The three worlds: whole episodes by highway-env's own drivers, determinism, rewards and ends."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import ControlledVehicle

from lanebound.envs.worlds import CarFollowingWorld, LaneKeepingWorld, UrbanCanyonWorld
from lanebound.envs.worlds.base import CONTINUOUS, META, World
from lanebound.envs.worlds.drivers import CityDriver
from lanebound.integrity.sky.city import SectionKind

WORLDS: list[type[World]] = [LaneKeepingWorld, CarFollowingWorld, UrbanCanyonWorld]
LIGHT: dict[str, Any] = {"observation": {"type": "TimeToCollision"}}
DISCRETE: dict[str, Any] = {"action": META, "policy_frequency": 2}
STEADY: dict[str, Any] = {"action": CONTINUOUS, "policy_frequency": 5}


class Blank:
    """An observation that costs nothing."""

    def observe(self) -> np.ndarray:
        return np.zeros(1)

    def space(self) -> gym.spaces.Space[Any]:
        return gym.spaces.Box(0.0, 1.0, (1,))


def started(world: type[World], seed: int = 0, **config: Any) -> World:
    env = world(config)
    env.reset(seed=seed)
    env.observation_type = Blank()
    return env


def drive(env: World, driver: type[ControlledVehicle], speed: float) -> float:
    """Let a driver take the ego's place to the end; the largest offset from the middle of the lane it wants."""
    old = env.vehicle
    new = driver.create_from(old)
    new.target_speed, new.enable_lane_change = speed, False
    env.road.vehicles[env.road.vehicles.index(old)] = new
    env.vehicle = new
    worst, over = 0.0, False
    while not over:
        _, _, terminated, truncated, _ = env.step(None)
        over = terminated or truncated
        worst = max(worst, abs(env.road.network.get_lane(new.target_lane_index).local_coordinates(new.position)[1]))
    assert truncated
    assert not terminated
    return worst


@pytest.mark.parametrize("driver", [IDMVehicle, CityDriver])
@pytest.mark.parametrize("world", WORLDS)
def test_a_driver_keeps_its_lane_for_a_whole_episode(world: type[World], driver: type[ControlledVehicle]) -> None:
    # the plain one does not slow for bends; its own steering law cuts corners, and it reverses at standstill
    env = started(world, seed=1, vehicles_count=2, **DISCRETE)
    worst = drive(env, driver, 9.0)
    assert env.time == pytest.approx(env.config["duration"])
    assert worst < (0.4 if driver is CityDriver else 0.625)


def test_a_meta_action_vehicle_idles_through_the_bends() -> None:
    env = started(LaneKeepingWorld, lanes_count=2, **DISCRETE)
    over, worst = False, 0.0
    while not over:
        _, reward, terminated, over, _ = env.step(1)
        assert not terminated
        assert 0.0 <= reward <= 1.0
        worst = max(worst, abs(env.vehicle.lane_offset[1]))
    assert env.time == pytest.approx(env.config["duration"])
    assert worst < 0.4


@pytest.mark.parametrize("config", [DISCRETE, STEADY])
@pytest.mark.parametrize("world", WORLDS)
def test_random_actions_stay_within_the_spaces(world: type[World], config: dict[str, Any]) -> None:
    env = world(config)
    env.action_space.seed(0)
    observation, _ = env.reset(seed=3)
    for _ in range(30):
        assert env.observation_space.contains(observation)
        action = env.action_space.sample()
        observation, reward, terminated, truncated, info = env.step(action)
        assert 0.0 <= reward <= 1.0
        assert set(info["rewards"]) == {"progress_reward", "centring_reward", "collision_reward"}
        if terminated or truncated:
            observation, _ = env.reset()
            env.action_space.seed(1)


@pytest.mark.parametrize("world", WORLDS)
def test_equal_seeds_give_equal_bits(world: type[World]) -> None:
    def trace(env: World) -> np.ndarray:
        rows = []
        for k in range(12):
            env.step(np.array([0.2, 0.01 * k]))
            rows.append(np.concatenate([v.position for v in env.road.vehicles]))
        return np.array(rows)

    first, second = (started(world, seed=5, **STEADY) for _ in range(2))
    twin = copy.deepcopy(first)
    other = started(world, seed=6, **STEADY)
    expected = trace(first)
    assert np.array_equal(expected, trace(second))
    assert np.array_equal(expected, trace(twin))
    assert not np.array_equal(expected[:, :2], trace(other)[:, :2])


@pytest.mark.parametrize("world", WORLDS)
def test_a_world_can_be_pickled(world: type[World]) -> None:
    env = started(world, seed=2, **STEADY)
    twin = pickle.loads(pickle.dumps(env))
    for one in (env, twin):
        one.step(np.zeros(2))
    assert np.array_equal(env.vehicle.position, twin.vehicle.position)


def test_neither_reversing_nor_standing_is_rewarded() -> None:
    env = started(LaneKeepingWorld, **STEADY)
    moving = env._rewards(None)
    env.vehicle.speed = -3.0
    assert env._rewards(None) == {"progress_reward": 0.0, "centring_reward": 0.0, "collision_reward": 0.0}
    env.vehicle.speed = 100.0
    assert env._rewards(None)["progress_reward"] == 1.0
    assert moving["centring_reward"] == pytest.approx(1.0)


def test_leaving_the_road_or_turning_round_ends_the_episode() -> None:
    env = started(LaneKeepingWorld, **STEADY)
    assert not env._is_terminated()
    place, heading = env.vehicle.position.copy(), env.vehicle.heading
    env.vehicle.position = env.vehicle.lane.position(300.0, 1.7)
    env.vehicle.on_state_update()
    assert env._is_terminated()
    env.vehicle.position, env.vehicle.heading = place, heading + 2.0
    env.vehicle.on_state_update()
    assert env._is_terminated()


def test_the_road_can_come_to_its_end_before_time_is_up() -> None:
    env = started(LaneKeepingWorld, duration=1000.0, **STEADY)
    lane = env.vehicle.lane
    env.vehicle.position = lane.position(lane.length - 15.0, 0.0)
    assert env._is_truncated()
    assert not env._is_terminated()


def test_the_lead_vehicle_starts_at_the_stated_gap() -> None:
    for seed in range(5):
        env = started(CarFollowingWorld, seed=seed)
        assert isinstance(env, CarFollowingWorld)
        assert 2.0 + 0.8 * env.vehicle.speed - 1e-9 <= env.gap_m() <= 2.0 + env.vehicle.speed + 1e-9
        assert env.lead.speed == env.vehicle.speed


def test_gap_closes_to_zero_when_the_cars_touch() -> None:
    env = started(CarFollowingWorld, **STEADY)
    assert isinstance(env, CarFollowingWorld)
    terminated, gap = False, env.gap_m()
    while not terminated:
        gap = env.gap_m()
        _, _, terminated, _, _ = env.step(np.array([1.0, 0.0]))
    assert env.vehicle.crashed
    assert gap > 0.0


def test_sections_name_stretches_of_the_loop_without_gaps() -> None:
    env = started(UrbanCanyonWorld)
    graph = env.road.network.graph
    ends: dict[tuple[str, str], float] = {}
    for a, b, start, end, kind in env.sections:
        assert start == ends.get((a, b), 0.0)
        assert start < end
        ends[a, b] = end
        assert kind in set(SectionKind)
    assert ends == {(a, b): lanes[0].length for a, to in graph.items() for b, lanes in to.items()}
    assert started(LaneKeepingWorld).sections == ()


def test_traffic_starts_apart_and_drives_on() -> None:
    env = started(UrbanCanyonWorld, seed=4)
    places = np.array([v.position for v in env.road.vehicles])
    apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1)) + 1e6 * np.eye(len(places))
    assert len(places) > 6
    assert apart.min() >= 20.0
    for _ in range(40):
        env.step(1)
    assert not any(v.crashed for v in env.road.vehicles if v is not env.vehicle)
