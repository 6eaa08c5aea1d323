"""Right of way at a crossing without lights: the other drivers enter it only where their way through is free.

highway-env's rule stops the driver of the lower priority wherever it is, also inside the crossing, and the one of the
higher priority then drives into it. Here a driver gets permission to enter before the crossing, or waits, and goes
through once it has it. Symbols: s station on the way of a driver [m], from where the crossing begins.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from highway_env.road.regulation import RegulatedRoad
from highway_env.road.road import RoadNetwork
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from lanebound.envs.worlds.drivers import IntersectionDriver
from lanebound.envs.worlds.idm_parameters_kernel import ASKS_M, CLEAR_S, EXIT_M, GAP_S, SLOW_MPS, START_MPS2

__all__ = ["CrossingRoad", "Way", "ways_through"]

Array = NDArray[np.float64]
Movement = tuple[str, str]
STEP_M = 0.5
NEAR_M = 3.0  # of two middles: two half widths and 1 m for the lines of drivers in their lanes


class Way(NamedTuple):
    """A way through the crossing.

    Attributes
    ----------
    shared : stations of its middle between which it is near another way, by the movement of that one [m]
    """

    priority: int
    shared: dict[Movement, tuple[float, float]]


def ways_through(network: RoadNetwork) -> dict[Movement, Way]:
    """All ways from an approach (``ir``) to an exit (``il``) of a network of highway-env's intersection."""
    points: dict[Movement, Array] = {}
    lanes = {(a, b): ends[b][0] for a, ends in network.graph.items() if a.startswith("ir") for b in ends}
    for (start, end), lane in lanes.items():
        ((_, (leaving, *_)),) = network.graph[end].items()
        inside = [lane.position(s, 0.0) for s in np.arange(0.0, lane.length, STEP_M)]
        points[start, end] = np.array([*inside, *(leaving.position(s, 0.0) for s in np.arange(0.0, EXIT_M, STEP_M))])
    found = {}
    for own, here in points.items():
        shared = {}
        for other, there in points.items():
            near = np.flatnonzero(np.hypot(*np.moveaxis(here[:, None] - there, -1, 0)).min(axis=1) < NEAR_M)
            if other[0] == own[0]:
                shared[other] = (0.0, EXIT_M)
            elif near.size:
                shared[other] = (STEP_M * float(near[0]), STEP_M * float(near[-1]))
        found[own] = Way(int(lanes[own].priority), shared)
    return found


class CrossingRoad(RegulatedRoad):  # type: ignore[misc]
    """A road with a crossing that drivers enter with permission, in place of highway-env's rule.

    Permission is decided in the order of their priority, the nearer one first among equals, until they can no longer
    stop before it. One may enter if all that are inside or may enter already leave what they share with its way
    before it is there, and if it does so before another one of higher priority arrives. The ego needs no permission,
    and no driver gives way to it. A driver that stands waits while the ego is inside; one that drives brakes for an
    ego that is on its way or on another one from its approach, as behind a leader.
    """

    REGULATION_FREQUENCY = 5

    def enforce_road_rules(self) -> None:
        """Decide for each driver that approaches whether it may enter."""
        if not hasattr(self, "ways"):
            self.ways = ways_through(self.network)
        drivers = [v for v in self.vehicles if isinstance(v, IntersectionDriver)]
        for v in drivers:
            v.movement = _movement(v)
            v.may_enter = v.movement is not None and (v.to_line_m() <= 0.0 or (v.may_enter and not v.stops_in_time()))
        asking = [v for v in drivers if v.movement is not None and not v.may_enter]
        first = {v.lane_index: v for v in sorted(asking, key=IntersectionDriver.to_line_m, reverse=True)}
        order = sorted(first.values(), key=lambda v: (-self._way(v).priority, v.to_line_m()))
        for n, v in enumerate(order):
            if v.to_line_m() < ASKS_M:
                v.may_enter = self._free(v, drivers) and self._in_time(v, order[:n])

    def _free(self, v: IntersectionDriver, drivers: list[IntersectionDriver]) -> bool:
        """Whether all that may enter make way for a driver, and no ego is inside that it waits for."""
        ego_inside = any(not isinstance(u, IntersectionDriver) and _inside(u) for u in self.vehicles)
        if ego_inside and v.speed < SLOW_MPS:
            return False
        return all(u is v or self._makes_way(u, v) for u in drivers if u.may_enter)

    def _makes_way(self, u: IntersectionDriver, v: IntersectionDriver) -> bool:
        """Whether a driver that may enter leaves what it shares with the way of another one before that one is there.

        The first one speeds up gently, the other one as much as drivers do.
        """
        span = self._shared(u, v)
        if span is None:
            return True
        left = span[1] + 0.5 * u.LENGTH - self._station(u)
        reaches = self._shared(v, u)
        if reaches is None or left <= 0.0 or _arm(u) == _arm(v):
            return bool(left <= 0.0)
        begins = reaches[0]
        return _time_s(left, u.speed, 0.5 * START_MPS2) + CLEAR_S < _time_s(v.to_line_m() + begins, v.speed, START_MPS2)

    def _way(self, v: IntersectionDriver) -> Way:
        assert v.movement is not None
        return self.ways[v.movement]

    def _shared(self, u: IntersectionDriver, v: IntersectionDriver) -> tuple[float, float] | None:
        """Stations of a driver's way that are near that of another one."""
        assert v.movement is not None
        return self._way(u).shared.get(v.movement)

    def _station(self, u: IntersectionDriver) -> float:
        assert u.movement is not None
        way = self.network.get_lane((*u.movement, 0))
        lane = way if _inside(u) else u.lane
        s = float(lane.local_coordinates(u.position)[0])
        return s if _inside(u) else s + way.length if u.lane_index[0].startswith("il") else s - lane.length

    def _in_time(self, v: IntersectionDriver, before: list[IntersectionDriver]) -> bool:
        """Whether a driver is clear before those that have priority and no permission yet reach the crossing."""
        for u in before:
            span = self._shared(v, u)
            if span is None or self._way(u).priority == self._way(v).priority:
                continue
            clear_s = _time_s(v.to_line_m() + span[1] + v.LENGTH, v.speed, START_MPS2)
            if u.to_line_m() / max(u.speed, SLOW_MPS) < clear_s + GAP_S:
                return False
        return True


def _time_s(way_m: float, speed_mps: float, accelerate_mps2: float) -> float:
    """Time for a way, speeding up all the while."""
    return float((np.sqrt(speed_mps**2 + 2.0 * accelerate_mps2 * way_m) - speed_mps) / accelerate_mps2)


def _movement(v: IntersectionDriver) -> Movement | None:
    """The way of a driver through the crossing; None once it has left it."""
    if _inside(v):  # where lanes overlap the nearest one need not be its own
        return v.movement
    if v.lane_index[0].startswith("il"):
        s = v.lane.local_coordinates(v.position)[0]
        return v.movement if s < EXIT_M + v.LENGTH else None
    ahead = [index[:2] for index in v.route or () if index[0].startswith("ir")]
    return ahead[0] if ahead else None


def _arm(v: IntersectionDriver) -> str:
    return v.movement[0] if v.movement is not None else ""


def _inside(vehicle: Vehicle) -> bool:
    """Whether the middle of a vehicle is inside the crossing."""
    return bool(vehicle.lane_index[0].startswith("ir"))
