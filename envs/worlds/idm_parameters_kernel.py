"""Parameters of the classes of drivers, for highway-env's vehicles and for compiled traffic."""

from __future__ import annotations

import math
from typing import NamedTuple

__all__ = ["ASKS_M", "BESIDE_M", "BRISK", "CALM", "CLEAR_S", "EXIT_M", "GAP_S", "LINE_BRAKE_MPS2", "LINE_M", "LINE_S",
           "REACTION_S", "SLOW_MPS", "START_MPS2", "STAYS", "WANDER_MOST_M", "WANDER_SHAPES", "WANDER_SLOPE",
           "IdmParameters", "idm_parameters"]  # fmt: skip

BESIDE_M = 1.0  # margin beside a lane within which a vehicle counts as a neighbour on it, Road.neighbour_vehicles
STAYS = -math.inf  # timer of lane changes of a driver without any, IDMVehicle.enable_lane_change


class IdmParameters(NamedTuple):
    """Parameters of a class of drivers.

    gap_m: wanted at standstill, middle to middle; headway_s: time gap; comfort, deceleration: comfortable acceleration
    a and deceleration b [m/s2]; twice_root: ``2 sqrt(a b)`` [m/s2]; delay_s: time between decisions on lane changes;
    gain: least advantage of a lane change [m/s2].
    """

    gap_m: float
    headway_s: float
    comfort: float
    deceleration: float
    twice_root: float
    delay_s: float
    gain: float


def idm_parameters(
    gap_m: float, headway_s: float, comfort: float, deceleration: float, delay_s: float, gain: float
) -> IdmParameters:
    """Parameters with ``2 sqrt(a b)``."""
    root = 2.0 * math.sqrt(comfort * deceleration)
    return IdmParameters(gap_m, headway_s, comfort, deceleration, root, delay_s, gain)


CALM = idm_parameters(gap_m=8.0, headway_s=1.0, comfort=1.5, deceleration=2.0, delay_s=2.0, gain=0.4)
"""Of city drivers. The time gap is that of M. Treiber and A. Kesting, Traffic Flow Dynamics, 2013, table 11.2, for city
traffic, with somewhat higher accelerations. The distance is from middle to middle of cars 5 m long; cars that brake to
a stop come about 2 m nearer."""
BRISK = idm_parameters(gap_m=10.0, headway_s=1.5, comfort=3.0, deceleration=5.0, delay_s=1.0, gain=0.2)
"""Of IDMVehicle of highway-env, whose class constants are compared with these when an engine is made."""
REACTION_S = 0.8  # of city drivers before bends
WANDER_MOST_M = 0.5  # largest offset of a driver's line from the middle of its lane; chosen
WANDER_SHAPES = 7  # of a line over time: an offset, and a cosine and a sine of three frequencies
WANDER_SLOPE = 0.02  # change of that offset per way of the car at most, so that a standing car stays; chosen

# Of drivers at a crossing without lights.
START_MPS2 = 2.0  # of drivers at a crossing at most; ITE: 1.5 to 2.5 from rest
LINE_BRAKE_MPS2 = 2.0  # with which they stop before it; comfortable
LINE_M = 1.0  # from the crossing to where they wait
LINE_S = 0.25  # in which they take the speed for the stop; short, so that they stop within 0.2 m of it
EXIT_M = 8.0  # of the exit that a driver must leave before another one turns into it; a car and a gap of 3 m
ASKS_M = 30.0  # before the crossing, where permission is given; a driver stops from 10 m/s in 25 m
GAP_S = 1.0  # between a driver that leaves a conflict and one of higher priority that reaches the crossing; chosen
CLEAR_S = 0.7  # between two drivers at one place inside; chosen
SLOW_MPS = 2.0  # below this a driver waits for an ego inside the crossing; faster ones insist on their right of way
