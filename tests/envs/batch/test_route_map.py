"""The lanes ahead as one line: equal to highway-env's lanes, continuous over joints, along the route."""

from __future__ import annotations

from math import inf, pi
from typing import Any

import numpy as np
import pytest
from highway_env.envs.intersection_env import IntersectionEnv
from highway_env.envs.merge_env import MergeEnv
from highway_env.envs.racetrack_env import RacetrackEnv
from highway_env.envs.roundabout_env import RoundaboutEnv
from highway_env.road.lane import CircularLane, StraightLane
from highway_env.road.road import RoadNetwork
from hypothesis import given, settings
from hypothesis import strategies as st

from lanebound.envs.batch.lanes import lane_table
from lanebound.envs.batch.route_map import Reach, Routes, routes_of
from lanebound.envs.batch.route_map_kernel import path_at, project


class Path:
    """One path of a route map."""

    def __init__(self, routes: Routes, row: int) -> None:
        self.routes, self.row = routes, row
        self.record = routes.map.paths[row]

    def __getattr__(self, name: str) -> float:
        return float(self.record[name])

    @property
    def following(self) -> tuple[Any, ...]:
        rows = self.routes.map.following[self.record["following_first"] : self.record["following_last"]]
        return tuple(self.routes.table.index[n] for n in rows)

    @property
    def lane(self) -> tuple[float, ...]:
        return tuple(float(self.record[n]) for n in ("lane_share", "left_exists", "right_exists", "speed_limit_mps"))

    def at(self, station: float) -> tuple[float, float, float, float]:
        return tuple(path_at(self.routes.map, self.routes.table.lanes, self.row, float(station)))  # type: ignore[return-value]

    def project(self, x: float, y: float, guess: float) -> tuple[float, float] | None:
        s, r, beside = project(self.routes.map, self.routes.table.lanes, self.row, float(x), float(y), float(guess))
        return (s, r) if beside else None


class RoadMap:
    """The paths over a road network."""

    def __init__(self, network: RoadNetwork, behind_m: float, ahead_m: float) -> None:
        self.routes = Routes(network, lane_table(network), Reach(behind_m, ahead_m, 0.0))

    def path(self, lane: Any, route: Any = None) -> Path:
        return Path(self.routes, self.routes.row(self.routes.table.row[lane], route))


def ring(radius_m: float = 20.0) -> RoadNetwork:
    """A closed road of two half circles and two straights, clockwise seen from above, of two lanes."""
    network = RoadNetwork()
    for width, r in ((0, radius_m), (1, radius_m - 3.25)):
        top, bottom = -r, r
        network.add_lane("a", "b", StraightLane([0.0, top], [100.0, top], width=3.25))
        network.add_lane("b", "c", CircularLane([100.0, 0.0], r, -pi / 2, pi / 2, width=3.25))
        network.add_lane("c", "d", StraightLane([100.0, bottom], [0.0, bottom], width=3.25))
        network.add_lane("d", "a", CircularLane([0.0, 0.0], r, pi / 2, 3 * pi / 2, width=3.25))
        assert len(network.graph["a"]["b"]) == width + 1
    return network


def fork() -> RoadNetwork:
    """A road that leads on straight to ``s`` and, by a right turn, to ``t``."""
    network = RoadNetwork()
    network.add_lane("o", "x", StraightLane([0.0, 0.0], [50.0, 0.0]))
    network.add_lane("x", "s", StraightLane([50.0, 0.0], [150.0, 0.0]))
    network.add_lane("x", "t", CircularLane([50.0, 30.0], 30.0, -pi / 2, 0.0))
    return network


def test_a_path_is_continuous_round_a_ring():
    path = RoadMap(ring(), behind_m=80.0, ahead_m=150.0).path(("b", "c", 0))
    stations = np.arange(-75.0, path.end_m, 0.5)
    points = np.array([path.at(s)[:2] for s in stations])
    assert np.hypot(*np.diff(points, axis=0).T) == pytest.approx(0.5, abs=1e-3)
    assert path.following[:3] == (("b", "c", 0), ("c", "d", 0), ("d", "a", 0))
    assert path.junction_m == pytest.approx(20.0 * pi)
    assert path.lane_end_m == inf


def test_without_a_map_the_road_is_drawn_on_straight():
    path = RoadMap(fork(), 50.0, 50.0).path(("x", "t", 0))
    end = path.end_m
    assert path.lane_end_m == pytest.approx(15.0 * pi)
    assert path.at(end + 7.0) == pytest.approx((80.0, 37.0, pi / 2, 0.0))
    assert path.at(-60.0)[:2] == pytest.approx((-10.0, 0.0))


@pytest.mark.parametrize(
    ("route", "on"),
    [
        ([("o", "x", 0), ("x", "t", None)], "t"),
        ([("x", "t", 0)], "t"),
        ([("x", "s", None)], "s"),
        (None, "s"),
        ([("elsewhere", "o", 0), ("o", "x", 0), ("x", "t", 0)], "t"),
        ([("p", "q", 0)], "s"),
    ],
)
def test_the_route_says_where_a_fork_goes_on(route, on):
    network = fork()
    path = RoadMap(network, 50.0, 100.0).path(("o", "x", 0), route)
    assert path.following == (("o", "x", 0), ("x", on, 0))


def test_a_route_that_changes_in_place_is_noticed():
    roads, route = RoadMap(fork(), 50.0, 100.0), [("o", "x", 0), ("x", "t", 0)]
    assert roads.path(("o", "x", 0), route).following[1] == ("x", "t", 0)
    route[1] = ("x", "s", 0)
    assert roads.path(("o", "x", 0), route).following[1] == ("x", "s", 0)


