"""The other vehicles: who they are, where they are, and what they would broadcast."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from highway_env.road.lane import CircularLane, SineLane, StraightLane

from lanebound.envs import DrivingEnv, make_config
from lanebound.envs.fleet import along


@pytest.mark.parametrize(
    "lane",
    [
        StraightLane([0, 4], [30.0, 40.0]),
        SineLane([5.0, 4.0], [60.0, 8.0], amplitude=2.0, pulsation=0.1, phase=0.3),
        CircularLane([0.0, 0.0], 20.0, 0.2, 2.0),
    ],
)
def test_longitudinal_coordinates_are_those_of_the_lane(lane: Any) -> None:
    rng = np.random.default_rng(0)
    for position in 30.0 * rng.standard_normal((50, 2)):
        assert along(lane, position) == pytest.approx(lane.local_coordinates(position)[0], abs=1e-9)


@pytest.fixture(scope="module")
def env() -> DrivingEnv:
    config = {"world": {"vehicles_count": 6}, "perception": {"source": "v2v"}, "sky": "open", "simulation_hz": 10}
    env = DrivingEnv(make_config("lanebound/Highway-v0", config))
    env.reset(seed=3)
    env.step(1)
    return env


def test_those_present_are_the_vehicles_of_the_world_and_the_ego_last(env: DrivingEnv) -> None:
    assert env.cockpit is not None
    fleet, ego = env.cockpit.around.fleet, env.world.vehicle
    there, world = fleet.present(), [*(v for v in env.world.road.vehicles if v is not ego), ego]
    np.testing.assert_array_equal(there.position_m, [v.position for v in world])
    np.testing.assert_array_equal(there.heading_rad, [v.heading for v in world])
    np.testing.assert_array_equal(there.speed_mps, [v.speed for v in world])
    assert there.slot[-1] == fleet.ego_slot
    assert there.key[-1] == fleet.EGO_KEY
    assert len(set(there.key)) == len(world)
    assert set(there.length_m) == {ego.LENGTH}
    assert set(there.width_m) == {ego.WIDTH}


def test_claims_are_the_solutions_in_the_plane_and_the_ego_is_silent(env: DrivingEnv) -> None:
    assert env.cockpit is not None
    fleet = env.cockpit.around.fleet
    claims, solution = fleet.claims(), fleet.solution
    assert solution is not None
    np.testing.assert_array_equal(claims.position_m[:-1], solution.position_en_m * [1.0, -1.0])
    np.testing.assert_array_equal(claims.speed_mps[:-1], solution.speed_mps)
    np.testing.assert_array_equal(claims.pl_ct_m[:-1], solution.pl_ct_m)
    assert claims.initialised[:-1].all()
    assert not claims.initialised[-1]
    true = np.array([v.position for v in fleet.vehicles])
    assert np.abs(claims.position_m[fleet.rows] - true).max() < 3.0
