"""City drivers as arrays look, and start, as the objects do; how they drive is in ``test_equality``."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lanebound.envs.vector import city_kernel as city
from lanebound.envs.vector import columns_kernel as k
from lanebound.envs.vector import lanes_kernel as lk
from lanebound.envs.vector.lanes import lane_rows, lanes_of
from lanebound.envs.vector.start import most_vehicles, starter_of
from lanebound.envs.worlds.drivers import CityDriver
from lanebound.envs.worlds.lanes import ADVICE_STEP_M
from lanebound.envs.worlds.urban_canyon import UrbanCanyonWorld


def _world(seed: int, **config: Any) -> UrbanCanyonWorld:
    world = UrbanCanyonWorld(config)
    world.reset(seed=seed)
    return world


def _started(world: UrbanCanyonWorld, seed: int) -> tuple[Any, Any]:
    """The arrays of one environment of a world, after a start."""
    vehicles = most_vehicles(world)
    cars, whole = np.ones((k.CAR, vehicles)), np.ones((k.WHOLE, vehicles), dtype=np.int64)
    start = starter_of(world, lanes_of(world.road.network))
    start(np.random.Generator(np.random.PCG64(seed)), cars, whole, np.zeros(1))
    return cars, whole


def test_figures_are_those_of_the_drivers() -> None:
    calm, kind = city.CALM, CityDriver
    assert calm[:3] == (kind.DISTANCE_WANTED, kind.TIME_WANTED, kind.COMFORT_ACC_MAX)
    assert calm.twice_root == pytest.approx(2.0 * np.sqrt(-kind.COMFORT_ACC_MAX * kind.COMFORT_ACC_MIN), rel=1e-15)
    assert calm[4:] == (kind.LANE_CHANGE_DELAY, kind.LANE_CHANGE_MIN_ACC_GAIN)
    assert (city.REACTION_S, lk.ADVICE_STEP_M) == (kind.REACTION_S, ADVICE_STEP_M)
    assert (city.ACC_MAX, city.BRAKING_IMPOSED) == (kind.ACC_MAX, kind.LANE_CHANGE_MAX_BRAKING_IMPOSED)


@pytest.mark.parametrize("count", [0, 14])
def test_an_episode_starts_as_the_worlds(count: int) -> None:
    crews = set()
    for seed in range(6):
        world = _world(seed, vehicles_count=count, spread=[-120.0, 200.0])
        cars, whole = _started(world, seed)
        there, network = world.road.vehicles, world.road.network
        crews.add(len(there))
        assert whole[k.PRESENT].tolist() == [1] * len(there) + [0] * (1 + count - len(there))
        for i, v in enumerate(there):
            values = (*v.position, v.heading, v.speed, np.cos(v.heading), np.sin(v.heading))
            assert tuple(cars[[k.X, k.Y, k.HEADING, k.SPEED, k.COS, k.SIN], i]) == values
            assert lane_rows(network)[whole[k.LANE, i]] == v.lane_index == v.target_lane_index
            if isinstance(v, CityDriver):
                wanted = v.target_speed, v.timer, v.DELTA
                assert tuple(cars[[k.TARGET_SPEED, k.TIMER, k.DELTA], i]) == wanted
        assert not cars[[k.X, k.Y, k.SPEED], len(there) :].any()
    assert len(crews) > 2 or crews == {1} == {1 + count}


def test_lanes_hold_and_advise_as_the_objects() -> None:
    network, rng = _world(1).road.network, np.random.default_rng(3)
    lanes, out = lanes_of(network), np.empty(8)
    found = 0
    for n, index in enumerate(lane_rows(network)):
        lane = network.get_lane(index)
        before = lane_rows(network)[int(lanes.table[n, lk.BEFORE])]
        assert (before[1], before[2]) == (index[0], index[2])
        for s in (-9.0, 0.0, lane.length, lane.length + 30.0, *rng.uniform(0.0, lane.length, 40)):
            assert lk.advised(lanes, n, s) == lane.advised_speed(s)
            point = lane.position(s, float(rng.uniform(-4.0, 4.0)))
            lk.stations(lanes, *point, 1.0, out)
            for other, place in zip(lane_rows(network), out, strict=True):
                there = network.get_lane(other)
                held = there.on_lane(point, *there.local_coordinates(point), 1.0)
                assert (place != lk.NOWHERE) == held
                found += held
                if held:
                    assert place == pytest.approx(there.local_coordinates(point)[0], abs=1e-9)
    assert found > 300


def test_neighbours_are_found_across_the_ends_of_roads() -> None:
    across = 0
    for seed in range(12):
        world = _world(seed, vehicles_count=40, spread=[-250.0, 250.0])
        lanes, rows, network = lanes_of(world.road.network), lane_rows(world.road.network), world.road.network
        cars, whole = _started(world, seed)
        places = np.empty((cars.shape[1], len(rows)))
        city.place_everybody(cars, whole, lanes, places)
        there = world.road.vehicles
        for i, v in enumerate(there):
            for index in network.all_side_lanes(v.lane_index):
                got = city._neighbours(cars, whole, lanes, places, rows.index(index), i)
                wanted = world.road.neighbour_vehicles(v, index)
                assert got == tuple(-1 if other is None else there.index(other) for other in wanted)
                across += any(other is not None and other.lane_index[:2] != index[:2] for other in wanted)
    assert across > 5