def test_a_lane_that_merges_ends():
    network = RoadNetwork()
    for y in (0.0, 4.0):
        network.add_lane("a", "b", StraightLane([0.0, y], [60.0, y]))
    network.add_lane("b", "c", StraightLane([60.0, 0.0], [160.0, 0.0]))
    roads = RoadMap(network, 50.0, 150.0)
    assert roads.path(("a", "b", 1)).lane_end_m == pytest.approx(60.0)
    assert roads.path(("a", "b", 0)).lane_end_m == pytest.approx(160.0)


def test_what_the_map_says_of_a_lane():
    network = ring()
    network.graph["a"]["b"][1].forbidden = True
    network.graph["c"]["d"][1].speed_limit = None
    roads = RoadMap(network, 10.0, 10.0)
    assert roads.path(("a", "b", 0)).lane == (0.0, 0.0, 0.0, 20.0)
    assert roads.path(("b", "c", 0)).lane == (0.0, 0.0, 1.0, 20.0)
    assert roads.path(("c", "d", 1)).lane == (1.0, 1.0, 0.0, inf)


@settings(max_examples=60, deadline=None)
@given(st.floats(-60.0, 130.0), st.floats(-5.0, 5.0), st.floats(-3.0, 3.0))
def test_a_vehicle_beside_the_path_is_placed_on_it(station, offset, aside):
    path = RoadMap(ring(), 80.0, 150.0).path(("b", "c", 0))
    x, y, heading, _ = path.at(station)
    point = x - offset * np.sin(heading), y + offset * np.cos(heading)
    assert path.project(*point, station + 4.0 * aside) == pytest.approx((station, offset), abs=0.02)


def test_a_vehicle_far_from_the_path_is_not_beside_it():
    path = RoadMap(ring(), 80.0, 80.0).path(("b", "c", 0))
    places = [path.project(100.0 + dx, dy, 10.0) for dx in (-0.3, 0.3) for dy in (-0.3, 0.3)]
    assert all(place is None or abs(place[1]) > 15.0 for place in places)


def test_lanes_that_overlap_or_miss_each_other_are_joined_where_they_meet():
    for shift in (-1.5, 0.0, 1.5):
        network = RoadNetwork()
        network.add_lane("a", "b", StraightLane([0.0, 0.0], [50.0, 0.0]))
        network.add_lane("b", "c", StraightLane([50.0 - shift, 0.1], [150.0, 0.1]))
        path = RoadMap(network, 50.0, 80.0).path(("a", "b", 0))
        assert path.lane_end_m == pytest.approx(150.0)
        assert path.at(60.0) == pytest.approx((60.0, 0.1, 0.0, 0.0))
        path = RoadMap(network, 50.0, 80.0).path(("b", "c", 0))
        assert path.at(-20.0 + shift)[:2] == pytest.approx((30.0, 0.0))


def test_nobody_is_led_to_turn_back():
    network = RoadNetwork()
    network.add_lane("a", "b", StraightLane([0.0, 0.0], [50.0, 0.0]))
    network.add_lane("b", "a", StraightLane([50.0, -4.0], [0.0, -4.0]))
    path = RoadMap(network, 50.0, 80.0).path(("a", "b", 0))
    assert path.following == (("a", "b", 0),)
    assert path.lane_end_m == path.end_m == pytest.approx(50.0)


@pytest.mark.parametrize("world", [RacetrackEnv, RoundaboutEnv, MergeEnv])
def test_paths_over_the_networks_of_highway_env_have_no_steps(world):
    network = world().road.network
    roads = RoadMap(network, 150.0, 150.0)
    for index in network.lanes_dict():
        path = roads.path(index)
        assert path.start_m <= 0.0 < path.junction_m <= path.end_m
        points = np.array([path.at(s)[:2] for s in np.arange(path.start_m, min(path.end_m, path.lane_end_m), 1.0)])
        assert np.hypot(*np.diff(points, axis=0).T).max() < 3.0


def test_paths_of_equal_networks_are_found_once() -> None:
    one, two = (routes_of(fork(), Reach(50.0, 50.0, 0.0)) for _ in range(2))
    assert one is two
    assert one.row(1) == 1
    row = one.row(0, [("x", "t", 0)])
    assert row == two.row(0, [("x", "t", 0)]) >= len(one.table.index)
    assert routes_of(fork(), Reach(50.0, 60.0, 0.0)) is not one


def test_before_the_exit_of_an_intersection_the_straight_lane_comes_first() -> None:
    """Three lanes lead onto an exit, two of them bends. All join it equally well: rounding must not choose."""
    env = IntersectionEnv()
    try:
        env.reset(seed=0)
        network = env.road.network
    finally:
        env.close()
    routes = Routes(network, lane_table(network), Reach(30.0, 30.0, 0.0))
    for exit_ in range(4):
        node, lane = f"il{exit_}", routes.table.row[f"il{exit_}", f"o{exit_}", 0]
        lanes = [routes.table.row[start, node, 0] for start, roads in network.graph.items() if node in roads]
        assert len(lanes) == 3
        joints = [routes._joint(n, lane) for n in lanes]
        misfit = [abs(joint.aside_m) + abs(joint.turn_rad) for joint in joints]
        assert max(misfit) - min(misfit) < 1e-12, "no tie"
        before = routes.table.index[routes._before(lane)[-1][1]]
        assert before[0] == f"ir{(exit_ + 2) % 4}", "the approach from opposite"
        assert isinstance(network.get_lane(before), StraightLane)
