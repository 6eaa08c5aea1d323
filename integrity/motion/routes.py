"""Motion of a vehicle along streets of a map, within speed limits, bends and comfortable accelerations."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lanebound.integrity.motion.drive import DriveConfig, curve_limits
from lanebound.integrity.sky.journeys.streets import TURN_M, EdgeStations, lane_line
from lanebound.integrity.sky.maps.graph import StreetEdge
from lanebound.integrity.sky.maps.lines import arcs_of, part_of
from lanebound.integrity.sky.road import Road

__all__ = ["STATION_M", "Leg", "RouteMotion", "route_road", "speed_profile"]

Array = NDArray[np.float64]

CLEAR_M = 1.0  # between points of a lane
STATION_M = 8.0  # of the true sky along routes; of the sky of environments 5 m


class Leg(NamedTuple):
    """A way to be driven: edges in order, and the shares of the first and the last one where it begins and ends."""

    edges: tuple[int, ...]
    begin: float
    end: float


class RouteMotion(NamedTuple):
    """The motion of a vehicle, by epoch (K + 1,), from standing to standing; ``row`` of the stations of the mask.

    starts_m (n + 1,): where along the way its edges begin, in the middles of junctions, and where the last one ends.
    """

    length_m: float
    starts_m: Array
    arc_m: Array
    place_en_m: Array
    heading_rad: Array
    speed_mps: Array
    row: NDArray[np.int64]

    @classmethod
    def of(
        cls, edges: Sequence[StreetEdge], leg: Leg, stations: EdgeStations, rows: NDArray[np.int64],
        drive: DriveConfig, dt_s: float,
    ) -> RouteMotion:  # fmt: skip
        """The motion along edges."""
        parts = _lane_parts(edges, leg)
        road = Road.through(np.concatenate(parts), corner_radius_m=np.inf)
        near = cKDTree(stations.place_en_m[rows])
        limit = stations.speed_mps[rows][near.query(road.vertices_en_m)[1]]
        speed = speed_profile(road, limit, drive)
        step = np.diff(road.arc_at_m)
        time_s = np.concatenate([[0.0], np.cumsum(2.0 * step / (speed[:-1] + speed[1:]))])
        at = np.minimum(dt_s * np.arange(int(np.ceil(time_s[-1] / dt_s)) + 1), time_s[-1])
        k = np.clip(np.searchsorted(time_s, at, side="right") - 1, 0, step.size - 1)
        v = np.interp(at, time_s, speed)
        arc = np.minimum(road.arc_at_m[k] + 0.5 * (speed[k] + v) * (at - time_s[k]), road.length_m)
        place, heading = road.pose_at(arc)
        return cls(road.length_m, _starts_m(road, parts), arc, place, heading, v, rows[near.query(place)[1]])


def _starts_m(road: Road, parts: Sequence[Array]) -> Array:
    """Arcs (n + 1,) of the middles of the chords between parts of a line, one after another, and of both ends."""
    starts, at = [0.0], 0.0
    for before, after in pairwise(parts):
        middle = 0.5 * (before[-1] + after[0])
        ahead = np.linalg.norm(np.diff(before, axis=0), axis=1).sum() + np.linalg.norm(after[0] - before[-1])
        inside = np.flatnonzero((road.arc_at_m > at) & (road.arc_at_m <= at + 1.5 * ahead + 2.0))
        away = np.linalg.norm(road.vertices_en_m[inside] - middle, axis=-1)
        at = float(road.arc_at_m[inside[np.argmin(away)]])
        starts.append(at)
    return np.array([*starts, road.length_m])


def route_road(edges: Sequence[StreetEdge], leg: Leg) -> Road:
    """The rightmost lanes of edges in order, with chords across the junctions, whose corners are rounded."""
    return Road.through(np.concatenate(_lane_parts(edges, leg)), corner_radius_m=np.inf)


def _lane_parts(edges: Sequence[StreetEdge], leg: Leg) -> list[Array]:
    """The rightmost lanes of edges in order; across the junctions lie chords.  (n, 2) [m] each."""
    parts = []
    for k, edge in enumerate(edges):
        line = lane_line(edge)
        length = float(arcs_of(line)[-1])
        corner = min(TURN_M, 0.3 * length)
        begin = leg.begin * length if k == 0 else corner
        end = leg.end * length if k == len(edges) - 1 else length - corner
        parts.append(part_of(line, begin, max(end, begin + CLEAR_M), CLEAR_M))
    return parts


def speed_profile(road: Road, limit_mps: Array, drive: DriveConfig) -> Array:
    """Speeds at the vertices of a road within limits, bends and accelerations, from standing to standing."""
    step, legal = np.diff(road.arc_at_m), limit_mps.copy()
    legal[0] = legal[-1] = 0.0
    speed = curve_limits(road, legal, drive)
    for k in range(step.size):
        speed[k + 1] = min(speed[k + 1], np.sqrt(speed[k] ** 2 + 2.0 * drive.acceleration_mps2 * step[k]))
    return speed
