"""Curves and lanes: closed forms, inverses, joints, copies, and the closest lane."""

from __future__ import annotations

import copy
import math
import pickle

import numpy as np
import pytest
from highway_env.road.lane import AbstractLane, CircularLane, StraightLane
from highway_env.road.road import RoadNetwork
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from lanebound.envs.worlds.lanes import CurveLane
from lanebound.envs.worlds.networks import StreetNetwork, advance, city_loop, long_road, winding_road
from lanebound.envs.worlds.paths import Path, Piece, Pose, bend, rounded_polygon, straight
from lanebound.integrity.core.errors import InputError

CORNER = Path.of(Pose(3.0, -2.0, 0.4), [*straight(40.0), *bend(1.2, 25.0, 12.0), *straight(30.0)])
NETWORKS = {"winding": winding_road(0, 2, 3.25), "long": long_road(1, 3.25), "city": city_loop(3.25)}
LANES = [(name, index) for name, network in NETWORKS.items() for index in network.lanes_dict()]


def test_a_clothoid_is_the_integral_of_its_heading() -> None:
    transition, kappa = 12.0, 1.0 / 25.0
    for s in (1.0, 5.5, 12.0):
        angle = lambda u: 0.4 + 0.5 * kappa / transition * u * u  # noqa: E731
        x = quad(lambda u, f=angle: math.cos(f(u)), 0.0, s, epsabs=1e-13)[0]
        y = quad(lambda u, f=angle: math.sin(f(u)), 0.0, s, epsabs=1e-13)[0]
        pose = CORNER.pose_at(40.0 + s)
        start = CORNER.pose_at(40.0)
        assert (pose.x - start.x, pose.y - start.y) == pytest.approx((x, y), abs=5e-12)
        assert pose.heading == pytest.approx(angle(s), abs=1e-14)


def test_a_bend_turns_by_its_angle_and_has_its_radius() -> None:
    assert CORNER.pose_at(CORNER.length).heading == pytest.approx(1.6, abs=1e-13)
    assert max(abs(CORNER.curvature_at(s)) for s in np.arange(0.0, CORNER.length, 0.5)) == pytest.approx(1.0 / 25.0)
    tight = bend(-0.1, 50.0, 20.0)
    assert sum(0.5 * (p.start + p.end) * p.length for p in tight) == pytest.approx(-0.1)


def test_without_transitions_a_lane_equals_highway_envs_own() -> None:
    path = Path.of(Pose(0.0, 0.0, 0.0), [*straight(50.0), *bend(1.0, 30.0, 0.0), *straight(20.0)])
    lane = CurveLane(path, 2.0, 4.0)
    before = StraightLane([0.0, 2.0], [50.0, 2.0])
    arc = CircularLane([50.0, 30.0], 28.0, -math.pi / 2, -math.pi / 2 + 1.0)
    for s, r in ((5.0, 1.0), (49.0, -2.0)):
        assert lane.position(s, r) == pytest.approx(before.position(s, r), abs=1e-12)
    for s, r in ((1.0, 1.0), (20.0, -3.0)):
        assert lane.position(50.0 + s, r) == pytest.approx(arc.position(s, r), abs=1e-12)
        assert lane.heading_at(50.0 + s) == pytest.approx(arc.heading_at(s), abs=1e-12)
        assert lane.local_coordinates(arc.position(s, r)) == pytest.approx((50.0 + s, r), abs=1e-12)
    assert lane.curvature_at(60.0) == pytest.approx(1.0 / 28.0)


@given(st.integers(0, len(LANES) - 1), st.floats(-0.02, 1.02), st.floats(-9.0, 9.0))
def test_local_coordinates_invert_position(which: int, share: float, lateral: float) -> None:
    name, index = LANES[which]
    lane = NETWORKS[name].get_lane(index)
    s = share * lane.length
    assert lane.local_coordinates(lane.position(s, lateral)) == pytest.approx((s, lateral), abs=1e-9)


@given(st.integers(0, len(LANES) - 1), st.floats(0.001, 0.999))
def test_the_heading_is_the_direction_of_travel_and_length_is_arc_length(which: int, share: float) -> None:
    name, index = LANES[which]
    lane = NETWORKS[name].get_lane(index)
    s, h = share * lane.length, 1e-3
    ahead = lane.position(s + h, 0.0) - lane.position(s - h, 0.0)
    assert np.hypot(*ahead) == pytest.approx(2 * h, abs=1e-8)
    assert math.remainder(math.atan2(ahead[1], ahead[0]) - lane.heading_at(s), 2 * math.pi) == pytest.approx(
        0, abs=1e-5
    )


def test_lanes_of_one_road_keep_their_distance() -> None:
    left, right = (NETWORKS["city"].get_lane(("c", "d", k)) for k in (0, 1))
    for s in np.linspace(0.0, left.length, 97):
        assert right.local_coordinates(left.position(s, 0.0))[1] == pytest.approx(-3.25, abs=1e-9)


