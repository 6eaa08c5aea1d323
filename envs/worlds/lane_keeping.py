"""A curved road through streets, on which the ego stays in the middle of the lane."""

from __future__ import annotations

from typing import Any

import numpy as np

from lanebound.envs.worlds.base import Array, Seat, World
from lanebound.envs.worlds.networks import StreetNetwork, winding_road

__all__ = ["LaneKeepingWorld"]

END_M = 40.0  # of the road are left when an episode at the speed limit ends


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
        ``layout`` (0 to 3: which road), ``lanes_count`` (in the same direction), ``initial_speed`` [m/s].
    """

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """Defaults of all keys."""
        return super().default_config() | {"layout": 0, "lanes_count": 1, "initial_speed": 10.0}

    def _network(self) -> StreetNetwork:
        return winding_road(self.config["layout"], self.config["lanes_count"], self.config["lane_width"])

    def draw_seats(self, rng: np.random.Generator) -> tuple[list[Seat], Array | None]:
        """Draw a start from which the end of the road is not reached within the episode at the speed limit."""
        index = ("start", "end", int(rng.integers(self.config["lanes_count"])))
        lane = self.road.network.get_lane(index)
        latest = lane.length - END_M - lane.speed_limit * self.config["duration"]
        start = float(rng.uniform(10.0, max(latest, 20.0)))
        return [Seat(index, start, min(self.config["initial_speed"], lane.advised_speed(start)))], None
