"""Lanes in flat arrays: where a point lies on a lane, and what point lies where, as the lane classes have it.

A lane runs at a constant offset beside a path of cells, whose curvature is linear (:mod:`..worlds.paths`); a straight
road is a path of one cell.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.accel import jit

__all__ = [
    "CELL_COLUMNS",
    "LANE_COLUMNS",
    "Lanes",
    "heading_at",
    "local",
    "nearest",
    "of_side",
    "on_lane",
    "place",
    "reachable",
    "wrap",
]

C_X, C_Y, C_HEADING, C_KAPPA, C_SLOPE, C_SPAN, C_STATION = range(7)
CELL_COLUMNS = 7
TWO_PI = 2.0 * math.pi
VEHICLE_LENGTH_M = 5.0  # AbstractLane.VEHICLE_LENGTH of highway-env: lanes hold a vehicle so far past their ends
CLOTHOID_STEPS = 6
NEAR = 1e-12
GAUSS_1, GAUSS_2, GAUSS_3 = 0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15)


# columns of the table of lanes: a road is named by the row of its leftmost lane
(
    OFFSET,
    WIDTH,
    LENGTH,
    LIMIT,
    SIDE,
    ROAD,
    COUNT,
    ONWARD,
    JOINED_FIRST,
    JOINED_LAST,
    CELL_FIRST,
    CELL_LAST,
    LOW_X,
    LOW_Y,
    COLUMNS,
    ROWS,
    NEAR_FIRST,
    STRAIGHT,
) = range(18)
LANE_COLUMNS = 18
SQUARE_M = 8.0  # of worlds/paths.py


class Lanes(NamedTuple):
    """L lanes beside paths of C cells.

    table (L, LANE_COLUMNS): offset from the path, width, length [m], speed limit [m/s]; number in the road, the road
    and how many lanes it has; the lane that follows, -1 for none; first and past the last row in ``joined``; the same
    in ``cells``; corner of a grid of squares [m], its columns, rows and first entry in ``near``; whether the path is a
    straight along x.
    cells (C, CELL_COLUMNS); near (G,): the cell of its path to begin a search at, by square; joined (J, 2): the roads
    that meet the ends of a road, and whether all their lanes count as joined.
    """

    table: NDArray[np.float64]
    cells: NDArray[np.float64]
    near: NDArray[np.int64]
    joined: NDArray[np.int64]


@jit
def wrap(angle):  # type: ignore[no-untyped-def]
    """The angle in [-pi, pi), as highway-env has it."""
    return (angle + math.pi) % TWO_PI - math.pi


@jit
def _advance(cells, c, into):  # type: ignore[no-untyped-def]
    """Pose at a distance into a cell: a chord on straights and arcs, three Gauss points on clothoids."""
    x, y, heading = cells[c, C_X], cells[c, C_Y], cells[c, C_HEADING]
    kappa, slope = cells[c, C_KAPPA], cells[c, C_SLOPE]
    if slope == 0.0:
        half = 0.5 * kappa * into
        chord = into if half == 0.0 else into * math.sin(half) / half
        return x + chord * math.cos(heading + half), y + chord * math.sin(heading + half), heading + 2.0 * half
    for k in range(3):
        share = GAUSS_1 if k == 0 else GAUSS_2 if k == 1 else GAUSS_3
        weight = 8.0 / 18.0 if k == 1 else 5.0 / 18.0
        u = share * into
        angle = heading + (kappa + 0.5 * slope * u) * u
        x += weight * into * math.cos(angle)
        y += weight * into * math.sin(angle)
    return x, y, heading + (kappa + 0.5 * slope * into) * into


@jit
def _foot(cells, c, x, y):  # type: ignore[no-untyped-def]
    """Distance into a cell of the foot of the normal through a point, which may lie outside it, and the offset."""
    heading = cells[c, C_HEADING]
    cosine, sine = math.cos(heading), math.sin(heading)
    dx, dy = x - cells[c, C_X], y - cells[c, C_Y]
    along, right = dx * cosine + dy * sine, dy * cosine - dx * sine
    kappa, slope = cells[c, C_KAPPA], cells[c, C_SLOPE]
    if slope != 0.0:
        return _foot_clothoid(cells, c, x, y, along / max(1.0 - kappa * right, 0.1))
    if kappa == 0.0:
        return along, right
    a, b = kappa * along, 1.0 - kappa * right
    gap = (kappa * right * (1.0 + b) - a * a) / (1.0 + math.hypot(a, b))
    return math.atan2(a, b) / kappa, gap / kappa


@jit
def _foot_clothoid(cells, c, x, y, into):  # type: ignore[no-untyped-def]
    span, right = cells[c, C_SPAN], 0.0
    for _ in range(CLOTHOID_STEPS):
        into = min(max(into, -span), 2.0 * span)
        x0, y0, heading = _advance(cells, c, into)
        cosine, sine = math.cos(heading), math.sin(heading)
        ahead, right = (x - x0) * cosine + (y - y0) * sine, (y - y0) * cosine - (x - x0) * sine
        kappa = cells[c, C_KAPPA] + cells[c, C_SLOPE] * into
        move = ahead / max(1.0 - kappa * right, 0.1)
        into += move
        if abs(move) < NEAR:
            break
    return into, right


@jit
def _project(table, cells, near, lane, x, y):  # type: ignore[no-untyped-def]
    """Cell, distance into it and offset of the nearest point of a path: a walk from the cell that the grid names."""
    low, last = int(table[lane, CELL_FIRST]), int(table[lane, CELL_LAST]) - 1
    columns, rows = int(table[lane, COLUMNS]), int(table[lane, ROWS])
    column = min(max(math.floor((x - table[lane, LOW_X]) / SQUARE_M), 0), columns - 1)
    row = min(max(math.floor((y - table[lane, LOW_Y]) / SQUARE_M), 0), rows - 1)
    c, way = low + near[int(table[lane, NEAR_FIRST]) + column * rows + row], 0
    while True:
        into, lateral = _foot(cells, c, x, y)
        if into < 0.0 and c > low:
            if way > 0:
                return c, 0.0, _aside(cells, c, x, y)
            c, way = c - 1, -1
        elif into > cells[c, C_SPAN] and c < last:
            c += 1
            if way < 0:
                return c, 0.0, _aside(cells, c, x, y)
            way = 1
        else:
            return c, into, lateral


@jit
def _aside(cells, c, x, y):  # type: ignore[no-untyped-def]
    """How far a point is to the right of a cell's first one."""
    heading = cells[c, C_HEADING]
    return (y - cells[c, C_Y]) * math.cos(heading) - (x - cells[c, C_X]) * math.sin(heading)


