"""A platoon on the loop of a city: a leader that changes its speed, and vehicles that follow each other."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.vehicle.kinematics import Vehicle

from lanebound.envs.worlds.base import Array, Seat, World
from lanebound.envs.worlds.drivers import SpeedProfileConfig, slow_for_bends, speed_profile
from lanebound.envs.worlds.followers import PlatoonDriver
from lanebound.envs.worlds.networks import Section, StreetNetwork, advance, city_loop, city_sections

__all__ = ["PlatoonWorld"]

CANYON = "b", "c", 0  # the lane that begins in a canyon; the tunnel is on the next one
START_M = 60.0, 120.0  # stations of the ego there: the canyon ends at 140 m
LEAD: dict[str, Any] = {"stop_probability": 0.3, "hard_brake_mps2": [2.5, 4.0]}
"""Of the leader, chosen: fewer stops than in CarFollowing, so that most egos come through the tunnel, and no braking
that the followers, who react late, could not answer."""


class PlatoonWorld(World):
    """Drive in a platoon of four to eight vehicles on one lane of the loop of UrbanCanyon: a canyon, then a tunnel.

    Action, observation, reward
        Those of :class:`World`.
    Start
        In the canyon, with gaps of ``standstill_gap + T v`` between bumpers, T uniform, all at the speed of the first;
        v is what it would be without bends.
    Episode end
        That of :class:`World`; the loop has no end.
    Configuration
        ``vehicles`` (4 to 8, with the ego), ``place`` (of the ego, 2 and up; None: the middle),
        ``standstill_gap`` [m], ``time_gap`` [s] (range of T), ``lead`` (changes to :class:`SpeedProfileConfig`).
    """

    OTHERS: ClassVar[type[Vehicle]] = PlatoonDriver
    TRAFFIC: ClassVar[str] = "platoon"
    ENDS_M: ClassVar[float | None] = None

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """Defaults of all keys."""
        return super().default_config() | {
            "duration": 150.0,
            "vehicles": 5,
            "place": None,
            "standstill_gap": 2.0,
            "time_gap": [0.8, 1.0],
            "lead": dict(LEAD),
        }

    @property
    def sections(self) -> tuple[Section, ...]:
        """Surroundings of the loop."""
        return city_sections(self.road.network)

    @property
    def place(self) -> int:
        """Place of the ego, 1 for the first."""
        place, vehicles = self.config["place"], self.config["vehicles"]
        return int(1 + vehicles // 2 if place is None else place)

    def _network(self) -> StreetNetwork:
        return city_loop(self.config["lane_width"], lanes=1)

    @classmethod
    def most_vehicles(cls, config: dict[str, Any]) -> int:
        """All vehicles."""
        return int(config["vehicles"])

    @staticmethod
    def _profiles(world: AbstractEnv) -> int:
        """That of the first vehicle alone."""
        return 1

    def draw_seats(self, rng: np.random.Generator) -> tuple[list[Seat], Array | None]:
        """Draw the places, and the speeds of the first vehicle, with which it comes through the bends."""
        c, network, dt_s = self.config, self.road.network, 1.0 / self.config["simulation_frequency"]
        law = SpeedProfileConfig.load(c["lead"], "lead")
        speeds, along = speed_profile(rng, c["duration"], dt_s, law), float(rng.uniform(*START_M))
        between = rng.uniform(*c["time_gap"], size=c["vehicles"] - 1)  # type: ignore[call-overload]
        gaps = c["standstill_gap"] + between * speeds[0] + Vehicle.LENGTH
        ahead = [*np.cumsum(gaps)[::-1].tolist(), 0.0]
        places = [advance(network, CANYON, along, s - ahead[self.place - 1]) for s in ahead]
        speeds = slow_for_bends(speeds, network, *places[0], dt_s)
        limit = network.get_lane(CANYON).speed_limit
        seats = [Seat(*place, float(speeds[0]), limit, PlatoonDriver.DELTA) for place in places]
        return [seats.pop(self.place - 1), *seats], speeds
