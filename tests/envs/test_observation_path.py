"""The lanes ahead as one line: equal to highway-env's lanes, continuous over joints, along the route."""

from __future__ import annotations

from math import inf, pi

import numpy as np
import pytest
from highway_env.envs.merge_env import MergeEnv
from highway_env.envs.racetrack_env import RacetrackEnv
from highway_env.envs.roundabout_env import RoundaboutEnv
from highway_env.road.lane import CircularLane, PolyLaneFixedWidth, SineLane, StraightLane
from highway_env.road.road import RoadNetwork
from hypothesis import given, settings
from hypothesis import strategies as st

from lanebound.envs.observation.path import RoadMap, line_of, wrap

STRAIGHT = StraightLane([3.0, -2.0], [40.0, 30.0])
CLOCKWISE = CircularLane([5.0, 4.0], 20.0, 0.3, 2.0, clockwise=True)
ANTICLOCKWISE = CircularLane([5.0, 4.0], 20.0, 2.0, 0.3, clockwise=False)
SINE = SineLane([0.0, 0.0], [60.0, 0.0], amplitude=2.0, pulsation=2 * pi / 60.0, phase=0.4)
POLY = PolyLaneFixedWidth([(x, 5.0 * np.sin(x / 15.0)) for x in np.arange(0.0, 60.0, 1.0)])


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


@pytest.mark.parametrize("lane", [STRAIGHT, CLOCKWISE, ANTICLOCKWISE])
def test_simple_lanes_are_exact(lane):
    line = line_of(lane)
    for s in np.linspace(0.0, lane.length, 23):
        x, y, heading, _ = line.at(s)
        assert [x, y] == pytest.approx(lane.position(s, 0.0).tolist(), abs=1e-9)
        assert wrap(heading - lane.heading_at(s)) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("lane", "error_m", "error_rad"), [(SINE, 2e-3, 2e-3), (POLY, 0.05, 0.05)])
def test_other_lanes_are_interpolated(lane, error_m, error_rad):
    line = line_of(lane)
    for s in np.linspace(0.0, lane.length, 101):
        x, y, heading, _ = line.at(s)
        assert [x, y] == pytest.approx(lane.position(s, 0.0).tolist(), abs=error_m)
        assert wrap(heading - lane.heading_at(s)) == pytest.approx(0.0, abs=error_rad)


def test_curvature_is_positive_to_the_right():
    assert line_of(CLOCKWISE).at(3.0)[3] == pytest.approx(1 / 20)
    assert line_of(ANTICLOCKWISE).at(3.0)[3] == pytest.approx(-1 / 20)
    straight_on, bent = line_of(SINE), SINE.pulsation**2 * SINE.amplitude
    assert straight_on.at(6.0)[3] == pytest.approx(-bent * np.sin(SINE.pulsation * 6.0 + 0.4), abs=0.1 * bent)


def test_a_sampled_arc_is_as_good_as_the_exact_one():
    class Arc(CircularLane):
        """Not known to be an arc."""

    arc = (np.zeros(2), 15.0, 0.0, 2.0)
    exact, sampled = line_of(CircularLane(*arc)), line_of(Arc(*arc))
    assert type(exact) is not type(sampled)
    for s in np.linspace(0.0, exact.length, 57):
        assert sampled.at(s)[:3] == pytest.approx(exact.at(s)[:3], abs=2e-5)
        assert sampled.at(s)[3] == pytest.approx(exact.at(s)[3], rel=1e-3)


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
    assert roads.path(("c", "d", np.int64(1))).lane == (1.0, 1.0, 0.0, inf)


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
