"""Lanes and maps as arrays answer as the objects do."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from highway_env.road.road import RoadNetwork

from lanebound.envs.observation.config import ObservationConfig
from lanebound.envs.observation.path import RoadMap
from lanebound.envs.vector import lanes_kernel as lk
from lanebound.envs.vector.chart import chart_of
from lanebound.envs.vector.chart_kernel import path_at, project
from lanebound.envs.vector.lanes import lane_rows, lanes_of
from lanebound.envs.worlds.networks import city_loop, winding_road
from lanebound.envs.worlds.paths import SQUARE_M
from lanebound.integrity.core.errors import ConfigError

NETWORKS = {
    "winding": winding_road(1, 3, 3.25),
    "loop": city_loop(3.25),
    "straight": RoadNetwork.straight_road_network(4, speed_limit=30),
}


def _points(network: Any, rng: np.random.Generator, count: int) -> list[tuple[int, Any]]:
    """Points on and beside lanes, and past their ends."""
    rows = lane_rows(network)
    picked = rng.integers(len(rows), size=count)
    out = []
    for n in picked.tolist():
        lane = network.get_lane(rows[n])
        out.append((n, lane.position(rng.uniform(-8.0, min(lane.length, 3000.0) + 8.0), rng.uniform(-6.0, 6.0))))
    return out


def test_squares_are_those_of_paths() -> None:
    assert lk.SQUARE_M == SQUARE_M


@pytest.mark.parametrize("name", NETWORKS)
def test_places_on_lanes_and_nearest_lanes_are_the_same(name: str) -> None:
    network, rng = NETWORKS[name], np.random.default_rng(1)
    lanes, rows = lanes_of(network), lane_rows(network)
    for n, point in _points(network, rng, 60):
        lane, heading = network.get_lane(rows[n]), float(rng.uniform(-4.0, 4.0))
        s, r, direction = lk.local(lanes, n, *point)
        assert (s, r) == pytest.approx(lane.local_coordinates(point), abs=1e-9)
        assert lk.wrap(direction - lane.heading_at(s)) == pytest.approx(0.0, abs=1e-9)
        assert lk.heading_at(lanes, n, s) == pytest.approx(lane.heading_at(s), abs=1e-9)
        np.testing.assert_allclose(lk.place(lanes, n, s, r), lane.position(s, r), atol=1e-9)
        assert lk.on_lane(lanes.table, n, s, r) == lane.on_lane(point)
        assert lk.reachable(lanes.table, n, s, r) == lane.is_reachable_from(point)
        assert rows[lk.nearest(lanes, *point, heading)] == network.get_closest_lane_index(point, heading)


@pytest.mark.parametrize("name", NETWORKS)
def test_paths_ahead_are_the_same(name: str) -> None:
    network, config, rng = NETWORKS[name], ObservationConfig(), np.random.default_rng(2)
    chart, roads, rows = chart_of(network, config), RoadMap(network, config.range_m, config.range_m), lane_rows(network)
    for n, point in _points(network, rng, 40):
        path, guess = roads.path(rows[n]), float(rng.uniform(-100.0, network.get_lane(rows[n]).length + 200.0))
        np.testing.assert_allclose(path_at(chart, n, guess), path.at(guess), atol=1e-9)
        start = network.get_lane(rows[n]).local_coordinates(point)[0] + float(rng.uniform(-5.0, 5.0))
        s, r, found = project(chart, n, *point, start)
        wanted = path.project(*point.tolist(), start)
        assert found == (wanted is not None)
        if wanted is not None:
            assert (s, r) == pytest.approx(wanted, abs=1e-9)
    assert chart.following.shape[0] == len(rows)


def test_other_lanes_are_refused() -> None:
    with pytest.raises(ConfigError, match="straight ones along x"):
        lanes_of(RoadNetwork.straight_road_network(2, angle=0.3))
