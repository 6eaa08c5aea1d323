"""City drivers as arrays look, and start, as the objects do; how they drive is in ``test_equality``."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from highway_env.vehicle.kinematics import Vehicle

from lanebound.envs.batch import lanes_kernel as lk
from lanebound.envs.batch.lanes import lane_table
from lanebound.envs.vector import idm_kernel as idm
from lanebound.envs.vector import network_kernel as network_traffic
from lanebound.envs.vector.drivers_kernel import clear, seat
from lanebound.envs.worlds.drivers import CityDriver
from lanebound.envs.worlds.idm_parameters_kernel import CALM
from lanebound.envs.worlds.streets import UrbanCanyonWorld
from vehicles import driving, empty_rows


def _world(seed: int, **config: Any) -> UrbanCanyonWorld:
    world = UrbanCanyonWorld(config)
    world.reset(seed=seed)
    return world


def _started(world: UrbanCanyonWorld, seed: int) -> tuple[Any, Any]:
    """The records of one environment of a world, after a start."""
    support = world.support()
    car, drv = empty_rows(support.vehicles(world))
    clear(car, drv, Vehicle.LENGTH, Vehicle.WIDTH)
    start = support.starter(world, lane_table(world.road.network))
    count = start(np.random.Generator(np.random.PCG64(seed)), car, drv, np.zeros(1))
    seat(car, drv, count)
    assert not any(car[name][count:].any() for name in ("x", "y", "speed"))
    return car[:count], drv[:count]


def test_figures_are_those_of_the_drivers() -> None:
    kind = CityDriver
    assert CALM.twice_root == pytest.approx(2.0 * np.sqrt(-kind.COMFORT_ACC_MAX * kind.COMFORT_ACC_MIN), rel=1e-15)
    assert (idm.ACC_MOST, idm.BRAKING_IMPOSED) == (kind.ACC_MAX, kind.LANE_CHANGE_MAX_BRAKING_IMPOSED)


@pytest.mark.parametrize("count", [0, 14])
def test_an_episode_starts_as_the_worlds(count: int) -> None:
    crews = set()
    for seed in range(6):
        world = _world(seed, vehicles_count=count, spread=[-120.0, 200.0])
        car, drv = _started(world, seed)
        there, index = world.road.vehicles, lane_table(world.road.network).index
        crews.add(len(there))
        assert len(car) == len(there)
        assert (car["slot"] >= 0).sum() == len(there) - 1
        for i, v in enumerate(there):
            values = (*v.position, v.heading, v.speed, np.cos(v.heading), np.sin(v.heading))
            assert (*car[["x", "y", "heading", "speed"]][i], *drv[["cos", "sin"]][i]) == values
            assert index[car["lane"][i]] == index[drv["target"][i]] == v.lane_index == v.target_lane_index
            if isinstance(v, CityDriver):
                assert (drv["target_speed"][i], drv["timer"][i], drv["delta"][i]) == (v.target_speed, v.timer, v.DELTA)
    assert len(crews) > 2 or crews == {1} == {1 + count}


def test_lanes_hold_and_advise_as_the_objects() -> None:
    network, rng = _world(1).road.network, np.random.default_rng(3)
    table, out = lane_table(network), np.empty(8)
    lanes, found = table.lanes, 0
    for n, index in enumerate(table.index):
        lane = network.get_lane(index)
        for s in (-9.0, 0.0, lane.length, lane.length + 30.0, *rng.uniform(0.0, lane.length, 40)):
            assert lk.advised(lanes, n, s) == lane.advised_speed(s)
            point = lane.position(s, float(rng.uniform(-4.0, 4.0)))
            lk.stations(lanes, *point, 1.0, out)
            for other, place in zip(table.index, out, strict=True):
                there = network.get_lane(other)
                held = there.on_lane(point, *there.local_coordinates(point), 1.0)
                assert (place != lk.NOWHERE_M) == held
                found += held
                if held:
                    assert place == pytest.approx(there.local_coordinates(point)[0], abs=1e-9)
    assert found > 300


def test_neighbours_are_found_across_the_ends_of_roads() -> None:
    across = 0
    for seed in range(12):
        world = _world(seed, vehicles_count=40, spread=[-250.0, 250.0])
        network, table = world.road.network, lane_table(world.road.network)
        v = driving(*_started(world, seed))
        places = np.empty((v.x.size, len(table.index)))
        network_traffic.place_all.py_func(v, table.lanes, places)
        there = world.road.vehicles
        for i, vehicle in enumerate(there):
            for index in network.all_side_lanes(vehicle.lane_index):
                got = network_traffic._neighbours(v, table.lanes, places, table.row[index], i, 1)
                wanted = world.road.neighbour_vehicles(vehicle, index)
                assert got == tuple(-1 if other is None else there.index(other) for other in wanted)
                across += any(other is not None and other.lane_index[:2] != index[:2] for other in wanted)
    assert across > 5
