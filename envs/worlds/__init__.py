"""Worlds of our own: plain highway-env scenarios that know nothing of belief."""

from highway_env.envs.common.abstract import AbstractEnv

from lanebound.envs.worlds.car_following import CarFollowingWorld
from lanebound.envs.worlds.lane_keeping import LaneKeepingWorld
from lanebound.envs.worlds.urban_canyon import UrbanCanyonWorld

__all__ = ["OWN_WORLDS", "CarFollowingWorld", "LaneKeepingWorld", "UrbanCanyonWorld"]

OWN_WORLDS: dict[str, type[AbstractEnv]] = {
    kind.__name__: kind for kind in (LaneKeepingWorld, CarFollowingWorld, UrbanCanyonWorld)
}
