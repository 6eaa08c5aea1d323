"""A platoon on the loop of a city: a leader that slows down for bends, followers that react late, the ego between."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import lanebound.envs
from lanebound.agents.drivers import make_agent
from lanebound.envs import DrivingEnv, make_config
from lanebound.envs.alert_limits import AlertLimit
from lanebound.envs.worlds.drivers import CALM, slow_for_bends
from lanebound.envs.worlds.followers import PlatoonDriver
from lanebound.envs.worlds.networks import city_loop
from lanebound.envs.worlds.paths import Path, Pose, straight
from lanebound.envs.worlds.platoon import CANYON, START_M
from lanebound.integrity.core.errors import ConfigError
from side_by_side import PERFECT, Pairs, Tally, drive, pair, require_equal

ID = "lanebound/Platoon-v0"
GIVEN: dict[str, Any] = {"sky": "open", **PERFECT}
TUNNEL_END_M = 538.5 + 370.0  # along the loop from the beginning of the lane of the canyon
DT_S = 0.05


def stations(env: DrivingEnv) -> list[float]:
    """Of the vehicles from the first to the last, along the loop [m]."""
    vehicles, place = env.world.road.vehicles, env.world.place
    order = [*vehicles[1:place], vehicles[0], *vehicles[place:]]
    begins = {"a": -592.3, "b": 0.0, "c": 538.5}
    return [begins[v.lane_index[0]] + float(v.lane.local_coordinates(v.position)[0]) for v in order]


@pytest.mark.parametrize(("vehicles", "place", "ego"), [(5, None, 2), (4, None, 2), (8, None, 4), (8, 8, 7), (6, 2, 1)])
def test_the_ego_has_its_place_and_all_begin_at_one_speed(vehicles: int, place: int | None, ego: int) -> None:
    env = DrivingEnv(make_config(ID, {**GIVEN, "world": {"vehicles": vehicles, "place": place}}))
    for seed in range(5):
        env.reset(seed=seed)
        at, speeds = stations(env), {v.speed for v in env.world.road.vehicles}
        (speed,) = speeds
        assert len(at) == vehicles
        assert START_M[0] <= at[ego] <= START_M[1]
        between = -np.diff(at) - 5.0
        assert np.all(between > 2.0 + 0.8 * speed - 0.2)  # where a lane begins, its length is rounded
        assert np.all(between < 2.0 + 1.0 * 13.9 + 0.2)  # a bend may slow the first one down
        again = DrivingEnv(env.config)
        again.reset(seed=seed)
        assert stations(again) == at
        assert np.abs(again.world.road.vehicles[1].profile_mps - env.world.road.vehicles[1].profile_mps).max() == 0.0


def test_on_a_straight_road_the_profile_is_driven_as_it_is_drawn() -> None:
    network = type(city_loop(3.25))()
    network.add_road(("b", "c"), Path.of(Pose(0.0, 0.0, 0.0), straight(4000.0)), 1, 3.25)
    slow = np.concatenate([np.linspace(5.0, 9.0, 100), np.full(50, 9.0), np.linspace(9.0, 0.0, 60), np.zeros(40)])
    assert np.allclose(slow_for_bends(slow, network, CANYON, 10.0, DT_S), slow)


def test_the_leader_slows_down_for_bends_and_speeds_up_in_comfort() -> None:
    network = city_loop(3.25, lanes=1)
    found = slow_for_bends(np.full(1800, 13.0), network, CANYON, 0.0, DT_S)
    along, lane = np.cumsum(found) * DT_S, network.get_lane(CANYON)
    here = along < lane.length - 20.0
    advised = np.array([lane.advised_speed(s) for s in along[here]])
    assert np.max(found[here] - advised) < 1.0  # it reaches the advised speed within the reaction time
    assert found[here].min() < 9.5
    assert np.diff(found).max() <= CALM.comfort * DT_S + 1e-12
    assert found[-1] > found.min()


def test_most_come_through_the_tunnel() -> None:
    env = DrivingEnv(make_config(ID, GIVEN))
    ends = []
    for seed in range(60):
        seats, speeds = env.world.draw_seats(np.random.default_rng(seed))
        assert speeds is not None
        ends.append(seats[0].along_m + float(np.sum(speeds)) * DT_S)
    assert np.mean(np.array(ends) - 30.0 > TUNNEL_END_M) > 0.75  # the ego falls back by some 20 m where it stretches


def test_the_first_drives_its_profile_whoever_follows() -> None:
    env = DrivingEnv(make_config(ID, GIVEN))
    env.reset(seed=4)
    first = env.world.road.vehicles[1]
    for n in range(1, 8):
        env.step(np.array([-0.2, 0.0], np.float32))
        assert first.speed == pytest.approx(first.profile_mps[4 * n], abs=1e-12)


def test_followers_react_late_and_brake_no_more_than_they_can() -> None:
    env = DrivingEnv(make_config(ID, {**GIVEN, "world": {"vehicles": 4, "place": 2}}))
    env.reset(seed=1)
    behind = env.world.road.vehicles[2]
    felt = []
    for _ in range(8):
        env.step(np.array([-1.0, 0.0], np.float32))
        felt.append(behind.felt_mps2)
    assert min(felt) >= -PlatoonDriver.brake_mps2
    assert felt[0] > -1.5  # 0.2 s after the ego brakes with 6 m/s2
    assert min(felt) < -3.0


def test_a_car_that_stops_at_once_is_mostly_hit_from_behind() -> None:
    env = DrivingEnv(make_config(ID, GIVEN))
    hit = 0
    for seed in range(12):
        env.reset(seed=seed)
        for _ in range(25):
            *_, terminated, truncated, info = env.step(np.array([-1.0, 0.0], np.float32))
            if terminated or truncated:
                break
        hit += info["crashed"]
    assert hit >= 6


def test_a_driver_that_knows_all_drives_through_and_nobody_crashes() -> None:
    """Of traffic alone: 24 platoons of eight behind this leader had no crash, at most 1 in 8 (95 %)."""
    config = {**GIVEN, "observation": {"form": "flat"}, "world": {"vehicles": 8}}
    envs = gymnasium.make_vec(ID, 8, config=config, autoreset_mode="Disabled")
    agent = make_agent("nominal", DrivingEnv(make_config(ID, config)))
    observations, _ = envs.reset(seed=100)
    start, state, over, success = np.ones(8, dtype=np.bool_), None, np.zeros(8, dtype=np.bool_), np.zeros(8)
    while not over.all():
        actions, state = agent.predict(observations, state=state, episode_start=start)
        observations, _, terminated, truncated, infos = envs.step(actions)
        start = np.zeros(8, dtype=np.bool_)
        assert not infos["crashed"].any()
        over, success = over | terminated | truncated, success + infos["is_success"]
    assert not envs.unwrapped.engine.episodes.cars["crashed"].any()  # type: ignore[attr-defined]
    assert success.tolist() == [1.0] * 8


@pytest.mark.parametrize("world", [{}, {"vehicles": 8, "place": 8}])
def test_the_engine_drives_it_as_the_single_environment(world: dict[str, Any]) -> None:
    single, engine = pair("Platoon", {**PERFECT, "world": world})
    tally = Tally()
    for seed in range(4):
        drive(single, engine, seed, tally, 60)
    require_equal(tally)
    assert tally.steps > 40
    assert tally.crashes >= 1


def test_with_navigation_and_waiting_episodes_too() -> None:
    pairs = Pairs("Platoon", {"sky": "open", "cities": {"count": 1}, "extent_m": 300.0}, 2, 5)
    pairs.step(8)
    pairs.reset(np.arange(2), None)
    pairs.step(8)
    require_equal(pairs.tally)


@pytest.mark.parametrize(
    ("world", "name"),
    [
        ({"vehicles": 3}, "world.vehicles must be .* between 4 and 8"),
        ({"vehicles": 9}, "world.vehicles must be .* between 4 and 8"),
        ({"place": 1}, "world.place must be .* between 2 and 8"),
        ({"vehicles": 4, "place": 5}, "world.place must be at most world.vehicles = 4, got 5"),
        ({"lead": {"stops": 1}}, "lead.stops"),
    ],
)
def test_a_platoon_that_cannot_be_is_refused(world: dict[str, Any], name: str) -> None:
    with pytest.raises(ConfigError, match=name):
        DrivingEnv(make_config(ID, {"world": world}))


def test_it_is_an_environment_as_the_others() -> None:
    env = gymnasium.make(ID, config=GIVEN)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()
    assert ID not in lanebound.envs.IDS  # suites and pages of results do not drive it
    config = make_config(ID)
    assert config.alert_limit is AlertLimit.BUDGET
    assert config.perception.others_navigate


def test_the_whole_platoon_navigates_in_canyon_and_tunnel() -> None:
    env = DrivingEnv(make_config(ID))
    env.reset(seed=2)
    env.step(np.zeros(2, np.float32))
    loop = env.belief_loop
    assert loop is not None
    assert loop.solution is not None
    assert loop.solution.batch == 5
    kinds = {kind for *_, kind in env.world.sections}
    assert {"dense_canyon", "tunnel"} <= kinds
    assert len(loop.traffic.key) == 4
