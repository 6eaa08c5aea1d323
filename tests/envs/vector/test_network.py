"""Roads that join, fork and meet: lanes, routes, neighbours, right of way and starts are highway-env's."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from highway_env.vehicle.kinematics import Vehicle

from lanebound.envs.batch import next_lane_kernel as nk
from lanebound.envs.batch.lanes import lane_table
from lanebound.envs.batch.lanes_kernel import nearest
from lanebound.envs.core import DrivingEnv
from lanebound.envs.registration import make_config
from lanebound.envs.vector import network_kernel as network_traffic
from lanebound.envs.vector.drivers_kernel import clear, seat
from lanebound.envs.vector.engine import Engine
from lanebound.envs.vector.support import roads_of, support_of
from lanebound.integrity.core.errors import ConfigError
from side_by_side import PERFECT, Tally, drive, pair, require_equal
from vehicles import driving, empty_rows

NAMES = ("Racetrack", "Merge", "Roundabout", "Intersection")


def _single(name: str, seed: int, **config: Any) -> DrivingEnv:
    single = DrivingEnv(make_config(f"lanebound/{name}-v0", {**PERFECT, **config}))
    single.world.reset(seed=seed)
    return single


def _started(single: DrivingEnv, seed: int) -> tuple[Any, Any]:
    """The records of one environment, after a start."""
    support, world = support_of(single.config), single.world
    car, drv = empty_rows(support.vehicles(world))
    clear(car, drv, Vehicle.LENGTH, Vehicle.WIDTH)
    start = support.starter(world, lane_table(world.road.network))
    count = start(np.random.Generator(np.random.PCG64(seed)), car, drv, np.zeros(1))
    assert single.world.road.vehicles.index(single.world.vehicle) == drv["order"][0]
    seat(car, drv, count)
    assert not any(car[name][count:].any() for name in ("x", "y", "speed", "lane"))
    return car[:count], drv[:count]


def _listed(single: DrivingEnv) -> list[Any]:
    ego = single.world.vehicle
    return [ego, *(v for v in single.world.road.vehicles if v is not ego)]


@pytest.mark.parametrize("name", NAMES)
def test_an_episode_starts_as_the_worlds(name: str) -> None:
    for seed in range(4):
        single = _single(name, seed, **({"world": {"other_vehicles": 4}} if name == "Racetrack" else {}))
        car, drv = _started(single, seed)
        there, table = _listed(single), lane_table(single.world.road.network)
        assert len(car) == len(there)
        steps = support_of(single.config).plans(single.world, table).steps
        for i, v in enumerate(there):
            given = (*v.position, v.heading, v.speed)
            np.testing.assert_allclose([car[name][i] for name in ("x", "y", "heading", "speed")], given, atol=1e-9)
            assert table.index[car["lane"][i]] == v.lane_index
            at, route = int(drv["route"][i]), list(getattr(v, "route", None) or ())
            for start, end, side in route:
                assert steps[at].tolist() == (table.row[start, end, 0], -1 if side is None else side)
                at += 1
            assert steps[at]["road"] == -1
            if i > 0:
                assert table.index[drv["target"][i]] == v.target_lane_index
                found = [drv[name][i] for name in ("target_speed", "timer", "delta")]
                np.testing.assert_allclose(found, [v.target_speed, v.timer, v.DELTA], atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_the_next_lane_is_that_of_the_network(name: str) -> None:
    single, rng = _single(name, 1), np.random.default_rng(2)
    network, ends = single.world.road.network, 0
    table = lane_table(network)
    plans = support_of(single.config).plans(single.world, table)
    tuples = {at: plans._left(at) for at in range(len(plans.steps))}
    for n, index in enumerate(table.index):
        lane = network.get_lane(index)
        on_road = [at for at, steps in tuples.items() if steps and steps[0][:2] == index[:2]]
        for at in [0, *rng.permutation(on_road)[:3].tolist()]:
            for along in (lane.length - 2.4, lane.length - 2.6, lane.length + 3.0):
                x, y = lane.position(along, float(rng.uniform(-1.5, 1.5)))
                point, route = np.array([x, y]), list(tuples[at])
                wanted = index
                if lane.after_end(point):
                    wanted, ends = network.next_lane(index, route, point), ends + 1
                found, left = nk.following(table.lanes, plans.steps, at, n, x, y)
                assert table.index[found] == (*wanted[:2], int(wanted[2]))
                assert list(tuples[left]) == route
    assert ends > 10


@pytest.mark.parametrize("name", NAMES)
def test_neighbours_are_found_across_the_ends_of_roads(name: str) -> None:
    across = 0
    for seed in range(6):
        single = _single(name, seed)
        road, table = single.world.road, lane_table(single.world.road.network)
        for _ in range(130 if name == "Merge" else 40):
            road.act()
            road.step(0.05)
        there = [*_listed(single), *road.objects]
        car, drv = empty_rows(len(there))
        for i, v in enumerate(there):
            (car["x"][i], car["y"][i]), car["heading"][i], car["speed"][i] = v.position, v.heading, v.speed
            car["lane"][i] = table.row[v.lane_index]
        v, places = driving(car, drv), np.empty((len(there), len(table.index)))
        network_traffic.place_all.py_func(v, table.lanes, places)
        for i, vehicle in enumerate(there[: len(there) - len(road.objects)]):
            for index in road.network.all_side_lanes(vehicle.lane_index):
                got = network_traffic._neighbours(v, table.lanes, places, table.row[index], i, 1)
                wanted = road.neighbour_vehicles(vehicle, index)
                assert got == tuple(-1 if other is None else there.index(other) for other in wanted)
                across += any(other is not None and other.lane_index[:2] != index[:2] for other in wanted)
    assert across > 3


@pytest.mark.parametrize("name", ["Roundabout", "Intersection"])
def test_a_belief_is_kept_to_its_route_as_the_single_environments(name: str) -> None:
    single = DrivingEnv(make_config(f"lanebound/{name}-v0", {"sky": "open", "cities": {"count": 1}}))
    single.reset(seed=4)
    loop: Any = single.belief_loop
    e, table = loop.episodes, loop.episodes.table
    plans = support_of(single.config).plans(single.world, table)
    rows = {steps: at for at in range(plans.own) if (steps := plans._left(at))}
    rng, kept = np.random.default_rng(1), 0
    along = [table.row[step[0], step[1], 0] for step in loop.route[1:]]
    for _ in range(400):
        n = int(rng.choice(along))
        lane = single.world.road.network.get_lane(table.index[n])
        s, belief = float(rng.uniform(0.0, lane.length)), e.ego["belief"]
        before = table.row[loop.believed.lane_index]
        (belief["x_m"], belief["y_m"]) = lane.position(s, float(rng.normal(0.0, 1.5)))
        belief["heading_rad"] = lane.heading_at(s) + rng.normal(0.0, 0.4)
        belief["target_lane"] = table.row[loop.believed.target_lane_index]
        settled = nearest(table.lanes, *(float(belief[name][0]) for name in ("x_m", "y_m", "heading_rad")))
        belief["lane"] = settled
        ego = e.ego.copy()
        ego["placed"], ego["route"] = before, rows[tuple(loop.route)]
        nk.keep_rows(np.zeros(1, dtype=np.int64), ego, table.lanes, plans.steps, e.rules)
        loop._place()
        assert ego["belief"]["lane"][0] == belief["lane"][0] == ego["placed"][0]
        kept += int(belief["lane"][0] != settled)
    assert kept > 0


def test_ways_through_a_crossing_are_those_of_its_road() -> None:
    single = _single("Intersection", 1)
    world, table = single.world, lane_table(single.world.road.network)
    crossing = roads_of(world, table, support_of(single.config).plans(world, table)).crossing
    world.road.enforce_road_rules()
    for n, (movement, way) in enumerate(world.road.ways.items()):
        lane, start, end, priority = crossing.ways[n].tolist()
        assert table.index[lane] == (*movement, 0)
        assert (table.index[start][1], table.index[end][0], priority) == (*movement, way.priority)
        for k, other in enumerate(world.road.ways):
            np.testing.assert_array_equal(crossing.spans[n, k], way.shared.get(other, (np.nan, np.nan)))


def test_vehicles_come_and_go_as_in_the_single_environment() -> None:
    busy = {**PERFECT, "world": {"spawn_probability": 0.6, "duration": 30}, "action_options": {"target_speeds": [0, 1]}}
    single, engine = pair("Intersection", busy)
    tally, crews = Tally(), set()
    for seed in range(3):
        drive(single, engine, seed, tally, 50)
        crews.add(int(engine.episodes.ego["vehicles"][0]))
    require_equal(tally, parted=3)
    assert tally.steps >= 100
    assert max(crews) > 8


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"world": {"destination": ""}}, r"world.destination must be o1, o2 or o3 in the vector engine, got ''"),
        ({"world": {"other_vehicles_type": "highway_env.vehicle.behavior.LinearVehicle"}}, "other_vehicles_type"),
        ({"action": "continuous"}, "action_options.dynamical must be False in the vector engine"),
        ({"slots": 3}, "slots must be 7 or more, as many as others there may be at a start"),
    ],
)
def test_what_a_crossing_cannot_do_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Engine(DrivingEnv(make_config("lanebound/Intersection-v0", {**PERFECT, **change})), 1)
