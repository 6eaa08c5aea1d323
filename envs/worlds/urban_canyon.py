"""A city loop with open road, canyons, overpasses, a tunnel and traffic."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from highway_env.vehicle.kinematics import Vehicle

from lanebound.envs.worlds.base import META, Array, Seat, World
from lanebound.envs.worlds.drivers import CityDriver
from lanebound.envs.worlds.networks import CITY_SECTIONS, Section, StreetNetwork, advance, city_loop

__all__ = ["UrbanCanyonWorld"]

ROOM_M = 20.0  # smallest distance between the centres of two vehicles at the start


class UrbanCanyonWorld(World):
    """Drive along a loop of 3 km with two lanes and corners of at least 24 m radius among city drivers.

    Action, observation, reward
        Those of :class:`World`; meta-actions at 2 Hz by default.
    Start
        Anywhere on the loop, with ``initial_speed`` or the smaller speed that the bends ahead allow; the others start
        around the ego.
    Episode end
        That of :class:`World`; the loop has no end.
    Configuration
        ``vehicles_count`` (largest number of other vehicles; a vehicle whose place is occupied is left out), ``spread``
        [m] (range along the road around the ego for their starts), ``initial_speed`` [m/s].
    """

    OTHERS: ClassVar[type[Vehicle]] = CityDriver
    TRAFFIC: ClassVar[str] = "city"
    ENDS_M: ClassVar[float | None] = None

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """Defaults of all keys."""
        return super().default_config() | {
            "action": dict(META),
            "policy_frequency": 2,
            "duration": 120.0,
            "vehicles_count": 10,
            "spread": [-200.0, 400.0],
            "initial_speed": 10.0,
        }

    @property
    def sections(self) -> tuple[Section, ...]:
        """Surroundings of the loop; ends are limited to the lengths of the edges."""
        graph = self.road.network.graph
        return tuple((a, b, start, min(end, graph[a][b][0].length), kind) for a, b, start, end, kind in CITY_SECTIONS)

    def _network(self) -> StreetNetwork:
        return city_loop(self.config["lane_width"])

    @classmethod
    def most_vehicles(cls, config: dict[str, Any]) -> int:
        """Number of the ego and all others, some of which may be left out."""
        return 1 + int(config["vehicles_count"])

    def draw_seats(self, rng: np.random.Generator) -> tuple[list[Seat], Array | None]:
        """Draw places on the loop; vehicles that would start too close to another are left out."""
        c, network = self.config, self.road.network
        start, end, side = network.random_lane_index(rng)
        index = (str(start), str(end), int(side))
        lane = network.get_lane(index)
        along = float(rng.uniform(0.0, lane.length))
        speed = min(c["initial_speed"], lane.advised_speed(along))
        seats, taken = [Seat(index, along, speed, speed, CityDriver.DELTA)], [lane.position(along, 0.0)]
        for _ in range(c["vehicles_count"]):
            away, side = float(rng.uniform(*c["spread"])), int(rng.integers(2))
            share = float(rng.uniform(0.8, 1.0))
            there, s = advance(network, (*index[:2], side), along, away)
            lane = network.get_lane(there)
            place = lane.position(s, 0.0)
            if min(np.hypot(*(other - place)) for other in taken) < ROOM_M:
                continue
            wanted = share * lane.speed_limit
            speed, exponent = min(wanted, lane.advised_speed(s)), float(rng.uniform(*CityDriver.DELTA_RANGE))
            seats.append(Seat(there, s, speed, wanted, exponent))
            taken.append(place)
        return seats, None
