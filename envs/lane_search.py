"""The lane nearest to a pose, true or believed: highway-env's answer, found without asking each lane in turn."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.road.lane import AbstractLane, CircularLane, SineLane, StraightLane
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

from lanebound.envs import lane_search_kernel as kernel
from lanebound.envs.records import LaneIndex

__all__ = ["SwiftNetwork", "swift"]

Array = NDArray[np.float64]


class SwiftNetwork(RoadNetwork):  # type: ignore[misc]
    """A road network over the lanes of another one, with a faster search for the closest lane.

    Distances are computed for all lanes at once, in an order of operations of its own; where two lanes are as near but
    for rounding, and on networks with lanes of other kinds than straight, sine and circular ones, highway-env's own
    search decides. So the answer is always the same.
    """

    def __init__(self, network: RoadNetwork) -> None:
        super().__init__()
        self.graph = network.graph
        edges = [(a, b, row) for a, roads in self.graph.items() for b, row in roads.items()]
        lanes: list[LaneIndex] = [(a, b, i) for a, b, row in edges for i in range(len(row))]
        rows = [_row(self.graph[a][b][i]) for a, b, i in lanes]
        self._lanes = lanes
        self._table = None if None in rows else np.array(rows, dtype=np.float64).reshape(-1, kernel.COLUMNS)

    def get_closest_lane_index(self, position: Array, heading: float | None = None) -> LaneIndex:
        """Index of the lane closest to a position (2,) and a heading, as highway-env defines it."""
        if self._table is not None and heading is not None:
            x, y = position.tolist()
            row = int(kernel.nearest(self._table, x, y, float(heading)))
            if row >= 0:
                return self._lanes[row]
        found: LaneIndex = super().get_closest_lane_index(position, heading)
        return found


def swift(network: RoadNetwork) -> RoadNetwork:
    """The same network with the faster search; a network that has a search of its own is left as it is."""
    return SwiftNetwork(network) if type(network) is RoadNetwork else network


def _row(lane: AbstractLane) -> list[Any] | None:
    """A lane in the columns of the kernel; None for a kind that the kernel does not know."""
    kind = type(lane)
    if kind is CircularLane:
        turn = float(lane.direction)
        x, y = lane.center
        return [kernel.CIRCULAR, x, y, 0.0, 0.0, 0.0, lane.length, 0.0, 0.0, lane.start_phase, lane.radius, turn]
    if kind is not StraightLane and kind is not SineLane:
        return None
    axis = [*lane.start, *lane.direction, lane.heading, lane.length]
    if kind is SineLane:
        return [kernel.WAVY, *axis, lane.amplitude, lane.pulsation, lane.phase, 0.0, 0.0]
    return [kernel.STRAIGHT, *axis, 0.0, 0.0, 0.0, 0.0, 0.0]
