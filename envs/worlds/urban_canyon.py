"""Round a city: a loop of open road, canyons, overpasses and a tunnel, among other traffic."""

from __future__ import annotations

from typing import Any

import numpy as np

from lanebound.envs.records import LaneIndex
from lanebound.envs.worlds.base import META, World
from lanebound.envs.worlds.drivers import CityDriver
from lanebound.envs.worlds.networks import CITY_SECTIONS, Section, StreetNetwork, advance, city_loop

__all__ = ["UrbanCanyonWorld"]

ROOM_M = 20.0  # from middle to middle of two vehicles at the start


class UrbanCanyonWorld(World):
    """Drive round a loop of 3 km with two lanes and corners of 24 m radius upwards, among city drivers.

    Action, observation, reward
        Those of :class:`World`; meta-actions at 2 Hz by default.
    Start
        Anywhere on the loop, at ``initial_speed`` or that which the bends ahead allow; the others about the ego.
    Episode end
        That of :class:`World`; the loop has no end.
    Configuration
        ``vehicles_count`` (other vehicles at most; places already taken stay single), ``spread`` [m] (range along the
        road, from the ego, in which they start), ``initial_speed`` [m/s].
    """

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
        """What lines the loop; ends are clipped to the edges' lengths."""
        graph = self.road.network.graph
        return tuple((a, b, start, min(end, graph[a][b][0].length), kind) for a, b, start, end, kind in CITY_SECTIONS)

    def _network(self) -> StreetNetwork:
        return city_loop(self.config["lane_width"])

    def _populate(self) -> None:
        index: LaneIndex = self.road.network.random_lane_index(self.np_random)
        index = (str(index[0]), str(index[1]), int(index[2]))
        lane = self.road.network.get_lane(index)
        start = float(self.np_random.uniform(0.0, lane.length))
        self._place_ego(index, start, min(self.config["initial_speed"], lane.advised_speed(start)))
        for _ in range(self.config["vehicles_count"]):
            self._place_other(index, start)

    def _place_other(self, index: LaneIndex, start_m: float) -> None:
        """A city driver somewhere about the ego, unless someone is there already."""
        away, side = self.np_random.uniform(*self.config["spread"]), int(self.np_random.integers(2))
        share = float(self.np_random.uniform(0.8, 1.0))
        there, s = advance(self.road.network, (index[0], index[1], side), start_m, float(away))
        lane = self.road.network.get_lane(there)
        place = lane.position(s, 0.0)
        if min(np.hypot(*(other.position - place)) for other in self.road.vehicles) < ROOM_M:
            return
        speed = min(share * lane.speed_limit, lane.advised_speed(s))
        driver = CityDriver.make_on_lane(self.road, there, s, speed)
        driver.target_speed = share * lane.speed_limit
        driver.randomize_behavior()
        self.road.vehicles.append(driver)
