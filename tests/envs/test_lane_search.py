"""The quick search for the closest lane gives highway-env's own answer, everywhere and on every network."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from highway_env.road.lane import CircularLane, StraightLane
from highway_env.road.road import RoadNetwork

from lanebound.envs.batch.lanes import lane_table
from lanebound.envs.batch.lanes_kernel import closest
from lanebound.envs.catalogue import world_of
from lanebound.envs.config import EnvConfig
from lanebound.envs.lane_search import FastRoadNetwork, fast_network

BASES = ("highway-v0", "merge-v1", "roundabout-v1", "intersection-v2", "racetrack-v1", "exit-v1", "u-turn-v1")


def _network(base: str) -> RoadNetwork:
    action = "continuous" if base.startswith("racetrack") else "meta"
    return world_of(EnvConfig.load({"base": base, "action": action})).road.network


def _of(*lanes: Any) -> RoadNetwork:
    network = RoadNetwork()
    for lane in lanes:
        network.add_lane("a", "b", lane)
    return network


def _assert_same(network: RoadNetwork, position: Any, heading: float) -> None:
    where = np.asarray(position, dtype=np.float64)
    expected = network.get_closest_lane_index(where, heading)
    assert FastRoadNetwork(network, lane_table(network)).get_closest_lane_index(where, heading) == expected


@pytest.mark.parametrize("base", BASES)
def test_same_lane_as_highway_env_near_and_far_from_every_lane(base: str) -> None:
    network, rng = _network(base), np.random.default_rng(1)
    fast = FastRoadNetwork(network, lane_table(network))
    for lane in network.lanes_list():
        for _ in range(12):
            s, d = rng.uniform(-20.0, lane.length + 20.0), 4.0 * rng.standard_normal()
            position = lane.position(s, d) + rng.choice([0.0, 30.0]) * rng.standard_normal(2)
            heading = float(lane.heading_at(s) + rng.choice([0.1, 2.0]) * rng.standard_normal())
            expected = network.get_closest_lane_index(position, heading)
            assert fast.get_closest_lane_index(position, heading) == expected


@pytest.mark.parametrize("base", BASES)
def test_same_lane_where_lanes_meet_or_lie_level(base: str) -> None:
    network = _network(base)
    fast = FastRoadNetwork(network, lane_table(network))
    for lane in network.lanes_list():
        for s in (0.0, 0.5 * lane.length, lane.length):
            for d in (-0.5, 0.0, 0.5):
                position, heading = lane.position(s, d * lane.width_at(s)), float(lane.heading_at(s))
                expected = network.get_closest_lane_index(position, heading)
                assert fast.get_closest_lane_index(position, heading) == expected


def test_ties_jumps_and_nonsense_are_left_to_highway_env() -> None:
    twins = _of(StraightLane([0.0, 0.0], [10.0, 0.0]), StraightLane([0.0, 0.0], [10.0, 0.0]))
    circle = _of(CircularLane([0.0, 0.0], 10.0, 0.0, 1.0), StraightLane([-10.0, 8.0], [-10.0, 9.0]))
    for network, x, y in ((twins, 5.0, 1.0), (circle, -10.0, 0.0), (circle, -10.0, -0.0), (twins, np.nan, 0.0)):
        lanes = lane_table(network).lanes
        assert not closest(lanes, x, y, 0.0, np.zeros(2))[1]
        _assert_same(network, [x, y], 0.0)


def test_without_a_heading_and_with_lanes_of_other_kinds_highway_env_answers() -> None:
    class Other(StraightLane):  # type: ignore[misc]
        pass

    network = _of(StraightLane([0.0, 0.0], [10.0, 0.0]), Other([0.0, 4.0], [10.0, 4.0]))
    _assert_same(network, [5.0, 3.0], 0.1)
    straight = _of(StraightLane([0.0, 0.0], [10.0, 0.0]), StraightLane([0.0, 4.0], [10.0, 4.0]))
    assert FastRoadNetwork(straight, lane_table(straight)).get_closest_lane_index(np.array([5.0, 3.0])) == ("a", "b", 1)


def test_a_network_with_a_search_of_its_own_keeps_it() -> None:
    class Own(RoadNetwork):  # type: ignore[misc]
        pass

    own = Own()
    assert fast_network(own) is own
    assert type(fast_network(_of(StraightLane([0.0, 0.0], [10.0, 0.0])))) is FastRoadNetwork