@jit
def _station(table, cells, lane, c):  # type: ignore[no-untyped-def]
    """Distance along a lane of the beginning of a cell of its path."""
    begin = int(table[lane, CELL_FIRST])
    return cells[c, C_STATION] - table[lane, OFFSET] * (cells[c, C_HEADING] - cells[begin, C_HEADING])


@jit
def local(lanes, lane, x, y):  # type: ignore[no-untyped-def]
    """Distance along a lane, offset to its right, and the lane's direction there: (s, r, heading)."""
    table, cells = lanes.table, lanes.cells
    if table[lane, STRAIGHT] > 0.0:
        return x - table[lane, LOW_X], y - table[lane, LOW_Y] - table[lane, OFFSET], 0.0
    c, into, lateral = _project(table, cells, lanes.near, lane, x, y)
    turned = (cells[c, C_KAPPA] + 0.5 * cells[c, C_SLOPE] * into) * into
    s = _station(table, cells, lane, c) + into - table[lane, OFFSET] * turned
    return s, lateral - table[lane, OFFSET], cells[c, C_HEADING] + turned


@jit
def _into(table, cells, lane, s):  # type: ignore[no-untyped-def]
    """Cell and distance along the path into it, of a distance along a lane."""
    offset, low, high = table[lane, OFFSET], int(table[lane, CELL_FIRST]), int(table[lane, CELL_LAST])
    while high - low > 1:
        middle = (low + high) // 2
        if _station(table, cells, lane, middle) <= s:
            low = middle
        else:
            high = middle
    rest = s - _station(table, cells, lane, low)
    factor = 1.0 - offset * cells[low, C_KAPPA]
    under = factor * factor - 2.0 * offset * cells[low, C_SLOPE] * rest
    return low, 2.0 * rest / (factor + math.sqrt(max(under, 0.0)))


@jit
def place(lanes, lane, s, r):  # type: ignore[no-untyped-def]
    """The point at a distance along a lane and to the right of it: (x, y)."""
    c, into = _into(lanes.table, lanes.cells, lane, s)
    x, y, heading = _advance(lanes.cells, c, into)
    aside = r + lanes.table[lane, OFFSET]
    return x - aside * math.sin(heading), y + aside * math.cos(heading)


@jit
def heading_at(lanes, lane, s):  # type: ignore[no-untyped-def]
    """Direction of a lane, not wrapped."""
    cells = lanes.cells
    if lanes.table[lane, STRAIGHT] > 0.0:
        return 0.0
    c, into = _into(lanes.table, cells, lane, s)
    return cells[c, C_HEADING] + (cells[c, C_KAPPA] + 0.5 * cells[c, C_SLOPE] * into) * into


@jit
def nearest(lanes, x, y, heading):  # type: ignore[no-untyped-def]
    """The lane with the least ``|r| + beyond its ends + |angle|``; the first of equals."""
    best, least = 0, math.inf
    for lane in range(lanes.table.shape[0]):
        s, r, direction = local(lanes, lane, x, y)
        distance = abs(r) + max(s - lanes.table[lane, LENGTH], 0.0, -s) + abs(wrap(heading - direction))
        if distance < least:
            best, least = lane, distance
    return best


@jit
def on_lane(table, lane, s, r):  # type: ignore[no-untyped-def]
    """Whether a point at (s, r) is on a lane."""
    beside = abs(r) <= 0.5 * table[lane, WIDTH]
    return beside and -VEHICLE_LENGTH_M <= s < table[lane, LENGTH] + VEHICLE_LENGTH_M


@jit
def reachable(table, lane, s, r):  # type: ignore[no-untyped-def]
    """Whether a lane may be changed to from (s, r) on it."""
    return abs(r) <= 2.0 * table[lane, WIDTH] and 0.0 <= s < table[lane, LENGTH] + VEHICLE_LENGTH_M


@jit
def of_side(table, road, side):  # type: ignore[no-untyped-def]
    """The lane of a number on a road, its last one if there are fewer."""
    return road + min(side, int(table[road, COUNT]) - 1)
