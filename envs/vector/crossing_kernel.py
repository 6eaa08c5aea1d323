"""Right of way at a crossing without lights, compiled: the rules of :mod:`lanebound.envs.worlds.crossing`.

``c`` is a Crossing. A driver's ``way`` is the row of its way through, NONE before it has one and after it has left.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.batch.lanes_kernel import NONE, local
from lanebound.envs.worlds.idm_parameters_kernel import (
    ASKS_M,
    CLEAR_S,
    EXIT_M,
    GAP_S,
    LINE_BRAKE_MPS2,
    LINE_M,
    LINE_S,
    SLOW_MPS,
    START_MPS2,
)
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record

__all__ = ["APPROACH", "ELSEWHERE", "EXIT", "INSIDE", "PART", "WAY", "Crossing", "follows", "give_way", "stop_at_line"]

ELSEWHERE, APPROACH, INSIDE, EXIT = 0, 1, 2, 3  # parts of a crossing that lanes are

PART = record(
    kind=("i8", "ELSEWHERE, APPROACH, INSIDE or EXIT"),
    way=("i8", "row of the way that a lane inside is, NONE for others"),
)
WAY = record(
    lane=("i8", "row of its lane inside"),
    start=("i8", "road of the approach"),
    end=("i8", "road of the exit"),
    priority=("i8", "higher goes first"),
)


class Crossing(NamedTuple):
    """A crossing that drivers enter with permission.

    parts (L,) PART of lanes, (0,) where no crossing has such a rule; ways (W,) WAY; spans (W, W, 2): stations between
    which a way is near another one, NaN where it is not [m].
    """

    parts: Records
    ways: Records
    spans: NDArray[np.float64]


@jit(borrows=True)
def _to_line(v, lanes, c, i):  # type: ignore[no-untyped-def]
    """Distance from the bumper of a driver to the crossing; not positive once it is beyond."""
    if c.parts[v.lane[i]].kind != APPROACH:
        return 0.0
    s, _, _ = local(lanes, v.lane[i], v.x[i], v.y[i])
    return lanes.table[v.lane[i]].length_m - s - 0.5 * v.length[i]


@jit(borrows=True)
def _way(v, drivers, lanes, c, routes, i):  # type: ignore[no-untyped-def]
    """The way of a driver through the crossing; NONE once it has left it."""
    kind = c.parts[v.lane[i]].kind
    if kind == INSIDE:  # where lanes overlap the nearest one need not be its own
        return drivers[i].way
    if kind == EXIT:
        s, _, _ = local(lanes, v.lane[i], v.x[i], v.y[i])
        return drivers[i].way if s < EXIT_M + v.length[i] else NONE
    at = drivers[i].route
    while routes[at].road >= 0:
        if c.parts[routes[at].road].kind == INSIDE:
            return c.parts[routes[at].road].way
        at += 1
    return NONE


@jit(inline=True)
def _time_s(way_m, speed, acceleration):  # type: ignore[no-untyped-def]
    """Time for a way, speeding up all the while."""
    return (math.sqrt(speed * speed + 2.0 * acceleration * way_m) - speed) / acceleration


@jit(borrows=True)
def _station(v, drivers, lanes, c, i):  # type: ignore[no-untyped-def]
    """How far along its way a driver is, from where the crossing begins."""
    own, way = v.lane[i], c.ways[drivers[i].way].lane
    kind = c.parts[own].kind
    s, _, _ = local(lanes, way if kind == INSIDE else own, v.x[i], v.y[i])
    if kind == INSIDE:
        return s
    return s + lanes.table[way].length_m if kind == EXIT else s - lanes.table[own].length_m


@jit(borrows=True)
def _makes_way(v, drivers, lanes, c, u, i):  # type: ignore[no-untyped-def]
    """Whether driver u, that may enter, leaves what it shares with the way of driver i before that one is there."""
    a, b = drivers[u].way, drivers[i].way
    if math.isnan(c.spans[a, b, 0]):
        return True
    left = c.spans[a, b, 1] + 0.5 * v.length[u] - _station(v, drivers, lanes, c, u)
    begins = c.spans[b, a, 0]
    if math.isnan(begins) or left <= 0.0 or c.ways[a].start == c.ways[b].start:
        return left <= 0.0
    reaches = _time_s(_to_line(v, lanes, c, i) + begins, v.speed[i], START_MPS2)
    return _time_s(left, v.speed[u], 0.5 * START_MPS2) + CLEAR_S < reaches


@jit(borrows=True)
def _free(v, count, drivers, lanes, c, i):  # type: ignore[no-untyped-def]
    """Whether all that may enter make way for driver i, and no ego is inside that it waits for."""
    if c.parts[v.lane[0]].kind == INSIDE and v.speed[i] < SLOW_MPS:
        return False
    for u in range(1, count):
        if u != i and drivers[u].may_enter != 0 and not _makes_way(v, drivers, lanes, c, u, i):
            return False
    return True


@jit(borrows=True)
def _in_time(v, drivers, lanes, c, i, u):  # type: ignore[no-untyped-def]
    """Whether driver i is clear before u, that comes before it in the order, reaches the crossing."""
    a, b = drivers[i].way, drivers[u].way
    if math.isnan(c.spans[a, b, 0]) or c.ways[a].priority == c.ways[b].priority:
        return True
    clear_s = _time_s(_to_line(v, lanes, c, i) + c.spans[a, b, 1] + v.length[i], v.speed[i], START_MPS2)
    return _to_line(v, lanes, c, u) / max(v.speed[u], SLOW_MPS) >= clear_s + GAP_S


@jit(borrows=True)
def _ahead_of(v, drivers, lanes, c, i, u):  # type: ignore[no-untyped-def]
    """Whether driver u is decided before i: of higher priority, or nearer to the crossing among equals."""
    own, other = c.ways[drivers[i].way].priority, c.ways[drivers[u].way].priority
    return other > own or (other == own and _to_line(v, lanes, c, u) < _to_line(v, lanes, c, i))


@jit(borrows=True)
def give_way(v, count, drivers, lanes, c, routes, order):  # type: ignore[no-untyped-def]
    """Decide for each driver that approaches whether it may enter, ``CrossingRoad.enforce_road_rules``.

    order (V,) is scratch: the first drivers of their lanes that ask, in the order in which they are decided.
    """
    asking = 0
    for i in range(1, count):
        driver = drivers[i]
        driver.way = _way(v, drivers, lanes, c, routes, i)
        to_line = _to_line(v, lanes, c, i)
        stops = to_line - LINE_M >= 0.5 * (v.speed[i] * v.speed[i]) / LINE_BRAKE_MPS2
        may = driver.way >= 0 and (to_line <= 0.0 or (driver.may_enter != 0 and not stops))
        driver.may_enter = 1 if may else 0
    for i in range(1, count):
        if drivers[i].way < 0 or drivers[i].may_enter != 0 or not _is_first(v, count, drivers, lanes, c, i):
            continue
        at = asking
        while at > 0 and _ahead_of(v, drivers, lanes, c, order[at - 1], i):
            order[at] = order[at - 1]
            at -= 1
        order[at] = i
        asking += 1
    for n in range(asking):
        i = order[n]
        if _to_line(v, lanes, c, i) < ASKS_M:
            may = _free(v, count, drivers, lanes, c, i)
            for k in range(n):
                may = may and _in_time(v, drivers, lanes, c, i, order[k])
            drivers[i].may_enter = 1 if may else 0


@jit(borrows=True)
def _is_first(v, count, drivers, lanes, c, i):  # type: ignore[no-untyped-def]
    """Whether no other driver that asks is nearer to the crossing on the same lane."""
    to_line = _to_line(v, lanes, c, i)
    for u in range(1, count):
        if u != i and v.lane[u] == v.lane[i] and drivers[u].way >= 0 and drivers[u].may_enter == 0:
            if _to_line(v, lanes, c, u) < to_line:
                return False
    return True


@jit(borrows=True)
def follows(v, drivers, lanes, c, i, j):  # type: ignore[no-untyped-def]
    """Whether driver i takes vehicle j ahead for one that it follows, see ``IntersectionDriver.acceleration``.

    Not one that comes towards it on the approach of the arm into which it leaves, nor a driver whose way crosses.
    """
    own, other = v.lane[i], v.lane[j]
    if c.parts[own].kind == EXIT and c.parts[other].kind == APPROACH:
        for k in range(lanes.table[own].joint_onward, lanes.table[own].joint_last):
            if lanes.joints[k].road == lanes.table[other].road and math.cos(v.heading[i] - v.heading[j]) < 0.0:
                return False
    a, b = drivers[i].way, drivers[j].way if j > 0 else NONE
    if a < 0 or b < 0 or c.parts[other].kind != INSIDE:
        return True
    return c.ways[a].start == c.ways[b].start or c.ways[a].end == c.ways[b].end


@jit(borrows=True)
def stop_at_line(v, drivers, lanes, c, i):  # type: ignore[no-untyped-def]
    """The acceleration with which driver i stops before the crossing where it may not enter, inf where it may."""
    if drivers[i].may_enter != 0:
        return math.inf
    line = _to_line(v, lanes, c, i)
    if line <= 0.0:
        return math.inf
    return (math.sqrt(2.0 * LINE_BRAKE_MPS2 * max(line - LINE_M, 0.0)) - v.speed[i]) / LINE_S
