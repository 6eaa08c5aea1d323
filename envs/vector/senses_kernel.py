"""The sky and the belief of N egos, each under a sky of its own: of another hour, another city, another time."""

from __future__ import annotations

import math

import numpy as np

from lanebound.envs.vector.columns_kernel import B_LANE, B_X, B_Y, HEADING, LANE, SPEED, X, Y
from lanebound.envs.vector.lanes_kernel import COUNT, LENGTH, ONWARD, SIDE, local
from lanebound.envs.vector.score_kernel import glance
from lanebound.integrity.core.accel import jit
from lanebound.integrity.sky.raytrace_kernel import bin_of

__all__ = ["foresee", "glance_all", "poses_of", "skies_at", "whereabouts"]

TWO_PI = 2.0 * math.pi
BELOW = -0.5 * math.pi  # elevation of satellites below the horizon, whose directions nobody asks for


@jit
def skies_at(  # type: ignore[no-untyped-def]
    first, last, offset, rate, hour, knot, share, step, mask, los, elevation, azimuth, above
):  # fmt: skip
    """Fill los (N, S, 3), elevation, azimuth and above (N, S) of the hours and times of some environments.

    offset, rate (H, K, S, 3): vectors to the satellites and their rates at knots ``step`` [s] apart, cubic Hermite in
    between as :func:`~lanebound.integrity.sky.track_kernel.sky_at`; knot, share (N,): the knot before and how far past.
    """
    for e in range(first, last):
        h, k, u = hour[e], knot[e], share[e]
        a1 = u * u * (3.0 - 2.0 * u)
        a0 = 1.0 - a1
        b0, b1 = step * u * (1.0 - u) * (1.0 - u), step * u * u * (u - 1.0)
        for s in range(offset.shape[2]):
            square = 0.0
            for i in range(3):
                x = a0 * offset[h, k, s, i] + a1 * offset[h, k + 1, s, i]
                x += b0 * rate[h, k, s, i] + b1 * rate[h, k + 1, s, i]
                los[e, s, i] = x
                square += x * x
            distance = math.sqrt(square)
            for i in range(3):
                los[e, s, i] /= distance
            elevation[e, s], azimuth[e, s], above[e, s] = BELOW, 0.0, False
            if los[e, s, 2] >= 0.0:
                elevation[e, s] = math.asin(min(1.0, los[e, s, 2]))
                turn = math.atan2(los[e, s, 0], los[e, s, 1])
                azimuth[e, s] = turn if turn >= 0.0 else turn + TWO_PI
                above[e, s] = elevation[e, s] > mask


@jit
def whereabouts(lanes, rows, cars, whole, begin, reach, city, arc, side):  # type: ignore[no-untyped-def]
    """Where the first M vehicles of ``rows`` (n,) truly are along the stations of all cities.

    Fills arc [m] and side, the lane of its road, both (n, M). begin, reach (L,): arc of the beginning of each lane, and
    up to where it has stations; city (N,): arc of each environment's city.
    """
    for n in range(rows.shape[0]):
        e = rows[n]
        for i in range(arc.shape[1]):
            lane = whole[e, LANE, i]
            s, _, _ = local(lanes, lane, cars[e, X, i], cars[e, Y, i])
            arc[n, i] = city[e] + begin[lane] + min(max(s, 0.0), reach[lane])
            side[n, i] = int(lanes.table[lane, SIDE])


@jit
def poses_of(rows, vehicles, cars, position, heading, speed):  # type: ignore[no-untyped-def]
    """Fill position (n M, 2), heading and speed (n M,): the truth of the first M vehicles of ``rows`` (n,)."""
    for n in range(rows.shape[0]):
        for i in range(vehicles):
            at, e = n * vehicles + i, rows[n]
            position[at, 0], position[at, 1] = cars[e, X, i], cars[e, Y, i]
            heading[at], speed[at] = cars[e, HEADING, i], cars[e, SPEED, i]


@jit
def glance_all(rows, belief, score, cars, figures):  # type: ignore[no-untyped-def]
    """Count a navigation epoch of each environment for those who score."""
    for e in rows:
        glance(belief[e], score[e], cars[e], figures)


@jit
def foresee(  # type: ignore[no-untyped-def]
    first, last, lanes, rows, belief, distances, begin, reach, city, free, spacing, n_az, n_el, azimuth, elevation,
    above, sky,
):  # fmt: skip
    """Fill sky (N, 3 D) of ``rows[first:last]``: satellites that the map promises ``distances`` (D,) ahead.

    On the lanes left, own and right of where the path is then, -1 where there is none, as ``Street`` counts them. free
    (stations, lanes, cells).
    """
    table, stations, wide = lanes.table, free.shape[0], free.shape[1]
    places = 3 * distances.shape[0]
    station, lane_of = np.empty(places, np.int64), np.empty(places, np.int64)
    for e in rows[first:last]:
        here, _, _ = local(lanes, int(belief[e, B_LANE]), belief[e, B_X], belief[e, B_Y])
        for d in range(distances.shape[0]):
            own, place = int(belief[e, B_LANE]), here + distances[d]
            while place > table[own, LENGTH]:
                if table[own, ONWARD] < 0.0:
                    place = table[own, LENGTH]
                    break
                place -= table[own, LENGTH]
                own = int(table[own, ONWARD])
            for side in range(3):
                n, lane = 3 * d + side, own + side - 1
                there = 0 <= int(table[own, SIDE]) + side - 1 < int(table[own, COUNT])
                sky[e, n] = 0.0 if there else -1.0
                lane = lane if there else own
                at = place / table[own, LENGTH] * table[lane, LENGTH]
                arc = city[e] + begin[lane] + min(max(at, 0.0), reach[lane])
                station[n] = int(min(max(arc / spacing, 0.0), stations - 1.0) + 0.5)
                lane_of[n] = min(int(table[lane, SIDE]), wide - 1)
        for s in range(azimuth.shape[1]):
            cell = bin_of(azimuth[e, s], elevation[e, s], n_az, n_el) if above[e, s] else -1
            if cell < 0:
                continue
            for n in range(places):
                if sky[e, n] >= 0.0 and free[station[n], lane_of[n], cell]:
                    sky[e, n] += 1.0
