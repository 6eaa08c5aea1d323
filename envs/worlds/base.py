"""What the worlds share: rates, the ego, rewards, and how an episode ends."""

from __future__ import annotations

from math import cos, pi
from typing import Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.utils import lmap, wrap_to_pi

from lanebound.envs.records import LaneIndex
from lanebound.envs.worlds.networks import Section, StreetNetwork
from lanebound.envs.worlds.roads import StreetRoad

__all__ = ["TARGET_SPEEDS_MPS", "World"]

# Of meta-actions; evenly spaced, as MDPVehicle asks. Steps of 2 m/s would not brake in time for a lead vehicle.
TARGET_SPEEDS_MPS = [0.0, 2.8, 5.6, 8.4, 11.2, 14.0]
CONTINUOUS: dict[str, Any] = {
    "type": "ContinuousAction",
    "acceleration_range": [-6.0, 6.0],  # [m/s2]
    "steering_range": [-0.4, 0.4],  # [rad]; 12 m radius
    "speed_range": [0.0, 20.0],  # [m/s]
}
META: dict[str, Any] = {"type": "DiscreteMetaAction", "target_speeds": TARGET_SPEEDS_MPS}


class World(AbstractEnv):  # type: ignore[misc]
    """A scenario of highway-env on one of our roads: subclasses make the road and place who drives on it.

    Action
        highway-env's, by ``config["action"]``: ``ContinuousAction`` (acceleration within 6 m/s2, steering within
        0.4 rad) at 5 Hz, or ``DiscreteMetaAction`` (speeds from 0 to 14 m/s in steps of 2.8) at 2 Hz.
    Observation
        highway-env's, by ``config["observation"]``.
    Reward
        Weighted sum of progress, centring and collision, brought to [0, 1]; see :meth:`_rewards`.
    Episode end
        Terminated by a collision, by the vehicle's middle leaving the road, or by driving against its direction;
        truncated after ``duration``.
    Configuration, besides highway-env's keys
        ``simulation_frequency`` 20 Hz; ``lane_width`` [m]: 3.25 in towns, 4 is easy, 3 hard for cars 2 m wide;
        ``duration`` [s]; ``progress_reward``, ``centring_reward``, ``collision_reward``: weights of the terms.
    """

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """Defaults of all keys."""
        config: dict[str, Any] = super().default_config()
        return config | {
            "simulation_frequency": 20,
            "policy_frequency": 5,
            "action": dict(CONTINUOUS),
            "neighbour_vehicles_connected_lanes": True,
            "lane_width": 3.25,
            "duration": 60.0,
            "offroad_terminal": True,
            "progress_reward": 0.6,
            "centring_reward": 0.4,
            "collision_reward": -1.0,
            "screen_width": 600,
            "screen_height": 600,
            "centering_position": [0.5, 0.5],
        }

    @property
    def sections(self) -> tuple[Section, ...]:
        """What lines the road, where the world itself says so: edge from, edge to, start, end [m], kind of section."""
        return ()

    def _network(self) -> StreetNetwork:
        """The road network."""
        raise NotImplementedError

    def _populate(self) -> None:
        """Place the ego and the others."""
        raise NotImplementedError

    def _reset(self) -> None:
        self.road = StreetRoad(
            network=self._network(),
            np_random=self.np_random,
            record_history=self.config["show_trajectories"],
            neighbour_vehicles_connected_lanes=self.config["neighbour_vehicles_connected_lanes"],
        )
        self._populate()

    def _place_ego(self, index: LaneIndex, longitudinal_m: float, speed_mps: float) -> None:
        """The ego, in the middle of a lane; one that takes meta-actions tracks the nearest of its target speeds."""
        lane = self.road.network.get_lane(index)
        vehicle = self.action_type.vehicle_class(
            self.road, lane.position(longitudinal_m, 0.0), heading=lane.heading_at(longitudinal_m), speed=speed_mps
        )
        self.controlled_vehicles = [vehicle]
        self.road.vehicles.append(vehicle)

    def _along(self) -> tuple[float, float, float]:
        """Distance along the ego's lane [m], to the right of it [m], and angle to it [rad]."""
        lane = self.vehicle.lane
        s, r = lane.local_coordinates(self.vehicle.position)
        return s, r, float(wrap_to_pi(self.vehicle.heading - lane.heading_at(s)))

    def _reward(self, action: Any) -> float:
        """Weighted sum of the terms, brought to [0, 1]."""
        weights = {name: self.config[f"{name}_reward"] for name in ("progress", "centring", "collision")}
        terms = self._rewards(action)
        total = sum(weights[name] * terms[f"{name}_reward"] for name in weights)
        best = weights["progress"] + weights["centring"]
        return float(np.clip(lmap(total, [weights["collision"], best], [0.0, 1.0]), 0.0, 1.0))

    def _rewards(self, action: Any) -> dict[str, float]:
        """Terms in [0, 1]: speed along the lane over its limit, nearness to its middle while moving, and a collision.

        Neither reversing nor spinning counts as progress, and a vehicle at rest is not rewarded for its place.
        """
        _, lateral, angle = self._along()
        lane, vehicle = self.vehicle.lane, self.vehicle
        progress = min(max(vehicle.speed * cos(angle) / lane.speed_limit, 0.0), 1.0)
        nearness = max(1.0 - (2.0 * lateral / lane.width) ** 2, 0.0)
        return {
            "progress_reward": progress,
            "centring_reward": nearness * min(4.0 * progress, 1.0),
            "collision_reward": float(vehicle.crashed),
        }

    def _is_terminated(self) -> bool:
        """A collision, the vehicle's middle off the road, or driving against its direction."""
        off_road = self.config["offroad_terminal"] and not self.vehicle.on_road
        return bool(self.vehicle.crashed or off_road or abs(self._along()[2]) > 0.5 * pi)

    def _is_truncated(self) -> bool:
        """Time is up; half a step of it is left to rounding."""
        return bool(self.time >= self.config["duration"] - 0.5 / self.config["policy_frequency"])
