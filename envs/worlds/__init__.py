"""Scenarios in the style of highway-env without estimated states, and the declarations of all worlds."""

from lanebound.envs.worlds.car_following import CarFollowingWorld
from lanebound.envs.worlds.highway import motorway_support
from lanebound.envs.worlds.kinds import (
    Support,
    WorldKind,
    register_world,
    withdraw_world,
    world_kind,
    world_kinds,
)
from lanebound.envs.worlds.lane_keeping import LaneKeepingWorld
from lanebound.envs.worlds.urban_canyon import UrbanCanyonWorld

__all__ = [
    "CarFollowingWorld",
    "LaneKeepingWorld",
    "Support",
    "UrbanCanyonWorld",
    "WorldKind",
    "register_world",
    "withdraw_world",
    "world_kind",
    "world_kinds",
]

for _kind in (
    WorldKind("LaneKeepingWorld", LaneKeepingWorld, LaneKeepingWorld.support),
    WorldKind("CarFollowingWorld", CarFollowingWorld, CarFollowingWorld.support),
    WorldKind("UrbanCanyonWorld", UrbanCanyonWorld, UrbanCanyonWorld.support),
    WorldKind("highway-v0", None, motorway_support),
):
    register_world(_kind)
