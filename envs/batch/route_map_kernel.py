"""The line that an ego is to follow from each lane: points ahead of it, and where other vehicles are beside it.

Stations are longitudinal coordinates of the ego's lane, continued over the lanes before and after it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.lanes_kernel import centre
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record

__all__ = ["PATH", "PIECE", "RouteMap", "path_at", "project"]

PROJECTIONS = 6
NEAR_CURVED_M, NEAR_STRAIGHT_M = 0.1, 1.0  # last step of a projection: the offset is then wrong by step^2 / 2R

PATH = record(
    lane_share="number of the lane over that of the road's last lane, 0 for a single lane",
    left_exists="1 when a lane that may be entered lies to the left",
    right_exists="1 when a lane that may be entered lies to the right",
    speed_limit_mps="of the lane, inf for none",
    junction_m="station where the lane ends",
    lane_end_m="station where no lane goes on from the last one, inf beyond what was looked up",
    start_m="station where the known map begins",
    end_m="station where the known map ends",
    first=("i8", "first row of the pieces"),
    last=("i8", "last row of the pieces"),
    following_first=("i8", "first row of the lanes that the path follows"),
    following_last=("i8", "row after the last of them"),
    ahead_first=("i8", "first row of the lanes by which the sky ahead is predicted"),
    ahead_last=("i8", "row after the last of them"),
)
PIECE = record(
    end_m="station where the piece ends",
    origin_m="station of the first point of its lane",
    lane=("i8", "row of the lane"),
)


class RouteMap(NamedTuple):
    """Paths over a road network: paths (P,) PATH; pieces (Q,) PIECE; following (F,), ahead (A,): rows of lanes."""

    paths: Records
    pieces: Records
    following: NDArray[np.int64]
    ahead: NDArray[np.int64]


@jit(borrows=True)
def path_at(routes, lanes, p, station):  # type: ignore[no-untyped-def]
    """Point, direction and curvature at a station of a path, straight on past both ends: (x, y, heading, curvature)."""
    path = routes.paths[p]
    k, beyond = path.first, 0.0
    if station < path.start_m:
        at, beyond = 0.0, station - path.start_m
    else:
        while k < path.last and not station < routes.pieces[k].end_m:
            k += 1
        piece = routes.pieces[k]
        at = station - piece.origin_m
        if not station < piece.end_m:
            at, beyond = lanes.table[piece.lane].length_m, station - piece.end_m
    x, y, heading, curvature = centre(lanes, routes.pieces[k].lane, at)
    if beyond == 0.0 and station < path.end_m:
        return x, y, heading, curvature
    return x + beyond * math.cos(heading), y + beyond * math.sin(heading), heading, 0.0


@jit(borrows=True)
def project(routes, lanes, p, x, y, guess):  # type: ignore[no-untyped-def]
    """Station and offset to the right of a point, found from a guess by Newton's steps: (s, r, whether it is beside).

    A step ``along / (1 - curvature offset)`` leaves an error of second order, so the last one is taken unchecked.
    """
    station = guess
    for _ in range(PROJECTIONS):
        px, py, heading, curvature = path_at(routes, lanes, p, station)
        dx, dy, cosine, sine = x - px, y - py, math.cos(heading), math.sin(heading)
        along, offset = dx * cosine + dy * sine, dy * cosine - dx * sine
        station += along / max(1.0 - curvature * offset, 0.5)
        near = NEAR_CURVED_M if curvature != 0.0 else NEAR_STRAIGHT_M
        if -near < along < near:
            return station, offset, True
    return 0.0, 0.0, False
