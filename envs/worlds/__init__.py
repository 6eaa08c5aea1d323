"""Worlds of lanebound, plain scenarios of highway-env without navigation, and the declarations of all worlds."""

from lanebound.envs.worlds.goals import has_crossed, has_left_roundabout, has_merged
from lanebound.envs.worlds.guidance import GuidanceWorld, has_taken_exit
from lanebound.envs.worlds.highway import motorway_support
from lanebound.envs.worlds.intersection import intersection_support
from lanebound.envs.worlds.junctions import merge_support, racetrack_support, roundabout_support
from lanebound.envs.worlds.kinds import (
    Support,
    WorldKind,
    register_world,
    withdraw_world,
    world_kind,
    world_kinds,
)
from lanebound.envs.worlds.platoon import PlatoonWorld
from lanebound.envs.worlds.straights import exit_support, turn_support, two_way_support
from lanebound.envs.worlds.streets import CarFollowingWorld, LaneKeepingWorld, UrbanCanyonWorld
from lanebound.envs.worlds.tolling import TollingWorld
from lanebound.envs.worlds.work_zone import WorkZoneWorld

__all__ = [
    "CarFollowingWorld",
    "GuidanceWorld",
    "LaneKeepingWorld",
    "PlatoonWorld",
    "Support",
    "TollingWorld",
    "UrbanCanyonWorld",
    "WorkZoneWorld",
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
    WorldKind("WorkZoneWorld", WorkZoneWorld, WorkZoneWorld.support),
    WorldKind("PlatoonWorld", PlatoonWorld, PlatoonWorld.support),
    WorldKind("GuidanceWorld", GuidanceWorld, GuidanceWorld.support, arrived=has_taken_exit),
    WorldKind("TollingWorld", TollingWorld, TollingWorld.support),
    WorldKind("highway-v0", None, motorway_support),
    WorldKind("highway-fast-v0", None, motorway_support),
    WorldKind("exit-v0", None, exit_support),
    WorldKind("exit-v1", None, exit_support),
    WorldKind("two-way-v0", None, two_way_support),
    WorldKind("u-turn-v0", None, turn_support),
    WorldKind("u-turn-v1", None, turn_support),
    WorldKind("intersection-v0", None, intersection_support, 24, arrived=has_crossed),
    WorldKind("intersection-v1", None, intersection_support, 24, arrived=has_crossed),
    WorldKind("intersection-v2", None, intersection_support, 24, "intersection-v1", arrived=has_crossed),
    WorldKind("racetrack-v0", None, racetrack_support),
    WorldKind("racetrack-v1", None, racetrack_support),
    WorldKind("racetrack-large-v0", None, racetrack_support),
    WorldKind("racetrack-large-v1", None, racetrack_support),
    WorldKind("merge-v0", None, merge_support, arrived=has_merged),
    WorldKind("merge-v1", None, merge_support, arrived=has_merged),
    WorldKind("roundabout-v0", None, roundabout_support, arrived=has_left_roundabout),
    WorldKind("roundabout-v1", None, roundabout_support, arrived=has_left_roundabout),
):
    register_world(_kind)
