"""Lanes as records answer as highway-env's lane objects do, on any road network."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
import pytest
from highway_env.road.lane import AbstractLane, CircularLane, PolyLaneFixedWidth, SineLane, StraightLane
from highway_env.road.road import RoadNetwork

from lanebound.envs.batch import lanes_kernel as lk
from lanebound.envs.batch.lanes import lane_table
from lanebound.envs.catalogue import world_of
from lanebound.envs.config import EnvConfig
from lanebound.envs.worlds.networks import StreetNetwork, city_loop, winding_road
from lanebound.envs.worlds.paths import SQUARE_M
from lanebound.integrity.core.frames import wrap_angle

STRAIGHT = StraightLane([3.0, -2.0], [40.0, 30.0])
CLOCKWISE = CircularLane([5.0, 4.0], 20.0, 0.3, 2.0, clockwise=True)
ANTICLOCKWISE = CircularLane([5.0, 4.0], 20.0, 2.0, 0.3, clockwise=False)
SINE = SineLane([0.0, 0.0], [60.0, 0.0], amplitude=2.0, pulsation=2 * pi / 60.0, phase=0.4)
POLY = PolyLaneFixedWidth([(x, 5.0 * np.sin(x / 15.0)) for x in np.arange(0.0, 60.0, 1.0)])
BASES = ("highway-v0", "merge-v1", "roundabout-v1", "intersection-v2", "racetrack-v1", "exit-v1", "u-turn-v1")
NETWORKS = {
    "winding": winding_road(1, 3, 3.25),
    "loop": city_loop(3.25),
    "apart": StreetNetwork.apart([winding_road(k, 2, 3.25) for k in range(8)]),
    "straight": RoadNetwork.straight_road_network(4, speed_limit=30),
    "askew": RoadNetwork.straight_road_network(2, angle=0.3),
}


def _of_base(base: str) -> RoadNetwork:
    action = "continuous" if base.startswith("racetrack") else "meta"
    return world_of(EnvConfig.load({"base": base, "action": action})).road.network


def _alone(lane: AbstractLane) -> lk.Lanes:
    network = RoadNetwork()
    network.add_lane("a", "b", lane)
    return lane_table(network).lanes


def _points(network: Any, rng: np.random.Generator, count: int) -> list[tuple[int, Any]]:
    """Points on and beside lanes, and past their ends."""
    index = lane_table(network).index
    out = []
    for n in rng.integers(len(index), size=count).tolist():
        lane = network.get_lane(index[n])
        out.append((n, lane.position(rng.uniform(-8.0, min(lane.length, 3000.0) + 8.0), rng.uniform(-6.0, 6.0))))
    return out


def test_squares_are_those_of_paths() -> None:
    assert lk.SQUARE_M == SQUARE_M


@pytest.mark.parametrize("name", [*NETWORKS, *BASES])
def test_places_on_lanes_and_nearest_lanes_are_the_same(name: str) -> None:
    network, rng = NETWORKS[name] if name in NETWORKS else _of_base(name), np.random.default_rng(1)
    table = lane_table(network)
    lanes, tied = table.lanes, 0
    for n, point in _points(network, rng, 60):
        lane, heading = network.get_lane(table.index[n]), float(rng.uniform(-4.0, 4.0))
        x, y = point.tolist()
        s, r, direction = lk.local(lanes, n, x, y)
        assert (s, r) == pytest.approx(lane.local_coordinates(point), abs=1e-9)
        assert wrap_angle(direction - lane.heading_at(s)) == pytest.approx(0.0, abs=1e-9)
        turned = lk.heading_at(lanes, n, s) - lane.heading_at(s)
        assert wrap_angle(turned) == pytest.approx(0.0, abs=1e-9)
        np.testing.assert_allclose(lk.place(lanes, n, s, r), lane.position(s, r), atol=1e-9)
        assert lk.width_at(lanes, n, s) == lane.width_at(s)
        assert lk.on_lane(lanes, n, s, r, 0.0) == lane.on_lane(point)
        assert lk.reachable(lanes, n, s, r) == lane.is_reachable_from(point)
        row, clear = lk.closest(lanes, x, y, heading, np.zeros(len(table.index)))
        tied += not clear
        if clear:
            assert table.index[row] == network.get_closest_lane_index(point, heading)
            assert lk.nearest(lanes, x, y, heading) == row
    assert tied <= 6


@pytest.mark.parametrize("name", ["winding", "loop", "apart"])
def test_lanes_of_our_own_have_the_same_bits(name: str) -> None:
    """Straights, arcs and clothoids; highway-env's dynamics see the lane object, the engine's its record."""
    network, rng = NETWORKS[name], np.random.default_rng(3)
    table = lane_table(network)
    for n, point in _points(network, rng, 2000):
        lane = network.get_lane(table.index[n])
        assert lane.local_pose(point) == lk.local(table.lanes, n, *point.tolist())


@pytest.mark.parametrize("lane", [STRAIGHT, CLOCKWISE, ANTICLOCKWISE])
def test_centrelines_of_simple_lanes_are_exact(lane: Any) -> None:
    lanes = _alone(lane)
    for s in np.linspace(0.0, lane.length, 23):
        x, y, heading, _ = lk.centre(lanes, 0, s)
        assert [x, y] == pytest.approx(lane.position(s, 0.0).tolist(), abs=1e-9)
        assert wrap_angle(heading - lane.heading_at(s)) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("lane", "error_m", "error_rad"), [(SINE, 2e-3, 2e-3), (POLY, 0.05, 0.05)])
def test_centrelines_of_other_lanes_are_interpolated(lane: Any, error_m: float, error_rad: float) -> None:
    lanes = _alone(lane)
    for s in np.linspace(0.0, lane.length, 101):
        x, y, heading, _ = lk.centre(lanes, 0, s)
        assert [x, y] == pytest.approx(lane.position(s, 0.0).tolist(), abs=error_m)
        assert wrap_angle(heading - lane.heading_at(s)) == pytest.approx(0.0, abs=error_rad)


def test_a_lane_of_another_class_is_known_by_its_samples() -> None:
    """Foot and offset of points beside it; 5 cm is what a polyline of 1 m chords leaves of them."""
    lanes, rng = _alone(POLY), np.random.default_rng(4)
    for _ in range(40):
        s, r = float(rng.uniform(1.0, POLY.length - 1.0)), float(rng.uniform(-4.0, 4.0))
        x, y = (float(v) for v in POLY.position(s, r))
        found_s, found_r, _ = lk.local(lanes, 0, x, y)
        expected = POLY.local_coordinates(np.array([x, y]))
        assert (found_s, found_r) == pytest.approx(expected, abs=0.15)


def test_curvature_is_positive_to_the_right() -> None:
    assert lk.centre(_alone(CLOCKWISE), 0, 3.0)[3] == pytest.approx(1 / 20)
    assert lk.centre(_alone(ANTICLOCKWISE), 0, 3.0)[3] == pytest.approx(-1 / 20)
    bent = SINE.pulsation**2 * SINE.amplitude
    found = lk.centre(_alone(SINE), 0, 6.0)[3]
    assert found == pytest.approx(-bent * np.sin(SINE.pulsation * 6.0 + 0.4), abs=0.1 * bent)


def test_a_sampled_arc_is_as_good_as_the_exact_one() -> None:
    class Arc(CircularLane):  # type: ignore[misc]
        """Not known to be an arc."""

    arc = (np.zeros(2), 15.0, 0.0, 2.0)
    exact, sampled = _alone(CircularLane(*arc)), _alone(Arc(*arc))
    assert (exact.table["kind"][0], sampled.table["kind"][0]) == (lk.CIRCLE, lk.SAMPLED)
    for s in np.linspace(0.0, exact.table["length_m"][0], 57):
        assert lk.centre(sampled, 0, s)[:3] == pytest.approx(lk.centre(exact, 0, s)[:3], abs=2e-5)
        assert lk.centre(sampled, 0, s)[3] == pytest.approx(lk.centre(exact, 0, s)[3], rel=1e-3)


def test_equal_networks_share_a_table_and_other_ones_do_not() -> None:
    one, two = (RoadNetwork.straight_road_network(3, length=500) for _ in range(2))
    assert lane_table(one) is lane_table(two)
    two.graph["0"]["1"][1].speed_limit = 12.0
    assert lane_table(one) is not lane_table(two)
