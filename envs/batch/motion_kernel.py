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
from lanebound.integrity.motion.truth_kernel import END, between

__all__ = ["MOTION", "Whereabouts", "advance", "begin_motion", "fill_motion", "fill_whereabouts", "follow_motion"]

MOTION = record(
    position=("f8", (2,), "x, y now [m]"),
    heading_rad="now",
    chord=("f8", (2,), "of the last step [m]"),
    chord_before=("f8", (2,), "of the step before [m]"),
    start=("f8", (2,), "x, y at the beginning of the epoch [m]"),
    start_velocity=("f8", (2,), "there [m/s]"),
    start_heading_rad="there",
)


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


@jit
def _end(m, step_s, start, end):  # type: ignore[no-untyped-def]
    """End an epoch of a vehicle (MOTION): where it has begun and where it ends (END); the next one begins."""
    for k in range(2):
        sign = 1.0 if k == 0 else -1.0  # from y, to the right, to North
        now = (1.5 * m.chord[k] - 0.5 * m.chord_before[k]) / step_s
        start.position[k], end.position[k] = sign * m.start[k], sign * m.position[k]
        start.velocity[k], end.velocity[k] = sign * m.start_velocity[k], sign * now
        m.start[k], m.start_velocity[k] = m.position[k], now
    start.heading, end.heading = m.start_heading_rad + 0.5 * math.pi, m.heading_rad + 0.5 * math.pi
    m.start_heading_rad = m.heading_rad


@jit
def fill_motion(motions, rows, step_s, down, truth):  # type: ignore[no-untyped-def]
    """Fill the motion of a Truth from the beginning of the epoch to now, where the next one begins.

    motions (N, M) MOTION; ``truth`` (N M,) TRUTH, of which the rows of environments ``rows`` are filled; ``down`` [m/s]
    is what gravity adds.
    """
    count, ends = motions.shape[1], np.empty(2, END)
    for e in rows:
        for i in range(count):
            _end(motions[e, i], step_s, ends[0], ends[1])
            between(ends[0], ends[1], down, truth[e * count + i])


@jit(inline=True)
def member_of(cars, v):  # type: ignore[no-untyped-def]
    """Row of vehicle v of an environment among those that navigate, 0 for the ego; -1 for one without a slot."""
    return 0 if v == 0 else cars[v].slot + 1 if cars[v].slot >= 0 else -1


@jit(borrows=True)
def follow_motion(cars, motions):  # type: ignore[no-untyped-def]
    """Take the true poses after a simulation step; motions (M,): of the navigating vehicles of an environment."""
    for v in range(cars.shape[0]):
        i = member_of(cars, v)
        if 0 <= i < motions.shape[0]:
            advance(motions[i], cars[v].x, cars[v].y, cars[v].heading)


@jit(borrows=True)
def fill_whereabouts(cars, lanes, where, e, truth):  # type: ignore[no-untyped-def]
    """Fill arc and lane of the navigating vehicles of environment e, (M,) TRUTH."""
    for v in range(cars.shape[0]):
        i = member_of(cars, v)
        if 0 <= i < truth.shape[0]:
            n = cars[v].lane
            s, _, _ = local(lanes, n, cars[v].x, cars[v].y)
            truth[i].arc = where.city[e] + where.begin[n] + min(max(s, 0.0), where.reach[n])
            truth[i].lane = lanes.table[n].side


@jit(borrows=True)
def begin_motion(  # type: ignore[no-untyped-def]
    rows, cars, lanes, where, step_s, before_s, motions, end, ahead, truth
):
    """Put the navigating vehicles of environments ``rows`` on a straight approach, ``before_s`` before their places.

    Row n of motions (n, M) MOTION, of end and ahead (n, M, 2), filled with the place [m] and the velocity [m/s] of
    each, and the rows n M and up of ``truth``, whose arcs and lanes are those of the places.
    """
    count = motions.shape[1]
    for n in range(rows.shape[0]):
        e = rows[n]
        fill_whereabouts(cars[e], lanes, where, e, truth[n * count : (n + 1) * count])
        for v in range(cars.shape[1]):
            i, car = member_of(cars[e], v), cars[e, v]
            if 0 <= i < count:
                m, cosine, sine = motions[n, i], math.cos(car.heading), math.sin(car.heading)
                end[n, i, 0], end[n, i, 1] = car.x, car.y
                ahead[n, i, 0], ahead[n, i, 1] = car.speed * cosine, car.speed * sine
                m.heading_rad = m.start_heading_rad = car.heading
                for k in range(2):
                    m.position[k] = m.start[k] = end[n, i, k] - before_s * ahead[n, i, k]
                    m.chord[k] = m.chord_before[k] = step_s * car.speed * (cosine if k == 0 else sine)
                    m.start_velocity[k] = (1.5 * m.chord[k] - 0.5 * m.chord_before[k]) / step_s
