"""Stations along the rightmost lanes of the streets of a map, and the sky that a city leaves there (S2 section 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import require_in_range
from lanebound.integrity.sky.constellation import SkyConfig
from lanebound.integrity.sky.forecast import SkyForecast
from lanebound.integrity.sky.maps.graph import StreetEdge, StreetGraph
from lanebound.integrity.sky.maps.lines import arcs_of, points_at
from lanebound.integrity.sky.prediction import StreetPrediction, predict_street
from lanebound.integrity.sky.scene import City
from lanebound.integrity.sky.view import SkyView

__all__ = [
    "ANTENNA_HEIGHT_M",
    "AZIMUTH_STEP_DEG",
    "ELEVATION_STEP_DEG",
    "EdgeStations",
    "SkyAlong",
    "at_hour",
    "lane_line",
]

Array = NDArray[np.float64]

ANTENNA_HEIGHT_M = 1.5
HOUR_S, DAY_S = 3600.0, 86_400.0
ACCELERATION_MPS2, BRAKING_MPS2, LATERAL_MPS2 = 1.5, 2.0, 2.0  # comfortable ones, as of scripted drives
TURN_M = 10.0  # of both streets, over which a vehicle turns; chosen, kerbs of 12 m and half a street
LANE_WIDTH_M = 3.25  # where the map says nothing, as of worlds
SPACING_M = 10.0  # of stations: 1 Hz at 36 km/h; S2 asks for 2 to 10 Hz, and a station nearer than 10 m differs little
AZIMUTH_STEP_DEG, ELEVATION_STEP_DEG = 4.0, 3.0  # as in the environments


def at_hour(sky: SkyConfig, hour: float) -> SkyConfig:
    """The satellites at an hour of the day of a configuration, in GPS time: UTC to within some seconds.

    Raises
    ------
    InputError
        The hour is not in [0, 24).
    """
    require_in_range("hour", hour, 0.0, 24.0, high_open=True)
    return sky.replace(week_second_s=sky.week_second_s // DAY_S * DAY_S + HOUR_S * hour)


def lane_line(edge: StreetEdge) -> Array:
    """The middle of the rightmost lane along an edge, (n, 2) [m]: of a street in a canyon the one that sees least."""
    width = edge.way.lane_width_m or LANE_WIDTH_M
    right_m = edge.right_of_middle_m(0, width)
    side = np.diff(edge.points_en_m, axis=0)
    ahead = side / np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)
    at = np.concatenate([ahead[:1], ahead[:-1] + ahead[1:], ahead[-1:]])
    at /= np.maximum(np.linalg.norm(at, axis=1, keepdims=True), 1e-9)
    return np.asarray(edge.points_en_m + right_m * np.stack([at[:, 1], -at[:, 0]], -1))


def turn_s(before: StreetEdge, after: StreetEdge) -> float:
    """Time that a turn from one street into another costs [s]: braking to the speed of the bend, and acceleration.

    The bend is a chord from 10 m before the junction to 10 m after it, with an arc at each end.
    """
    a, b = before.points_en_m[-1] - before.points_en_m[-2], after.points_en_m[1] - after.points_en_m[0]
    turn = abs(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b))
    radius_m = TURN_M * np.cos(0.5 * turn) / max(np.tan(0.25 * turn), 1e-9)
    bend_mps = np.sqrt(LATERAL_MPS2 * radius_m)
    return sum(
        max(limit - float(bend_mps), 0.0) ** 2 / (2.0 * rate * limit)
        for limit, rate in (
            (before.way.speed_limit_mps, BRAKING_MPS2),
            (after.way.speed_limit_mps, ACCELERATION_MPS2),
        )
    )


@dataclass(frozen=True)
class EdgeStations:
    """Stations of E edges, each for an equal part of its edge.

    Attributes
    ----------
    place_en_m : (N, 2) in the rightmost lane
    first : (E + 1,) number of the first station of each edge, and N
    part_m : (N,) length of the part of the street
    speed_mps : (N,) speed limit
    covered : (N,) whether the street has a roof there
    """

    place_en_m: Array
    first: NDArray[np.int64]
    part_m: Array
    speed_mps: Array
    covered: NDArray[np.bool_]

    @classmethod
    def along(cls, edges: Sequence[StreetEdge], spacing_m: float = SPACING_M) -> Self:
        """Stations in the middles of parts of at most ``spacing_m``."""
        counts = np.array([max(1, int(np.ceil(edge.length_m / spacing_m))) for edge in edges], dtype=np.int64)
        places = [np.zeros((0, 2))]
        for edge, count in zip(edges, counts, strict=True):
            line = lane_line(edge)
            places.append(points_at(line, arcs_of(line)[-1] * (np.arange(count) + 0.5) / count))
        return cls(
            np.concatenate(places),
            np.concatenate([[0], np.cumsum(counts)]),
            np.repeat([edge.length_m for edge in edges] / counts, counts),
            np.repeat([edge.way.speed_limit_mps for edge in edges], counts),
            np.repeat([edge.way.covered for edge in edges], counts),
        )

    def of(self, edge: int) -> slice:
        """The stations of an edge."""
        return slice(int(self.first[edge]), int(self.first[edge + 1]))

    def rows(self, edge: int, begin: float, end: float) -> NDArray[np.int64]:
        """Stations of a part of an edge, between two shares of it."""
        own = self.of(edge)
        count = own.stop - own.start
        middle = (np.arange(count) + 0.5) / count
        return np.asarray(own.start + np.flatnonzero((middle >= begin) & (middle <= end)))

    def of_way(
        self, graph: StreetGraph, edges: Sequence[int], begin: float = 0.0, end: float = 1.0
    ) -> tuple[NDArray[np.int64], Array]:
        """Stations of a way in order of travel, and the time at each with that of starting, turning and stopping.

        begin, end : shares of the first edge where it begins and of the last one where it ends.  -> (n,), (n,) [s]
        """
        parts = [(begin if i == 0 else 0.0, end if i == len(edges) - 1 else 1.0) for i in range(len(edges))]
        found = [self.rows(k, *part) for k, part in zip(edges, parts, strict=True)]
        rows = np.concatenate(found)
        time_s = self.part_s[rows]
        at = np.cumsum([own.size for own in found[:-1]])
        for a, b, i in zip(edges, edges[1:], at, strict=False):
            if rows.size:
                time_s[min(int(i), rows.size - 1)] += turn_s(graph.edges[a], graph.edges[b])
        if rows.size:
            time_s[0] += 0.5 * self.speed_mps[rows[0]] / ACCELERATION_MPS2
            time_s[-1] += 0.5 * self.speed_mps[rows[-1]] / BRAKING_MPS2
        return rows, time_s

    @cached_property
    def part_s(self) -> Array:
        """Time in each part at the speed limit, (N,)."""
        return self.part_m / self.speed_mps

    @property
    def antenna_enu_m(self) -> Array:
        """Antennas, (N, 1, 3) [m]."""
        return np.insert(self.place_en_m, 2, ANTENNA_HEIGHT_M, 1)[:, None]


@dataclass(frozen=True)
class SkyAlong:
    """The sky that a city leaves free at stations: the mapped city for a prediction, the true one for an oracle."""

    stations: EdgeStations
    forecast: SkyForecast

    @classmethod
    def of(cls, stations: EdgeStations, city: City) -> Self:
        """Cast rays from all stations; below a roof there is no satellite."""
        antennas = stations.antenna_enu_m
        found = SkyForecast.of_stations(antennas, city, SPACING_M, AZIMUTH_STEP_DEG, ELEVATION_STEP_DEG)
        found.free[stations.covered] = False
        return cls(stations, found)

    def at(self, sky: SkyView) -> StreetPrediction:
        """Satellites in line of sight and PDOP at all stations at one time, that of the first row of ``sky.index``."""
        return predict_street(self.forecast, sky)
