"""A long road and one vehicle ahead that accelerates, brakes and stops as in town traffic."""

from __future__ import annotations

from typing import Any

import numpy as np

from lanebound.envs.worlds.base import Array, Seat, World
from lanebound.envs.worlds.drivers import LeadVehicle, SpeedProfileConfig, speed_profile
from lanebound.envs.worlds.lane_keeping import END_M
from lanebound.envs.worlds.networks import StreetNetwork, long_road

__all__ = ["CarFollowingWorld"]


class CarFollowingWorld(World):
    """Follow a lead vehicle through stop-and-go traffic on one lane without hitting it or falling behind.

    Action, observation, reward
        Those of :class:`World`.
    Start
        Behind the lead vehicle at its speed, with a gap of ``standstill_gap + T v`` between bumpers, T uniform.
    Episode end
        That of :class:`World`; also truncated at the end of the road.
    Configuration
        ``layout`` (0 to 3: which road), ``standstill_gap`` [m], ``time_gap`` [s] (range of T), ``lead`` (changes to
        :class:`SpeedProfileConfig`).
    """

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """Defaults of all keys."""
        own = {"duration": 120.0, "layout": 0, "standstill_gap": 2.0, "time_gap": [0.8, 1.0], "lead": {}}
        return super().default_config() | own

    @property
    def lead(self) -> LeadVehicle:
        """The vehicle ahead."""
        return next(vehicle for vehicle in self.road.vehicles if isinstance(vehicle, LeadVehicle))

    def gap_m(self) -> float:
        """Free road between the ego's front and the lead vehicle's rear, along the lane [m]."""
        return float(self.vehicle.lane_distance_to(self.lead) - 0.5 * (self.vehicle.LENGTH + self.lead.LENGTH))

    def _network(self) -> StreetNetwork:
        return long_road(self.config["layout"], self.config["lane_width"])

    @classmethod
    def most_vehicles(cls, config: dict[str, Any]) -> int:
        """The ego and the vehicle ahead."""
        return 2

    def draw_seats(self, rng: np.random.Generator) -> tuple[list[Seat], Array | None]:
        """Draw a start from which the end of the road is not reached within the episode at the speed limit."""
        c = self.config
        law = SpeedProfileConfig.load(c["lead"], "lead")
        speeds = speed_profile(rng, c["duration"], 1.0 / c["simulation_frequency"], law)
        index, speed = ("start", "end", 0), float(speeds[0])
        lane = self.road.network.get_lane(index)
        gap = c["standstill_gap"] + float(rng.uniform(*c["time_gap"])) * speed
        latest = lane.length - END_M - lane.speed_limit * c["duration"]
        start = float(rng.uniform(10.0, max(latest, 20.0)))
        return [Seat(index, start, speed), Seat(index, start + gap + LeadVehicle.LENGTH, speed)], speeds
