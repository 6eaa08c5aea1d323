"""Satellites predicted ahead along a route, lane by lane: the reference of ``envs/batch/sky_ahead_kernel.py``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from highway_env.road.road import RoadNetwork
from numpy.typing import ArrayLike, NDArray

from lanebound.envs.batch.sky_ahead_kernel import NO_LANE
from lanebound.envs.records import LaneIndex
from lanebound.envs.sky import Street
from lanebound.integrity.sky.view import SkyView

__all__ = ["ahead", "predicted_beside"]

Route = Sequence[tuple[str, str, int | None]]


def ahead(
    network: RoadNetwork, lane_index: LaneIndex, longitudinal_m: float, distance_m: float, route: Route | None = None
) -> tuple[LaneIndex, float]:
    """The lane and longitudinal position ``distance_m`` further along the route.

    A route is highway-env's list of lane indices. Without an entry, or after its end, the first edge onward is
    taken; at the end of the last lane, its end.
    """
    place = longitudinal_m + distance_m
    onward = {} if route is None else {step[0]: step for step in route}
    while place > (length := network.get_lane(lane_index).length):
        options = _following(network, lane_index)
        if not options:
            return lane_index, length
        place -= length
        step = onward.get(lane_index[1])
        lane_index = (options.get(step[1]) if step else None) or next(iter(options.values()))
    return lane_index, place


def _following(network: RoadNetwork, index: LaneIndex) -> dict[str, LaneIndex]:
    """Next lanes by highway-env's rule: the same lane if the next edge has as many lanes, otherwise the nearest one."""
    start, end, i = index
    lane, out = network.get_lane(index), {}
    for beyond, others in network.graph.get(end, {}).items():
        away = [np.linalg.norm(other.position(0.0, 0.0) - lane.position(lane.length, 0.0)) for other in others]
        if away:
            out[beyond] = (end, beyond, i if len(others) == len(network.graph[start][end]) else int(np.argmin(away)))
    return out


def predicted_beside(
    street: Street, network: RoadNetwork, lane_index: LaneIndex, longitudinal_m: float, distances_m: ArrayLike,
    sky: SkyView, route: Route | None = None,
) -> NDArray[np.int64]:  # fmt: skip
    """The number of satellites in line of sight at distances ahead along the route.  (D,) [m] -> (D, 3).

    The columns are the lane to the left, the lane of the route and the lane to the right; -1 for no lane. The
    places on the neighbouring lanes are at the same share of the length.
    """
    out = []
    for d in np.asarray(distances_m, dtype=np.float64):
        (start, end, own), place = ahead(network, lane_index, longitudinal_m, float(d), route)
        lanes = network.graph[start][end]
        for i in (own - 1, own, own + 1):
            if not 0 <= i < len(lanes):
                out.append(int(NO_LANE))
                continue
            arc, lane = street.where((start, end, i), place / lanes[own].length * lanes[i].length)
            out.append(int(street.forecast.count(np.array([arc]), np.array([lane]), sky)[0]))
    return np.array(out).reshape(-1, 3)
