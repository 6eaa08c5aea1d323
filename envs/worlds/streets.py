"""The worlds of city streets.

- UrbanCanyon: a city loop with open road, canyons, overpasses, a tunnel and traffic.
- CarFollowing: a long road and one vehicle ahead that accelerates, brakes and stops as in town traffic.
- LaneKeeping: a curved road, on which the ego stays in the middle of the lane.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.vehicle.kinematics import Vehicle

from lanebound.envs.worlds.base import META, Array, Seat, World
from lanebound.envs.worlds.drivers import CityDriver, LeadVehicle, SpeedProfileConfig, follow_all, speed_profile
from lanebound.envs.worlds.networks import (
    Section,
    StreetNetwork,
    advance,
    city_loop,
    city_sections,
    long_road,
    node_at,
    winding_road,
)
from lanebound.envs.worlds.street_maps import map_cities_of, map_roads_of
from lanebound.integrity.sky.scene import City

__all__ = ["CarFollowingWorld", "LaneKeepingWorld", "UrbanCanyonWorld"]


class CarFollowingWorld(World):
    """Follow a lead vehicle through stop-and-go traffic on one lane without hitting it or falling behind.

    Action, observation, reward
        Those of :class:`World`.
    Start
        Behind the lead vehicle at its speed, with a gap of ``standstill_gap + T v`` between bumpers, T uniform.
    Episode end
        That of :class:`World`; also truncated at the end of the road.
    Configuration
        ``layout`` (number of the first road), ``roads`` (how many, one of them drawn for each episode),
        ``standstill_gap`` [m], ``time_gap`` [s] (range of T), ``lead`` (changes to :class:`SpeedProfileConfig`),
        ``platoon`` (vehicles ahead, 1 to 4: the first drives that profile, the others follow it,
        :func:`~.drivers.follow_all`).
    """

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """Defaults of all keys."""
        own = {"duration": 120.0, "layout": 0, "roads": 1, "standstill_gap": 2.0, "time_gap": [0.8, 1.0], "lead": {}}
        return super().default_config() | own | {"platoon": 1}

    @property
    def lead(self) -> LeadVehicle:
        """The vehicle ahead."""
        return next(vehicle for vehicle in self.road.vehicles if isinstance(vehicle, LeadVehicle))

    def gap_m(self) -> float:
        """Free road between the ego's front and the lead vehicle's rear, along the lane [m]."""
        return float(self.vehicle.lane_distance_to(self.lead) - 0.5 * (self.vehicle.LENGTH + self.lead.LENGTH))

    def _network(self) -> StreetNetwork:
        c = self.config
        return StreetNetwork.apart([long_road(c["layout"] + k, c["lane_width"]) for k in range(c["roads"])])

    @classmethod
    def most_vehicles(cls, config: dict[str, Any]) -> int:
        """The ego and the vehicles ahead."""
        return 1 + int(config["platoon"])

    @staticmethod
    def _profiles(world: AbstractEnv) -> int:
        """One for each vehicle ahead."""
        return int(world.config["platoon"])

    def draw_seats(self, rng: np.random.Generator) -> tuple[list[Seat], Array | None]:
        """Draw a start from which the end of the road is not reached within the episode at the speed limit."""
        c = self.config
        law = SpeedProfileConfig.load(c["lead"], "lead")
        speeds = speed_profile(rng, c["duration"], 1.0 / c["simulation_frequency"], law)
        index, speed = (*drawn_road(rng, c["roads"]), 0), float(speeds[0])
        lane = self.road.network.get_lane(index)
        gap = c["standstill_gap"] + float(rng.uniform(*c["time_gap"])) * speed
        latest = lane.length - END_M - lane.speed_limit * c["duration"]
        start = float(rng.uniform(10.0, max(latest, 20.0)))
        seats = [Seat(index, start, speed), Seat(index, start + gap + LeadVehicle.LENGTH, speed)]
        gaps = [c["standstill_gap"] + float(rng.uniform(*c["time_gap"])) * speed for _ in range(1, c["platoon"])]
        for between in gaps:
            seats.append(Seat(index, seats[-1].along_m + between + LeadVehicle.LENGTH, speed))
        return seats, follow_all(speeds, gaps, 1.0 / c["simulation_frequency"]) if gaps else speeds


END_M = 40.0  # of the road are left when an episode at the speed limit ends


def drawn_road(rng: np.random.Generator, roads: int) -> tuple[str, str]:
    """The road of an episode, of several; nothing is drawn where there is one."""
    site = int(rng.integers(roads)) if roads > 1 else 0
    return node_at("start", site), node_at("end", site)


class LaneKeepingWorld(World):
    """Keep the lane along 1.8 km of straights, bends of 40 to 160 m radius and S-bends, alone on the road.

    Action, observation, reward
        Those of :class:`World`.
    Start
        On a random lane, at a place from which the end of the road is not reached within the episode at the limit of
        50 km/h, with ``initial_speed`` or the smaller speed that the bends ahead allow.
    Episode end
        That of :class:`World`; also truncated at the end of the road.
    Configuration
        ``layout`` (number of the first road), ``roads`` (how many, one of them drawn for each episode), ``lanes_count``
        (in the same direction), ``initial_speed`` [m/s].
    """

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """Defaults of all keys."""
        return super().default_config() | {"layout": 0, "roads": 1, "lanes_count": 1, "initial_speed": 10.0}

    def _network(self) -> StreetNetwork:
        c = self.config
        roads = [winding_road(c["layout"] + k, c["lanes_count"], c["lane_width"]) for k in range(c["roads"])]
        return StreetNetwork.apart(roads)

    def draw_seats(self, rng: np.random.Generator) -> tuple[list[Seat], Array | None]:
        """Draw a start from which the end of the road is not reached within the episode at the speed limit."""
        road = drawn_road(rng, self.config["roads"])
        index = (*road, int(rng.integers(self.config["lanes_count"])))
        lane = self.road.network.get_lane(index)
        latest = lane.length - END_M - lane.speed_limit * self.config["duration"]
        start = float(rng.uniform(10.0, max(latest, 20.0)))
        return [Seat(index, start, min(self.config["initial_speed"], lane.advised_speed(start)))], None


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
        [m] (range along the road around the ego for their starts), ``initial_speed`` [m/s]; ``map`` (a packaged street
        map, a file or ``generated:SEED``, whose streets and buildings take the place of the loop; ``generated``: one in
        each generated city of ``seeds``; None: the loop), ``route`` (number of the closed way through the map, 0 for
        the longest), ``via`` (places, latitude and longitude, by which it leads), ``roads`` (number of ways from
        ``route`` on), ``seeds`` (of the cities). Where there are several ways, one is drawn for each episode.
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
            "map": None,
            "route": 0,
            "via": [],
            "roads": 1,
            "seeds": [],
        }

    @property
    def sections(self) -> tuple[Section, ...]:
        """Surroundings of the loop."""
        return city_sections(self.road.network) if self.config["map"] is None else ()

    @property
    def surroundings(self) -> tuple[City, ...]:
        """The obstacles of the map at each site; none for the loop, along which they are generated."""
        return map_cities_of(self.config)

    def _network(self) -> StreetNetwork:
        roads = map_roads_of(self.config)
        loops = [road.network() for road in roads] or [city_loop(self.config["lane_width"])]
        return StreetNetwork.apart(loops)

    @classmethod
    def most_vehicles(cls, config: dict[str, Any]) -> int:
        """Number of the ego and all others, some of which may be left out."""
        return 1 + int(config["vehicles_count"])

    def draw_seats(self, rng: np.random.Generator) -> tuple[list[Seat], Array | None]:
        """Draw places on the loop; vehicles that would start too close to another are left out."""
        c, network = self.config, self.road.network
        sites = len(network.sites)
        here = network.alone(int(rng.integers(sites))) if sites else network
        start, end, side = here.random_lane_index(rng)
        index = (str(start), str(end), int(side))
        lane = network.get_lane(index)
        along = float(rng.uniform(0.0, lane.length))
        speed = min(c["initial_speed"], lane.advised_speed(along))
        seats, taken = [Seat(index, along, speed, speed, CityDriver.DELTA)], [lane.position(along, 0.0)]
        for _ in range(c["vehicles_count"]):
            away, side = float(rng.uniform(*c["spread"])), int(rng.integers(len(network.graph[start][end])))
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
