"""The sky over each environment, at its own hour and time, and the satellites that a map predicts ahead of an ego."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.lanes_kernel import local
from lanebound.envs.batch.motion_kernel import Whereabouts
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import TWO_PI
from lanebound.integrity.sky.mask_kernel import bin_of

__all__ = ["Forecast", "HourTable", "SkyAhead", "SkyRows", "fill_sky", "predict"]

BELOW_RAD = -0.5 * math.pi  # elevation of satellites below the horizon, whose directions are not used
NO_LANE = -1.0  # number of satellites where there is no lane


class HourTable(NamedTuple):
    """Vectors to S satellites (H, K, S, 3) [m], and their rates [m/s], at K knots of H hours.

    start (H,): GPS time at which each hour begins [s]; step between knots [s]; mask: least elevation [rad].
    """

    offset: NDArray[np.float64]
    rate: NDArray[np.float64]
    start: NDArray[np.float64]
    step: float
    mask: float


class SkyRows(NamedTuple):
    """The sky of each environment: los (N, S, 3), elevation, azimuth and above (N, S)."""

    los: NDArray[np.float64]
    elevation: NDArray[np.float64]
    azimuth: NDArray[np.float64]
    above: NDArray[np.bool_]


class Forecast(NamedTuple):
    """What a map of the city says: free (stations, lanes, cells), and how many bins of azimuth and elevation.

    distances (D,): how far ahead satellites are predicted; spacing: between stations [m].
    """

    free: NDArray[np.bool_]
    distances: NDArray[np.float64]
    spacing: float
    azimuths: int
    elevations: int


class SkyAhead(NamedTuple):
    """What satellites ahead are predicted from: where the environments are, what the map says, and the sky now."""

    where: Whereabouts
    forecast: Forecast
    sky: SkyRows


@jit(borrows=True)
def fill_sky(table, hour, clock, e, sky):  # type: ignore[no-untyped-def]
    """The satellites of an environment ``clock`` [s] after the beginning of its hour, cubic Hermite between knots.

    As :func:`~lanebound.integrity.sky.track_kernel.sky_at`.
    """
    begin, step = table.start[hour], table.step
    place = (begin + clock - begin) / step  # rounded as by SkyTrack.at
    knot = min(max(int(place), 0), table.offset.shape[1] - 2)
    share = place - knot
    a1 = share * share * (3.0 - 2.0 * share)
    a0 = 1.0 - a1
    b0, b1 = step * share * (1.0 - share) * (1.0 - share), step * share * share * (share - 1.0)
    for s in range(sky.elevation.shape[1]):
        square = 0.0
        for i in range(3):
            x = a0 * table.offset[hour, knot, s, i] + a1 * table.offset[hour, knot + 1, s, i]
            x += b0 * table.rate[hour, knot, s, i] + b1 * table.rate[hour, knot + 1, s, i]
            sky.los[e, s, i] = x
            square += x * x
        distance = math.sqrt(square)
        for i in range(3):
            sky.los[e, s, i] /= distance
        sky.elevation[e, s], sky.azimuth[e, s], sky.above[e, s] = BELOW_RAD, 0.0, False
        if sky.los[e, s, 2] >= 0.0:
            sky.elevation[e, s] = math.asin(min(1.0, sky.los[e, s, 2]))
            turn = math.atan2(sky.los[e, s, 0], sky.los[e, s, 1])
            sky.azimuth[e, s] = turn if turn >= 0.0 else turn + TWO_PI
            sky.above[e, s] = sky.elevation[e, s] > table.mask


@jit(borrows=True)
def predict(b, lanes, routes, ahead, e, cells, out):  # type: ignore[no-untyped-def]
    """Fill out (3 D,): satellites in line of sight at distances ahead, on the lanes left, own and right, -1 for none.

    The neighbours are those of the lane that the route takes at that distance, at the same share of its length. cells
    (2, 3 D) is scratch: station and lane of each place.
    """
    where, forecast, sky = ahead
    _places_ahead(b, lanes, routes, where, forecast, e, cells, out)
    for s in range(sky.azimuth.shape[1]):
        if not sky.above[e, s]:
            continue
        cell = bin_of(sky.azimuth[e, s], sky.elevation[e, s], forecast.azimuths, forecast.elevations)
        if cell < 0:
            continue
        for n in range(out.shape[0]):
            if out[n] >= 0.0 and forecast.free[cells[0, n], cells[1, n], cell]:
                out[n] += 1.0


@jit(borrows=True)
def _places_ahead(b, lanes, routes, where, forecast, e, cells, out):  # type: ignore[no-untyped-def]
    """Station and lane of the places for which satellites are predicted; out is 0 where there is a lane, else -1."""
    path = routes.paths[b.path]
    here, _, _ = local(lanes, b.lane, b.x_m, b.y_m)
    for d in range(forecast.distances.shape[0]):
        at, place = path.ahead_first, here + forecast.distances[d]
        own = lanes.table[routes.ahead[at]]
        while place > own.length_m:
            at += 1
            if at == path.ahead_last:
                place = own.length_m
                break
            place -= own.length_m
            own = lanes.table[routes.ahead[at]]
        for side in range(3):
            n = 3 * d + side
            there = 0 <= own.side + side - 1 < own.count
            row = own.road + own.side + (side - 1 if there else 0)
            lane = lanes.table[row]
            out[n] = 0.0 if there else NO_LANE
            s = place / own.length_m * lane.length_m
            arc = where.city[e] + where.begin[row] + min(max(s, 0.0), where.reach[row])
            cells[0, n] = int(min(max(arc / forecast.spacing, 0.0), forecast.free.shape[0] - 1.0) + 0.5)
            cells[1, n] = min(lane.side, forecast.free.shape[1] - 1)
