"""A road through a work zone: narrow lanes, of which one closes after a while."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from highway_env.vehicle.kinematics import Vehicle

from lanebound.envs.records import LaneIndex
from lanebound.envs.worlds.base import META, Array, Seat, World
from lanebound.envs.worlds.closures import Closure
from lanebound.envs.worlds.drivers import CityDriver
from lanebound.envs.worlds.networks import StreetNetwork, long_road
from lanebound.envs.worlds.streets import END_M, ROOM_M
from lanebound.integrity.core.errors import ConfigError

__all__ = ["WorkZoneWorld"]

FIRST_M = 20.0  # of the road, from where an ego may start
CLEAR_M = 60.0  # before a closure on the closed lane, where nobody starts; a stop from 50 km/h in comfort takes 48 m
OWN_SHARE = (
    0.75  # of the episodes close the lane of the ego: the others show that a closure need not concern it; chosen
)
TARGET_SHARE = 0.6, 0.9  # of the limit that others want, chosen: they slow down in a work zone


class WorkZoneWorld(World):
    """Drive on narrow lanes past a closed stretch of one of them, among city drivers who change lane before it.

    Action, observation, reward
        Those of :class:`World`; meta-actions at 2 Hz by default.
    Start
        In the middle of a lane, ``ahead`` before the closure, with ``initial_speed``; the others start around the ego.
    Episode end
        That of :class:`World`.
    Configuration
        ``layout`` (0 to 3: which road), ``lanes_count``, ``lane_width`` [m], ``ahead`` [m] (range of the distance to
        the closure), ``closed_length`` [m], ``closed_limit`` [m/s] (beside it), ``vehicles_count`` (largest number of
        others), ``spread`` [m] (range along the road around the ego for their starts), ``initial_speed`` [m/s].
    """

    OTHERS: ClassVar[type[Vehicle]] = CityDriver
    TRAFFIC: ClassVar[str] = "city"

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """Defaults of all keys."""
        return super().default_config() | {
            "action": dict(META),
            "policy_frequency": 2,
            "lane_width": 2.8,
            "layout": 0,
            "lanes_count": 2,
            "ahead": [200.0, 400.0],
            "closed_length": 100.0,
            "closed_limit": 30.0 / 3.6,
            "vehicles_count": 6,
            "spread": [-150.0, 250.0],
            "initial_speed": 10.0,
        }

    def _network(self) -> StreetNetwork:
        c = self.config
        if c["lanes_count"] < 2:
            raise ConfigError(f"world.lanes_count must be >= 2, got {c['lanes_count']}: a lane must stay open")
        network = long_road(c["layout"], c["lane_width"], c["lanes_count"])
        length = network.get_lane(("start", "end", 0)).length
        needed = FIRST_M + c["ahead"][1] + c["closed_length"] + END_M
        if needed > length:
            raise ConfigError(
                f"world.ahead and world.closed_length must fit on a road of {length:.0f} m, got {needed:.0f} m "
                "with the ends: lower them, or take another layout"
            )
        return network

    @classmethod
    def most_vehicles(cls, config: dict[str, Any]) -> int:
        """Number of the ego and all others, some of which may be left out."""
        return 1 + int(config["vehicles_count"])

    def draw_closure(self, rng: np.random.Generator) -> Closure:
        """Draw lane and place, so that the end of the road is not reached within the episode at the speed limit."""
        c = self.config
        side = int(rng.integers(c["lanes_count"]))
        index = ("start", "end", side)
        lane = self.road.network.get_lane(index)
        nearest, farthest = c["ahead"]
        first = FIRST_M + farthest
        start = float(rng.uniform(first, max(lane.length - END_M - lane.speed_limit * c["duration"] + nearest, first)))
        return Closure(index, start, start + c["closed_length"], c["closed_limit"])

    def draw_seats(self, rng: np.random.Generator) -> tuple[list[Seat], Array | None]:
        """Draw places before and around the closure; vehicles that would start too close to something are left out."""
        c, network, closure = self.config, self.road.network, self.closure
        assert closure is not None
        lanes, side = c["lanes_count"], closure.lane_index[2]
        if rng.random() >= OWN_SHARE:
            side = (side + 1 + int(rng.integers(max(lanes - 1, 1)))) % lanes
        index: LaneIndex = ("start", "end", side)
        along = closure.start_m - float(rng.uniform(*c["ahead"]))
        seats = [Seat(index, along, c["initial_speed"], c["initial_speed"], CityDriver.DELTA)]
        taken = [network.get_lane(index).position(along, 0.0)]
        for _ in range(c["vehicles_count"]):
            s, there = along + float(rng.uniform(*c["spread"])), ("start", "end", int(rng.integers(lanes)))
            share, exponent = float(rng.uniform(*TARGET_SHARE)), float(rng.uniform(*CityDriver.DELTA_RANGE))
            lane = network.get_lane(there)
            blocked = there == closure.lane_index and closure.start_m - CLEAR_M < s < closure.end_m + ROOM_M
            place = lane.position(s, 0.0)
            if blocked or s < 0.0 or min(np.hypot(*(other - place)) for other in taken) < ROOM_M:
                continue
            wanted = share * lane.speed_limit
            seats.append(Seat(there, s, min(wanted, lane.advised_speed(s)), wanted, exponent))
            taken.append(place)
        return seats, None
