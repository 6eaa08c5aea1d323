"""Tracks, compiled: which vehicles the ego's sensor sees past the others, what it measures, and where they are now.

A track is what one source knows of one vehicle: a row of seven columns of an array with a row for each slot. This file
calls no kernel of another one: Numba's cache would not notice a change there.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit

__all__ = ["AGE", "HEADING", "N_COLUMNS", "PL_AT", "PL_CT", "SPEED", "XY", "bring_forward", "in_sight", "measure"]

Array = NDArray[np.float64]
XY = slice(0, 2)
HEADING, SPEED, PL_AT, PL_CT, AGE = range(2, 7)
N_COLUMNS = 7
ROUNDING_S = 1e-9
RANGE_M, HALF_VIEW_RAD, SIGMA_R_M, SIGMA_B_RAD, SIGMA_V_MPS, SIGMA_H_RAD, BOUND_SIGMAS = range(7)


@jit
def in_sight(i: int, me: int, position_m: Array, ahead: Array, length_m: Array, width_m: Array) -> bool:
    """Whether the line from the middle of vehicle ``me`` to that of vehicle ``i`` crosses no third vehicle.

    Exact: a line and a rectangle are apart when their shadows on an axis of the rectangle, or on the normal of the
    line, are. ``ahead`` (V, 2) are the unit vectors of the headings.
    """
    x, y = position_m[me, 0], position_m[me, 1]
    line_x, line_y = position_m[i, 0] - x, position_m[i, 1] - y
    for j in range(position_m.shape[0]):
        if j in (i, me):
            continue
        start_x, start_y = x - position_m[j, 0], y - position_m[j, 1]
        cos, sin = ahead[j, 0], ahead[j, 1]
        along, across = cos * line_x + sin * line_y, cos * line_y - sin * line_x
        if abs(2.0 * (cos * start_x + sin * start_y) + along) > abs(along) + length_m[j]:
            continue
        if abs(2.0 * (cos * start_y - sin * start_x) + across) > abs(across) + width_m[j]:
            continue
        twist = 2.0 * (start_x * line_y - start_y * line_x)
        if abs(twist) <= abs(across) * length_m[j] + abs(along) * width_m[j]:
            return False
    return True


@jit
def measure(
    figures: Array,
    ego: Array,
    me: int,
    slot: NDArray[np.int64],
    position_m: Array,
    heading_rad: Array,
    speed_mps: Array,
    length_m: Array,
    width_m: Array,
    noise: Array,
    tracks: Array,
) -> None:
    """Renew the rows of ``tracks`` (C, 7) of the vehicles seen: placed on the ego's believed pose, at age 0.

    Along and across the measured heading, which the line of sight leaves by psi, the errors of distance (sigma_r) and
    bearing (sigma_b) give ``sigma_at^2 = (sigma_r cos psi)^2 + (r sigma_b sin psi)^2``, and sigma_ct with cos and sin
    exchanged. The ego's error of its own speed enters by the cosine of the angle between the headings.

    Parameters
    ----------
    figures : (7,) range, half the view, sigma_r, sigma_b, sigmas of speed and heading, sigmas in a bound
    ego : (4,) believed x, y, heading and speed
    me, slot, position_m, heading_rad, speed_mps, length_m, width_m : row of the ego in V vehicles, and these
    noise : (C, 4) standard normal
    """
    ahead = np.empty((slot.size, 2))
    for i in range(slot.size):
        ahead[i, 0], ahead[i, 1] = math.cos(heading_rad[i]), math.sin(heading_rad[i])
    for i in range(slot.size):
        gap_x, gap_y = position_m[i, 0] - position_m[me, 0], position_m[i, 1] - position_m[me, 1]
        distance = math.sqrt(gap_x * gap_x + gap_y * gap_y)
        bearing = math.atan2(gap_y, gap_x) - heading_rad[me]
        off_axis = abs(bearing - 2.0 * math.pi * round(bearing / (2.0 * math.pi)))
        if i == me or distance > figures[RANGE_M] or off_axis > figures[HALF_VIEW_RAD]:
            continue
        if not in_sight(i, me, position_m, ahead, length_m, width_m):
            continue
        n, track = noise[slot[i]], tracks[slot[i]]
        r = distance + figures[SIGMA_R_M] * n[0]
        line = ego[2] + bearing + figures[SIGMA_B_RAD] * n[1]
        turned = heading_rad[i] - heading_rad[me]
        heading = ego[2] + turned + figures[SIGMA_H_RAD] * n[3]
        cos, sin = math.cos(line - heading), math.sin(line - heading)
        sigma_r, sigma_c = figures[SIGMA_R_M], abs(r) * figures[SIGMA_B_RAD]
        track[0] = ego[0] + r * math.cos(line)
        track[1] = ego[1] + r * math.sin(line)
        track[HEADING] = heading
        track[SPEED] = speed_mps[i] + (ego[3] - speed_mps[me]) * math.cos(turned) + figures[SIGMA_V_MPS] * n[2]
        track[PL_AT] = figures[BOUND_SIGMAS] * math.hypot(sigma_r * cos, sigma_c * sin)
        track[PL_CT] = figures[BOUND_SIGMAS] * math.hypot(sigma_r * sin, sigma_c * cos)
        track[AGE] = 0.0


@jit
def bring_forward(
    told: Array,
    seen: Array,
    drop_after_s: float,
    acceleration_mps2: float,
    lateral_mps2: float,
    course_sin: float,
    ego_m: Array,
    tracks: Array,
    slots: NDArray[np.int64],
    relative: NDArray[np.bool_],
) -> int:
    """The newer of two tracks of each slot, the sensor's if equally old, moved to now, nearest to the ego first.

    Parameters
    ----------
    told, seen : (C, 7) newest broadcasts and measurements, age inf for none
    drop_after_s : a track that is older is left out
    acceleration_mps2, lateral_mps2 : levels grow by half of these times the age squared, along and across
    course_sin : and across by this share of the way made since
    ego_m : (2,) where the ego believes to be
    tracks, slots, relative : (C, 7), (C,), (C,) filled with the tracks, whose they are, and whether the sensor's

    Returns
    -------
    int
        How many tracks there are.
    """
    count = 0
    square = np.empty(told.shape[0])
    for slot in range(told.shape[0]):
        sensed = seen[slot, AGE] <= told[slot, AGE] + ROUNDING_S
        source = seen[slot] if sensed else told[slot]
        age = source[AGE]
        if not age <= drop_after_s + ROUNDING_S:
            continue
        x = source[0] + source[SPEED] * age * math.cos(source[HEADING])
        y = source[1] + source[SPEED] * age * math.sin(source[HEADING])
        distance2 = (x - ego_m[0]) ** 2 + (y - ego_m[1]) ** 2
        at = count
        while at > 0 and square[at - 1] > distance2:
            square[at], slots[at], relative[at] = square[at - 1], slots[at - 1], relative[at - 1]
            tracks[at] = tracks[at - 1]
            at -= 1
        square[at], slots[at], relative[at] = distance2, slot, sensed
        tracks[at] = source
        tracks[at, 0], tracks[at, 1] = x, y
        tracks[at, PL_AT] += 0.5 * acceleration_mps2 * age * age
        tracks[at, PL_CT] += (0.5 * lateral_mps2 * age + course_sin * abs(source[SPEED])) * age
        count += 1
    return count
