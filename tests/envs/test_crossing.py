"""Right of way of the other drivers at a crossing: nobody drives into another one, and nobody stops inside."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lanebound.envs import DrivingEnv, make_config
from lanebound.envs.worlds.crossing import CrossingRoad, ways_through
from lanebound.envs.worlds.drivers import IntersectionDriver
from lanebound.envs.worlds.idm_parameters_kernel import LINE_M

DT_S = 0.05
ARMS = range(4)  # south, west, north, east


def crossing() -> DrivingEnv:
    given = {"sky": "open", "navigation": {"source": "perfect"}, "perception": {"source": "truth"}}
    env = DrivingEnv(make_config("lanebound/Intersection-v0", {**given, "wander": {"wander_sigma_m": 0.0}}))
    env.reset(seed=1000)
    return env


@pytest.fixture(scope="module")
def world() -> Any:
    return crossing().world


def driver(road: Any, start: int, end: int, to_line_m: float, speed: float) -> IntersectionDriver:
    lane = road.network.get_lane((f"o{start}", f"ir{start}", 0))
    made = IntersectionDriver.make_on_lane(
        road, (f"o{start}", f"ir{start}", 0), lane.length - to_line_m - 2.5, speed=speed
    )
    made.plan_route_to(f"o{end}")
    road.vehicles.append(made)
    return made


def driven(road: Any, seconds: float) -> None:
    for _ in range(round(seconds / DT_S)):
        road.act()
        road.step(DT_S)


@pytest.fixture
def road(world: Any) -> Any:
    road = world.road
    road.vehicles = []
    return road


def test_ways_share_what_their_geometry_says(road: Any) -> None:
    """Opposite left turns and opposite straights have 4 m and more between them; straights at right angles cross."""
    assert isinstance(road, CrossingRoad)
    ways = ways_through(road.network)
    assert len(ways) == 12
    south, west, north, east = ([key for key in ways if key[0] == f"ir{arm}"] for arm in ARMS)
    straight = {0: ("ir0", "il2"), 2: ("ir2", "il0"), 1: ("ir1", "il3")}
    assert straight[2] not in ways[straight[0]].shared
    assert ("ir2", "il3") not in ways["ir0", "il1"].shared
    first, last = ways[straight[0]].shared[straight[1]]
    centre = 11.0 - 2.0  # from the crossing's edge to the eastbound middle, 2 m south of its own
    assert first <= centre <= last
    assert last - first < 8.0
    for own, way in ways.items():
        assert {other in ways and own in ways[other].shared for other in way.shared} == {True}
    assert all(other in ways[key].shared for arm in (south, west, north, east) for key in arm for other in arm)


def test_who_has_priority_goes_first_and_the_other_one_waits_before_the_crossing(road: Any) -> None:
    """The southern and the western driver would meet in the middle after 3 s; the road from the west has priority."""
    other = driver(road, 0, 2, 20.0, 9.0)
    first = driver(road, 1, 3, 22.0, 9.0)
    driven(road, 2.5)
    assert first.may_enter
    assert not other.may_enter
    assert other.to_line_m() >= LINE_M - 0.3
    driven(road, 6.0)
    assert other.may_enter
    assert not any(v.crashed for v in road.vehicles)


def test_nobody_slows_for_one_that_has_left_in_time(road: Any) -> None:
    first = driver(road, 1, 3, 1.0, 9.0)
    later = driver(road, 0, 2, 28.0, 9.0)
    slowest = 9.0
    for _ in range(60):
        driven(road, DT_S)
        slowest = min(slowest, later.speed)
    assert slowest > 8.0
    assert not first.crashed


def test_a_driver_that_waits_stands_at_the_line(road: Any) -> None:
    waits = driver(road, 0, 2, 40.0, 10.0)
    for _ in range(400):
        waits.may_enter = False
        road.enforce_road_rules = lambda: None
        driven(road, DT_S)
    del road.enforce_road_rules
    assert waits.speed == pytest.approx(0.0, abs=0.05)
    assert waits.to_line_m() == pytest.approx(LINE_M, abs=0.4)


@pytest.mark.parametrize("seed", range(6))
def test_there_are_no_wrecks_in_dense_traffic(road: Any, seed: int) -> None:
    """Thirty seconds with an arrival in each 1.2 s, all ways alike; with highway-env's rule seed 1 ends in a wreck."""
    rng = np.random.default_rng(seed)
    for step in range(600):
        if step % 24 == 0:
            start, end = rng.choice(4, size=2, replace=False)
            lane = road.network.get_lane((f"o{start}", f"ir{start}", 0))
            room = [np.hypot(*(v.position - lane.position(50.0, 0.0))) for v in road.vehicles]
            if not room or min(room) > 15.0:
                driver(road, int(start), int(end), lane.length - 52.5, float(rng.uniform(6.0, 10.0)))
        driven(road, DT_S)
        assert not any(v.crashed for v in road.vehicles), step
        road.vehicles = [
            v
            for v in road.vehicles
            if not (v.lane_index[0].startswith("il") and v.lane.local_coordinates(v.position)[0] > 40.0)
        ]
