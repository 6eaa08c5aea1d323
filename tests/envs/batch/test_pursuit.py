"""Under meta-actions a car with wheels of a limited rate stays in its lane from rest, through changes and bends."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from highway_env.road.lane import CircularLane, StraightLane
from highway_env.road.road import RoadNetwork

from lanebound.envs import DrivingEnv, make_config
from lanebound.envs.batch.ego_kernel import pursuit_rad
from lanebound.envs.batch.lanes import lane_table
from lanebound.envs.batch.records_kernel import BELIEF
from vehicles import record_of

LEFT, IDLE, RIGHT, FASTER = 0, 1, 2, 3
KNOWN: dict[str, Any] = {
    "sky": "open",
    "navigation": {"source": "perfect"},
    "perception": {"source": "none"},
    "world": {"vehicles_count": 0},
}


def _offsets(env: DrivingEnv, commands: list[int]) -> list[float]:
    """Offset from the middle of the lane that is aimed at, after each decision."""
    found = []
    for command in commands:
        *_, terminated, _, info = env.step(command)
        assert not terminated, info
        car = env.world.vehicle
        found.append(float(env.world.road.network.get_lane(car.target_lane_index).local_coordinates(car.position)[1]))
    return found


@pytest.mark.parametrize("seed", range(4))
def test_a_start_from_rest_beside_the_middle_stays_in_the_lane(seed: int) -> None:
    env = DrivingEnv(make_config("lanebound/UrbanCanyon-v0", KNOWN))
    env.reset(seed=seed)
    car = env.world.vehicle
    s, _ = car.lane.local_coordinates(car.position)
    car.position, car.speed = car.lane.position(s, 0.3), 0.0
    assert max(map(abs, _offsets(env, [FASTER] * 16))) < 0.5


@pytest.mark.parametrize("seed", range(4))
def test_a_change_at_a_crawl_and_speed_after_it_settle(seed: int) -> None:
    env = DrivingEnv(make_config("lanebound/UrbanCanyon-v0", KNOWN))
    env.reset(seed=seed)
    env.world.vehicle.speed = 4.0
    change = RIGHT if env.world.vehicle.lane_index[2] == 0 else LEFT
    offsets = _offsets(env, [change, FASTER, FASTER] + [IDLE] * 12)
    side = np.sign(offsets[0])
    assert min(side * np.array(offsets)) > -0.6
    assert max(map(abs, offsets[-4:])) < 0.5


def _steering(network: RoadNetwork, x: float, y: float, heading_rad: float, speed_mps: float) -> float:
    """Steering towards lane 0, beyond whose end lies lane 1 if there is one."""
    belief = record_of(BELIEF, x_m=x, y_m=y, heading_rad=heading_rad, speed_mps=speed_mps)
    table = lane_table(network)
    return float(pursuit_rad(table.lanes, 0, 1 if len(table.index) > 1 else -1, belief, 5.0))


def test_on_a_circle_the_wheels_stand_as_its_radius_asks() -> None:
    """At radius R the slip angle is asin(L / 2 R): the course is along the circle, the heading less by that."""
    network, radius_m = RoadNetwork(), 40.0
    network.add_lane("a", "b", CircularLane([0.0, 0.0], radius_m, 0.0, 3.0, clockwise=True))
    slip = np.arcsin(2.5 / radius_m)
    found = _steering(network, radius_m, 0.0, 0.5 * np.pi - slip, 5.0)
    assert found == pytest.approx(np.arctan(2.0 * np.tan(slip)), rel=0.03)


def test_it_turns_to_the_lane_and_looks_beyond_its_end() -> None:
    network = RoadNetwork()
    network.add_lane("a", "b", StraightLane([0.0, 0.0], [50.0, 0.0]))
    network.add_lane("b", "c", StraightLane([50.0, 0.0], [50.0, 80.0]))
    assert _steering(network, 10.0, 0.0, 0.0, 5.0) == pytest.approx(0.0, abs=1e-12)
    assert _steering(network, 10.0, -1.0, 0.0, 5.0) > 0.05
    assert _steering(network, 10.0, 1.0, 0.0, 5.0) < -0.05
    assert _steering(network, 46.0, 0.0, 0.0, 5.0) > 0.05
    assert abs(_steering(network, 10.0, 40.0, 0.0, 0.0)) < np.pi / 2
