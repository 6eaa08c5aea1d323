"""A road that finds the vehicles ahead and behind without projecting every vehicle on every lane."""

from __future__ import annotations

from math import inf
from typing import Any

from highway_env.road.road import Road
from highway_env.vehicle.objects import Landmark, RoadObject

from lanebound.envs.records import LaneIndex
from lanebound.envs.worlds.lanes import CurveLane

__all__ = ["StreetRoad"]


class StreetRoad(Road):  # type: ignore[misc]
    """A road on a :class:`StreetNetwork` with the same results as ``Road``."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._chains: dict[LaneIndex, list[tuple[CurveLane, float]]] = {}

    def neighbour_vehicles(
        self, vehicle: RoadObject, lane_index: LaneIndex | None = None
    ) -> tuple[RoadObject | None, RoadObject | None]:
        """Nearest vehicles ahead and behind on a lane (by default that of the vehicle) and on connected lanes."""
        index = lane_index or vehicle.lane_index
        if not index:
            return None, None
        chain = self._chain(index)
        s = chain[0][0].local_coordinates(vehicle.position)[0]
        front = rear = None
        front_m, rear_m = inf, -inf
        for other in self.vehicles + self.objects:
            if other is vehicle or isinstance(other, Landmark):
                continue
            place = _place(other, chain)
            if place is None:
                continue
            if s <= place <= front_m:
                front, front_m = other, place
            elif rear_m < place < s:
                rear, rear_m = other, place
        return front, rear

    def _chain(self, index: LaneIndex) -> list[tuple[CurveLane, float]]:
        """A lane with its following and preceding lanes, and their starts along it [m]."""
        if not self.neighbour_vehicles_connected_lanes:
            return [(self.network.get_lane(index), 0.0)]
        chain = self._chains.get(index)
        if chain is None:
            start, end, side = index
            graph, lane = self.network.graph, self.network.get_lane(index)
            ahead = [lanes[side if side < len(lanes) else 0] for lanes in graph.get(end, {}).values()]
            behind = [to[start][side if side < len(to[start]) else 0] for to in graph.values() if start in to]
            chain = [(lane, 0.0), *((a, lane.length) for a in ahead), *((b, -b.length) for b in behind)]
            self._chains[index] = chain
        return chain


def _place(other: RoadObject, chain: list[tuple[CurveLane, float]]) -> float | None:
    """Position of an object along a chain of lanes [m], on the first lane within 1 m of it; None for no lane."""
    position = other.position
    x, y = float(position[0]), float(position[1])
    for lane, start in chain:
        if lane.may_hold(x, y):
            s, r = lane.local_coordinates(position)
            if lane.on_lane(position, s, r, 1.0):
                return s + start
    return None
