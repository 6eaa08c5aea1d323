"""Where the goal of a world of highway-env is, and whether its ego has reached it.

Worlds without a goal, on which a car can drive on and on, have no entry: there way and time alone make a success.
"""

from __future__ import annotations

from highway_env.envs.common.abstract import AbstractEnv

__all__ = ["has_crossed", "has_left_roundabout", "has_merged"]

BEYOND_CIRCLE_M = 10.0  # on the straight of the exit; chosen


def has_crossed(world: AbstractEnv) -> bool:
    """Whether the ego is 25 m beyond the crossing, on the exit to its destination; on any exit without a destination.

    highway-env's own rule (``IntersectionEnv.has_arrived``) takes any exit.
    """
    destination = world.config["destination"] or _end_of_route(world)
    return bool(world.has_arrived(world.vehicle)) and destination in (None, world.vehicle.lane_index[1])


def _end_of_route(world: AbstractEnv) -> str | None:
    route = getattr(world.vehicle, "route", None)
    return route[-1][1] if route else None


def has_merged(world: AbstractEnv) -> bool:
    """Whether the ego is past the slip road, where highway-env ends the episode, on a lane that goes on from there."""
    return bool(world._is_terminated()) and not world.vehicle.crashed and world.vehicle.lane_index[:2] == ("c", "d")


def has_left_roundabout(world: AbstractEnv) -> bool:
    """Whether the ego is on the straight of the north exit."""
    vehicle = world.vehicle
    along = vehicle.lane.local_coordinates(vehicle.position)[0]
    return vehicle.lane_index[:2] == ("nxs", "nxr") and bool(along >= BEYOND_CIRCLE_M)
