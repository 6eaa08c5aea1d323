"""Worlds of our own: plain highway-env scenarios that know nothing of belief."""

from lanebound.envs.worlds.car_following import CarFollowingWorld
from lanebound.envs.worlds.lane_keeping import LaneKeepingWorld
from lanebound.envs.worlds.urban_canyon import UrbanCanyonWorld

__all__ = ["CarFollowingWorld", "LaneKeepingWorld", "UrbanCanyonWorld"]
