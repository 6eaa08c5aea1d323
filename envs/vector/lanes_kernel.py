"""Lanes in flat arrays: where a point lies on a lane, and what point lies where, as the lane classes have it.

A lane runs at a constant offset beside a path of cells, whose curvature is linear (:mod:`..worlds.paths`); a straight
road is a path of one cell.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit

__all__ = [
    "CELL_COLUMNS",
    "LANE_COLUMNS",
    "NOWHERE",
    "Lanes",
    "advised",
    "following",
    "heading_at",
    "local",
    "nearest",
    "of_side",
    "on_lane",
    "on_straight",
    "place",
    "reachable",
    "remainder",
    "stations",
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
    BEFORE,
    ADVICE_FIRST,
    ADVICE_LAST,
) = range(21)
LANE_COLUMNS = 21
SQUARE_M = 8.0  # of worlds/paths.py
ADVICE_STEP_M = 2.0  # of worlds/lanes.py
NOWHERE = -math.inf  # a distance along a lane that does not hold a point


class Lanes(NamedTuple):
    """L lanes beside paths of C cells.

    table (L, LANE_COLUMNS): offset from the path, width, length [m], speed limit [m/s]; number in the road, the road
    and how many lanes it has; the lane that follows, -1 for none; first and past the last row in ``joined``; the same
    in ``cells``; corner of a grid of squares [m], its columns, rows and first entry in ``near``; whether the path is a
    straight along x; the lane before, -1 for none; first and past the last entry in ``advice``, none on straights.
    cells (C, CELL_COLUMNS); near (G,): the cell of its path to begin a search at, by square; joined (J, 2): the roads
    that meet the ends of a road, and whether all their lanes count as joined; advice (A,): speed that the bends ahead
    allow [m/s], every 2 m of a lane.
    """

    table: NDArray[np.float64]
    cells: NDArray[np.float64]
    near: NDArray[np.int64]
    joined: NDArray[np.int64]
    advice: NDArray[np.float64]


@jit(inline=True)
def wrap(angle):  # type: ignore[no-untyped-def]
    """The angle in [-pi, pi), with the rounding of highway-env: drivers that crawl would multiply any other."""
    above = angle + math.pi
    return above - TWO_PI * math.floor(above / TWO_PI) - math.pi


@jit
def remainder(angle):  # type: ignore[no-untyped-def]
    """The angle in [-pi, pi], as ``math.remainder`` has it."""
    return angle - TWO_PI * round(angle / TWO_PI)


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
    table = lanes.table
    if table[lane, STRAIGHT] > 0.0:
        s, r = on_straight(table, lane, x, y)
        return s, r, 0.0
    foot, into, lateral = _project(table, lanes.cells, lanes.near, lane, x, y)
    return _on_path(table, lanes.cells, lane, foot, into, lateral)


@jit
def on_straight(table, lane, x, y):  # type: ignore[no-untyped-def]
    """Distance along a lane that is straight along x, and offset to its right."""
    return x - table[lane, LOW_X], y - table[lane, LOW_Y] - table[lane, OFFSET]


@jit
def _on_path(table, cells, lane, c, into, lateral):  # type: ignore[no-untyped-def]
    """What :func:`local` says of a point with a given foot on the path that all lanes of a road share."""
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
    """The lane with the least ``|r| + beyond its ends + |angle|``; the first of equals.

    A road that is farther away than the best lane so far is passed over.
    """
    best, least, road, table = 0, math.inf, 0, lanes.table
    while road < table.shape[0]:
        end = road + int(table[road, COUNT])
        if table[road, STRAIGHT] > 0.0:
            turn = abs(wrap(heading))
            for lane in range(road, end):
                s, r = on_straight(table, lane, x, y)
                distance = abs(r) + max(s - table[lane, LENGTH], 0.0, -s) + turn
                if distance < least:
                    best, least = lane, distance
        elif _away(table, road, x, y) <= least:
            foot, into, lateral = _project(table, lanes.cells, lanes.near, road, x, y)
            for lane in range(road, end):
                s, r, direction = _on_path(table, lanes.cells, lane, foot, into, lateral)
                distance = abs(r) + max(s - table[lane, LENGTH], 0.0, -s) + abs(wrap(heading - direction))
                if distance < least:
                    best, least = lane, distance
        road = end
    return best


@jit
def _away(table, road, x, y):  # type: ignore[no-untyped-def]
    """A distance that no lane of a road is nearer than, and from which on it holds no point: to its path's squares."""
    low_x, low_y = table[road, LOW_X], table[road, LOW_Y]
    beyond_x, beyond_y = x - low_x - SQUARE_M * table[road, COLUMNS], y - low_y - SQUARE_M * table[road, ROWS]
    return max(low_x - x, beyond_x, low_y - y, beyond_y, 0.0)


@jit
def stations(lanes, x, y, margin, out):  # type: ignore[no-untyped-def]
    """Fill ``out`` (L,): how far along each lane a point is, ``NOWHERE`` on lanes that do not hold it by a margin."""
    road, table = 0, lanes.table
    while road < table.shape[0]:
        end = road + int(table[road, COUNT])
        out[road:end] = NOWHERE
        if table[road, STRAIGHT] > 0.0:
            for lane in range(road, end):
                s, r = on_straight(table, lane, x, y)
                if on_lane(table, lane, s, r, margin):
                    out[lane] = s
        elif not _away(table, road, x, y) > 0.0:
            foot, into, lateral = _project(table, lanes.cells, lanes.near, road, x, y)
            for lane in range(road, end):
                s, r, _ = _on_path(table, lanes.cells, lane, foot, into, lateral)
                if on_lane(table, lane, s, r, margin):
                    out[lane] = s
        road = end


@jit
def advised(lanes, lane, s):  # type: ignore[no-untyped-def]
    """Speed that the bends ahead on a lane allow, as ``CurveLane.advised_speed``."""
    first, last = int(lanes.table[lane, ADVICE_FIRST]), int(lanes.table[lane, ADVICE_LAST]) - 1
    return lanes.advice[min(first + max(int(s / ADVICE_STEP_M), 0), last)]


@jit
def following(lanes, lane, x, y):  # type: ignore[no-untyped-def]
    """The lane to follow from a point on: near its end the one after it, if there is one."""
    onward = int(lanes.table[lane, ONWARD])
    if onward >= 0:
        s, _, _ = local(lanes, lane, x, y)
        if s > lanes.table[lane, LENGTH] - 0.5 * VEHICLE_LENGTH_M:
            return onward
    return lane


@jit
def on_lane(table, lane, s, r, margin=0.0):  # type: ignore[no-untyped-def]
    """Whether a point at (s, r) is on a lane, or beside it by no more than a margin."""
    beside = abs(r) <= 0.5 * table[lane, WIDTH] + margin
    return beside and -VEHICLE_LENGTH_M <= s < table[lane, LENGTH] + VEHICLE_LENGTH_M


@jit
def reachable(table, lane, s, r):  # type: ignore[no-untyped-def]
    """Whether a lane may be changed to from (s, r) on it."""
    return abs(r) <= 2.0 * table[lane, WIDTH] and 0.0 <= s < table[lane, LENGTH] + VEHICLE_LENGTH_M


@jit
def of_side(table, road, side):  # type: ignore[no-untyped-def]
    """The lane of a number on a road, its last one if there are fewer."""
    return road + min(side, int(table[road, COUNT]) - 1)