@pytest.mark.parametrize("width_m", [3.0, 3.25, 4.0])
def test_edges_of_the_loop_join_exactly(width_m: float) -> None:
    network = city_loop(width_m)
    for (a, b, k), lane in network.lanes_dict().items():
        (after,) = network.graph[b]
        ahead = network.get_lane((b, after, k))
        assert lane.position(lane.length, 0.0) == pytest.approx(ahead.position(0.0, 0.0), abs=1e-9)
        turn = math.remainder(lane.heading_at(lane.length) - ahead.heading_at(0.0), 2 * math.pi)
        assert turn == pytest.approx(0.0, abs=1e-9), (a, b, k)


def test_the_loop_is_of_city_size() -> None:
    network = city_loop(3.25)
    assert 2800.0 < sum(network.graph[a][b][0].length for a, b in ("ab", "bc", "cd", "da")) < 3300.0
    assert min(_least_radius(lane) for lane in network.lanes_list()) >= 20.0


@pytest.mark.parametrize("layout", range(4))
def test_roads_have_the_stated_lengths_and_radii(layout: int) -> None:
    winding = winding_road(layout, 1, 3.25).lanes_list()[0]
    gentle = long_road(layout, 3.25).lanes_list()[0]
    assert 1700.0 <= winding.length <= 2100.0
    assert 2600.0 <= gentle.length <= 3300.0
    assert 40.0 <= _least_radius(winding) < 60.0
    assert _least_radius(gentle) >= 200.0


def _least_radius(lane: CurveLane) -> float:
    return 1.0 / max(abs(lane.curvature_at(s)) for s in np.arange(0.0, lane.length, 1.0))


@given(st.sampled_from(sorted(NETWORKS)), st.floats(-200.0, 1300.0), st.floats(-400.0, 700.0), st.floats(-7.0, 7.0))
def test_the_closest_lane_is_the_plain_networks(name: str, x: float, y: float, heading: float) -> None:
    network, point = NETWORKS[name], np.array([x, y])
    assert network.get_closest_lane_index(point, heading) == RoadNetwork.get_closest_lane_index(network, point, heading)
    assert network.get_closest_lane_index(point) == RoadNetwork.get_closest_lane_index(network, point)


@given(st.integers(0, len(LANES) - 1), st.floats(-30.0, 900.0), st.floats(-15.0, 15.0), st.floats(-7.0, 7.0))
def test_rules_of_the_base_class_hold(which: int, s: float, r: float, heading: float) -> None:
    name, index = LANES[which]
    lane = NETWORKS[name].get_lane(index)
    point = lane.position(s, r)
    assert lane.on_lane(point) == AbstractLane.on_lane(lane, point)
    expected = AbstractLane.distance_with_heading(lane, point, heading)
    assert lane.distance_with_heading(point, heading) == pytest.approx(expected, abs=1e-9)


def test_the_advised_speed_suits_bends_and_can_be_reached_by_comfortable_braking() -> None:
    lane = NETWORKS["city"].get_lane(("a", "b", 1))
    stations = np.arange(0.0, lane.length, 2.0)
    speed = np.array([lane.advised_speed(s) for s in stations])
    kappa = np.array([abs(lane.curvature_at(s)) for s in stations])
    assert np.all(speed**2 * kappa <= 2.0 + 1e-9)
    assert np.all(speed <= lane.speed_limit)
    assert np.all(np.diff(speed**2) / 4.0 >= -1.2 - 1e-9)


def test_a_network_survives_copies_pickling_and_plain_values() -> None:
    network = NETWORKS["city"]
    for twin in (
        copy.deepcopy(network),
        pickle.loads(pickle.dumps(network)),
        StreetNetwork.from_config(network.to_config()),
    ):
        lane, same = network.get_lane(("c", "d", 1)), twin.get_lane(("c", "d", 1))
        assert same is not lane
        assert same.path is lane.path
        assert same.length == lane.length
        assert twin.get_closest_lane_index(lane.position(300.0, 0.0), 0.0) == ("c", "d", 1)


def test_advance_goes_round_and_back() -> None:
    network = NETWORKS["city"]
    index, s = advance(network, ("d", "a", 1), 900.0, 100.0)
    assert index == ("a", "b", 1)
    assert s == pytest.approx(1000.0 - network.get_lane(("d", "a", 1)).length)
    assert advance(network, index, s, -100.0) == (("d", "a", 1), pytest.approx(900.0))


def test_impossible_curves_are_refused() -> None:
    with pytest.raises(InputError, match="begin and end on a straight"):
        Path(Pose(0.0, 0.0, 0.0), (Piece(10.0, 0.1, 0.1),))
    with pytest.raises(InputError, match="length > 0"):
        Path(Pose(0.0, 0.0, 0.0), (Piece(10.0, 0.0, 0.0), Piece(0.0, 0.0, 0.0)))
    with pytest.raises(InputError, match="radius_m > 0"):
        bend(1.0, 0.0, 5.0)
    with pytest.raises(InputError, match="leaves no straight"):
        rounded_polygon([(0.0, 0.0, 30.0), (50.0, 0.0, 30.0), (50.0, 50.0, 30.0), (0.0, 50.0, 30.0)], 10.0)
    with pytest.raises(InputError, match="beyond the middle of a bend"):
        CurveLane(CORNER, 30.0, 3.25)
    with pytest.raises(InputError, match="lanes >= 1"):
        winding_road(0, 0, 3.25)
