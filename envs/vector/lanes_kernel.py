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

__all__ = ["CELL_COLUMNS", "Lanes", "heading_at", "local", "nearest", "on_lane", "place", "reachable", "wrap"]

C_X, C_Y, C_HEADING, C_KAPPA, C_SLOPE, C_SPAN, C_STATION = range(7)
CELL_COLUMNS = 7
TWO_PI = 2.0 * math.pi
VEHICLE_LENGTH_M = 5.0  # AbstractLane.VEHICLE_LENGTH of highway-env: lanes hold a vehicle so far past their ends
CLOTHOID_STEPS = 6
NEAR = 1e-12
GAUSS_1, GAUSS_2, GAUSS_3 = 0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15)


class Lanes(NamedTuple):
    """L lanes of R roads beside P paths of C cells.

    path, road (L,); offset, width, length, limit (L,) [m], [m/s]; side (L,) number in the road, first and count (R,) of
    its lanes; joined_first (R + 1,), joined (J,), joined_whole (J,): the roads that meet a road's ends, and whether all
    their lanes count as joined; onward (L,): the lane that follows, -1 for none.
    cells (C, CELL_COLUMNS), cell_first (P + 1,); low (P, 2), shape (P, 3): corner of a grid of squares, columns, rows
    and first entry in ``near`` (G,), the cell to begin a search at; square [m].
    """

    path: NDArray[np.int64]
    road: NDArray[np.int64]
    offset: NDArray[np.float64]
    width: NDArray[np.float64]
    length: NDArray[np.float64]
    limit: NDArray[np.float64]
    side: NDArray[np.int64]
    first: NDArray[np.int64]
    count: NDArray[np.int64]
    joined_first: NDArray[np.int64]
    joined: NDArray[np.int64]
    joined_whole: NDArray[np.bool_]
    onward: NDArray[np.int64]
    cells: NDArray[np.float64]
    cell_first: NDArray[np.int64]
    low: NDArray[np.float64]
    shape: NDArray[np.int64]
    near: NDArray[np.int64]
    square: float


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
def _project(lanes, p, x, y):  # type: ignore[no-untyped-def]
    """Cell, distance into it and offset of the nearest point of a path: a walk from the cell that the grid names."""
    low, last = lanes.cell_first[p], lanes.cell_first[p + 1] - 1
    columns, rows = lanes.shape[p, 0], lanes.shape[p, 1]
    column = min(max(math.floor((x - lanes.low[p, 0]) / lanes.square), 0), columns - 1)
    row = min(max(math.floor((y - lanes.low[p, 1]) / lanes.square), 0), rows - 1)
    c, way = low + lanes.near[lanes.shape[p, 2] + column * rows + row], 0
    while True:
        into, lateral = _foot(lanes.cells, c, x, y)
        if into < 0.0 and c > low:
            if way > 0:
                return c, 0.0, _aside(lanes.cells, c, x, y)
            c, way = c - 1, -1
        elif into > lanes.cells[c, C_SPAN] and c < last:
            c += 1
            if way < 0:
                return c, 0.0, _aside(lanes.cells, c, x, y)
            way = 1
        else:
            return c, into, lateral


@jit
def _aside(cells, c, x, y):  # type: ignore[no-untyped-def]
    """How far a point is to the right of a cell's first one."""
    heading = cells[c, C_HEADING]
    return (y - cells[c, C_Y]) * math.cos(heading) - (x - cells[c, C_X]) * math.sin(heading)


@jit
def _station(lanes, lane, c):  # type: ignore[no-untyped-def]
    """Distance along a lane of the beginning of a cell of its path."""
    cells, begin = lanes.cells, lanes.cell_first[lanes.path[lane]]
    return cells[c, C_STATION] - lanes.offset[lane] * (cells[c, C_HEADING] - cells[begin, C_HEADING])


@jit
def local(lanes, lane, x, y):  # type: ignore[no-untyped-def]
    """Distance along a lane, offset to its right, and the lane's direction there: (s, r, heading)."""
    cells = lanes.cells
    c, into, lateral = _project(lanes, lanes.path[lane], x, y)
    turned = (cells[c, C_KAPPA] + 0.5 * cells[c, C_SLOPE] * into) * into
    s = _station(lanes, lane, c) + into - lanes.offset[lane] * turned
    return s, lateral - lanes.offset[lane], cells[c, C_HEADING] + turned


@jit
def _into(lanes, lane, s):  # type: ignore[no-untyped-def]
    """Cell and distance along the path into it, of a distance along a lane."""
    cells, p, offset = lanes.cells, lanes.path[lane], lanes.offset[lane]
    low, high = lanes.cell_first[p], lanes.cell_first[p + 1]
    while high - low > 1:
        middle = (low + high) // 2
        if _station(lanes, lane, middle) <= s:
            low = middle
        else:
            high = middle
    rest = s - _station(lanes, lane, low)
    factor = 1.0 - offset * cells[low, C_KAPPA]
    under = factor * factor - 2.0 * offset * cells[low, C_SLOPE] * rest
    return low, 2.0 * rest / (factor + math.sqrt(max(under, 0.0)))


@jit
def place(lanes, lane, s, r):  # type: ignore[no-untyped-def]
    """The point at a distance along a lane and to the right of it: (x, y)."""
    c, into = _into(lanes, lane, s)
    x, y, heading = _advance(lanes.cells, c, into)
    aside = r + lanes.offset[lane]
    return x - aside * math.sin(heading), y + aside * math.cos(heading)


@jit
def heading_at(lanes, lane, s):  # type: ignore[no-untyped-def]
    """Direction of a lane, not wrapped."""
    c, into = _into(lanes, lane, s)
    return lanes.cells[c, C_HEADING] + (lanes.cells[c, C_KAPPA] + 0.5 * lanes.cells[c, C_SLOPE] * into) * into


@jit
def nearest(lanes, x, y, heading):  # type: ignore[no-untyped-def]
    """The lane with the least ``|r| + beyond its ends + |angle|``; the first of equals."""
    best, least = 0, math.inf
    for lane in range(lanes.path.shape[0]):
        s, r, direction = local(lanes, lane, x, y)
        distance = abs(r) + max(s - lanes.length[lane], 0.0, -s) + abs(wrap(heading - direction))
        if distance < least:
            best, least = lane, distance
    return best


@jit
def on_lane(lanes, lane, s, r):  # type: ignore[no-untyped-def]
    """Whether a point at (s, r) is on a lane."""
    beside = abs(r) <= 0.5 * lanes.width[lane]
    return beside and -VEHICLE_LENGTH_M <= s < lanes.length[lane] + VEHICLE_LENGTH_M


@jit
def reachable(lanes, lane, s, r):  # type: ignore[no-untyped-def]
    """Whether a lane may be changed to from (s, r) on it."""
    return abs(r) <= 2.0 * lanes.width[lane] and 0.0 <= s < lanes.length[lane] + VEHICLE_LENGTH_M
