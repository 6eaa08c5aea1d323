"""True motion of vehicles, from their poses alone: what the instruments of each may feel.

highway-env advances a pose by the velocity at the start of a step (Euler), and its ``velocity`` leaves out the slip
angle. The velocity at the end of a step is therefore taken half way between the steps before and after, the coming one
extrapolated: then the velocities, integrated over time, give the positions back without drift.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.lanes_kernel import local
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record
from lanebound.integrity.motion.truth_kernel import EndRows, TrueMotion, between

__all__ = ["MOTION", "TruthRows", "Whereabouts", "advance", "begin_motion", "fill_motion", "fill_whereabouts"]

MOTION = record(
    position=("f8", (2,), "x, y now [m]"),
    heading_rad="now",
    chord=("f8", (2,), "of the last step [m]"),
    chord_before=("f8", (2,), "of the step before [m]"),
    start=("f8", (2,), "x, y at the beginning of the epoch [m]"),
    start_velocity=("f8", (2,), "there [m/s]"),
    start_heading_rad="there",
)


class TruthRows(NamedTuple):
    """The arrays of a Truth of B vehicles: (B, 3) but for heading, distance, arc and lane (B,)."""

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    heading: NDArray[np.float64]
    turn: NDArray[np.float64]
    delta_v: NDArray[np.float64]
    distance: NDArray[np.float64]
    arc: NDArray[np.float64]
    lane: NDArray[np.int64]


class Whereabouts(NamedTuple):
    """Where lanes lie among the stations of the sky masks.

    begin, reach (L,): arc of the beginning of each lane, and up to where the lane has stations; city (N,): arc of each
    environment's city [m].
    """

    begin: NDArray[np.float64]
    reach: NDArray[np.float64]
    city: NDArray[np.float64]


@jit(inline=True)
def advance(motion, x, y, heading):  # type: ignore[no-untyped-def]
    """Take the pose of one vehicle after a simulation step."""
    motion.chord_before[0], motion.chord_before[1] = motion.chord[0], motion.chord[1]
    motion.chord[0], motion.chord[1] = x - motion.position[0], y - motion.position[1]
    motion.position[0], motion.position[1] = x, y
    motion.heading_rad = heading


@jit(borrows=True)
def _ends_of(motions, step_s, ends, headings):  # type: ignore[no-untyped-def]
    """Positions and velocities East, North (4, M, 2), azimuths (2, M) at both ends of an epoch; the next begins."""
    for i in range(motions.shape[0]):
        m = motions[i]
        for k in range(2):
            sign = 1.0 if k == 0 else -1.0
            now = (1.5 * m.chord[k] - 0.5 * m.chord_before[k]) / step_s
            ends[0, i, k], ends[1, i, k] = sign * m.start[k], sign * m.position[k]
            ends[2, i, k], ends[3, i, k] = sign * m.start_velocity[k], sign * now
            m.start[k], m.start_velocity[k] = m.position[k], now
        headings[0, i], headings[1, i] = m.start_heading_rad + 0.5 * math.pi, m.heading_rad + 0.5 * math.pi
        m.start_heading_rad = m.heading_rad


@jit
def fill_motion(motions, rows, step_s, down, truth):  # type: ignore[no-untyped-def]
    """Fill the motion of a Truth from the beginning of the epoch to now, where the next one begins.

    motions (N, M) MOTION; ``truth`` has N M rows, of which those of environments ``rows`` are filled; ``down`` [m/s] is
    what gravity adds.
    """
    count = motions.shape[1]
    ends, headings = np.empty((4, count, 2)), np.empty((2, count))
    for e in rows:
        _ends_of(motions[e], step_s, ends, headings)
        a, b = e * count, (e + 1) * count
        out = TrueMotion(
            truth.position[a:b], truth.velocity[a:b], truth.heading[a:b], truth.turn[a:b], truth.delta_v[a:b],
            truth.distance[a:b],
        )  # fmt: skip
        between(EndRows(ends[0], ends[2], headings[0]), EndRows(ends[1], ends[3], headings[1]), down, out)


@jit(borrows=True)
def fill_whereabouts(cars, lanes, where, e, first, count, truth):  # type: ignore[no-untyped-def]
    """Fill arc and lane of the ``count`` navigating vehicles of environment e, rows from ``first`` on of a Truth."""
    for v in range(cars.present[e]):
        i = 0 if v == 0 else cars.slot[e, v] + 1
        if (v == 0 or i > 0) and i < count:
            n = cars.lane[e, v]
            s, _, _ = local(lanes, n, cars.x[e, v], cars.y[e, v])
            truth.arc[first + i] = where.city[e] + where.begin[n] + min(max(s, 0.0), where.reach[n])
            truth.lane[first + i] = lanes.table[n].side


@jit(borrows=True)
def begin_motion(first, last, rows, cars, lanes, where, step_s, before_s, motions, end, ahead, truth):  # type: ignore[no-untyped-def]
    """Put the navigating vehicles of environments ``rows`` on a straight approach, ``before_s`` before their places.

    Row n of motions (n, M) MOTION, of end and ahead (n, M, 2), filled with the place [m] and the velocity [m/s] of
    each,
    and the rows n M and up of ``truth``, whose arcs and lanes are those of the places.
    """
    count = motions.shape[1]
    for n in range(first, last):
        e = rows[n]
        fill_whereabouts(cars, lanes, where, e, n * count, count, truth)
        for v in range(cars.present[e]):
            i = 0 if v == 0 else cars.slot[e, v] + 1
            if (v == 0 or i > 0) and i < count:
                m, speed, heading = motions[n, i], cars.speed[e, v], cars.heading[e, v]
                cosine, sine = math.cos(heading), math.sin(heading)
                end[n, i, 0], end[n, i, 1] = cars.x[e, v], cars.y[e, v]
                ahead[n, i, 0], ahead[n, i, 1] = speed * cosine, speed * sine
                m.heading_rad = m.start_heading_rad = heading
                for k in range(2):
                    m.position[k] = m.start[k] = end[n, i, k] - before_s * ahead[n, i, k]
                    m.chord[k] = m.chord_before[k] = step_s * speed * (cosine if k == 0 else sine)
                    m.start_velocity[k] = (1.5 * m.chord[k] - 0.5 * m.chord_before[k]) / step_s
