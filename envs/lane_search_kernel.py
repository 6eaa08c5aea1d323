"""Distances of a pose to many lanes at once, as highway-env defines them."""

from __future__ import annotations

import math

from lanebound.integrity.core.accel import jit

__all__ = ["ANGLE_WEIGHT", "CIRCULAR", "COLUMNS", "STRAIGHT", "WAVY", "nearest"]

# columns of the table of lanes; a circular lane has its centre for the start
KIND, X, Y, UX, UY, HEADING, LENGTH, AMPLITUDE, PULSATION, PHASE, RADIUS, TURN = range(12)
COLUMNS = 12
STRAIGHT, WAVY, CIRCULAR = 0.0, 1.0, 2.0
ANGLE_WEIGHT = 1.0  # [m/rad] of highway-env
CLOSE = 1e-6  # relative to 1 m and the distance: rounding is a thousand times smaller for positions up to 1000 km


@jit
def wrap(angle):  # type: ignore[no-untyped-def]
    """The angle in [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@jit
def distance(lane, x, y, heading):  # type: ignore[no-untyped-def]
    """``|r| + max(s - L, 0) + max(-s, 0) + |angle|``, and whether s does not jump hereabouts (behind a circle's)."""
    dx, dy, steady = x - lane[X], y - lane[Y], True
    if lane[KIND] == CIRCULAR:
        past = wrap(math.atan2(dy, dx) - lane[PHASE])
        steady = abs(past) < math.pi - CLOSE
        s = lane[TURN] * past * lane[RADIUS]
        r = lane[RADIUS] - math.hypot(dx, dy)
        ahead = past + lane[PHASE] + 0.5 * math.pi * lane[TURN]
    else:
        s, r = dx * lane[UX] + dy * lane[UY], dy * lane[UX] - dx * lane[UY]
        ahead = lane[HEADING]
        if lane[KIND] == WAVY:
            phase = lane[PULSATION] * s + lane[PHASE]
            r -= lane[AMPLITUDE] * math.sin(phase)
            ahead += math.atan(lane[AMPLITUDE] * lane[PULSATION] * math.cos(phase))
    beyond = max(s - lane[LENGTH], 0.0) + max(-s, 0.0)
    return abs(r) + beyond + ANGLE_WEIGHT * abs(wrap(heading - ahead)), steady


@jit
def nearest(table, x, y, heading):  # type: ignore[no-untyped-def]
    """Row of the lane nearest to a pose; -1 when two are as near but for rounding, or a distance is not a number."""
    best, second, row = math.inf, math.inf, -1
    for i in range(table.shape[0]):
        d, steady = distance(table[i], x, y, heading)
        if not (steady and d < math.inf):
            return -1
        if d < best:
            best, second, row = d, best, i
        elif d < second:
            second = d
    return row if second - best > CLOSE * (1.0 + best) else -1
