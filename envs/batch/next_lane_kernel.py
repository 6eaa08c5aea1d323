"""Which lane comes after the end of a lane: along a planned route, else the nearest one, as highway-env chooses it.

Routes lie one after another in an array of STEP, each with a row without a road at its end. A vehicle holds the row of
the first step that is left of its route: ``at``. Row 0 is the end of a route without steps: no route.
"""

from __future__ import annotations

import math

from lanebound.envs.batch.lanes_kernel import NONE, PAST_END_M, local, place
from lanebound.envs.batch.records_kernel import GIVEN
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import wrap
from lanebound.integrity.core.records import record

__all__ = ["ROUTE_M", "STEP", "beyond", "following", "keep_rows", "keep_to_route", "next_lane", "route_onward"]

ROUTE_M = 2.0  # half a lane of highway-env: a lane of the route is preferred unless another is this much nearer

STEP = record(
    road=("i8", "row of the leftmost lane of a road, NONE at the end of a route"),
    side=("i8", "number of the lane on it, NONE for any"),
)
"""A step of a planned route."""


@jit(borrows=True)
def _distance(lanes, n, x, y):  # type: ignore[no-untyped-def]
    """Distance of a point from a lane and its ends, ``AbstractLane.distance``."""
    s, r, _ = local(lanes, n, x, y)
    return abs(r) + max(s - lanes.table[n].length_m, 0.0) + max(-s, 0.0)


@jit(borrows=True)
def _entered(lanes, n, road, side, x, y):  # type: ignore[no-untyped-def]
    """The lane of a road on which a vehicle from the end of lane n goes on, ``next_lane_given_next_road``.

    That of the same number on a road of as many lanes, else the nearest.  -> (row, distance)
    """
    count = lanes.table[road].count
    if count == lanes.table[n].count:
        best = road + (lanes.table[n].side if side < 0 else side)
        return best, _distance(lanes, best, x, y)
    best, least = road, _distance(lanes, road, x, y)
    for m in range(road + 1, road + count):
        distance = _distance(lanes, m, x, y)
        if distance < least:
            best, least = m, distance
    return best, least


@jit(borrows=True)
def _begins_at_end(lanes, n, road):  # type: ignore[no-untyped-def]
    """Whether a road goes on from the end of lane n."""
    for k in range(lanes.table[n].joint_onward, lanes.table[n].joint_last):
        if lanes.joints[k].road == road:
            return True
    return False


@jit(borrows=True)
def next_lane(lanes, routes, at, n, x, y):  # type: ignore[no-untyped-def]
    """The lane after lane n for a vehicle at a point, and what is left of its route, ``RoadNetwork.next_lane``.

    Where the route does not say: the lane nearest to the point, moved across to the middle of lane n; lane n itself
    where nothing goes on.  -> (row, at)
    """
    if routes[at].road == lanes.table[n].road:
        at += 1
    s, _, _ = local(lanes, n, x, y)
    on_x, on_y = place(lanes, n, s, 0.0)
    road = routes[at].road
    if road >= 0 and _begins_at_end(lanes, n, road):
        lane, _ = _entered(lanes, n, road, routes[at].side, on_x, on_y)
        return lane, at
    best, least = n, math.inf
    for k in range(lanes.table[n].joint_onward, lanes.table[n].joint_last):
        lane, distance = _entered(lanes, n, lanes.joints[k].road, NONE, on_x, on_y)
        if distance < least:
            best, least = lane, distance
    return best, at


@jit(borrows=True)
def following(lanes, routes, at, n, x, y):  # type: ignore[no-untyped-def]
    """The lane to follow from a point on: near the end of lane n the next one, ``follow_road``.  -> (row, at)"""
    lane = lanes.table[n]
    if lane.joint_onward == lane.joint_last and routes[at].road < 0:
        return n, at  # nothing goes on, and there is no step of a route to be taken off
    s, _, _ = local(lanes, n, x, y)
    if s > lane.length_m - 0.5 * PAST_END_M:
        return next_lane(lanes, routes, at, n, x, y)
    return n, at


@jit(borrows=True)
def beyond(lanes, routes, at, n):  # type: ignore[no-untyped-def]
    """The lane beyond the end of lane n, by what is left of a route; NONE without one."""
    x, y = place(lanes, n, lanes.table[n].length_m, 0.0)
    onward, _ = next_lane(lanes, routes, at, n, x, y)
    return onward if onward != n else NONE


@jit(borrows=True)
def route_onward(lanes, routes, at, n):  # type: ignore[no-untyped-def]
    """The lane that a route goes on to from the end of lane n; NONE without one."""
    while routes[at].road >= 0:
        road = routes[at].road
        if _begins_at_end(lanes, n, road):
            side = lanes.table[n].side if routes[at].side < 0 else routes[at].side
            return road + (side if side < lanes.table[road].count else 0)
        at += 1
    return NONE


@jit(borrows=True)
def _planned(routes, at, road):  # type: ignore[no-untyped-def]
    """Whether a road is among those that are left of a route."""
    while routes[at].road >= 0:
        if routes[at].road == road:
            return True
        at += 1
    return False


@jit(borrows=True)
def _closest_by_route(ego, before, target, lanes, routes):  # type: ignore[no-untyped-def]
    """The lane nearest to the believed pose, where others than those of the route and of two roads are further off."""
    b, best, least = ego.belief, 0, math.inf
    for n in range(lanes.table.shape[0]):
        _, _, direction = local(lanes, n, b.x_m, b.y_m)
        distance = _distance(lanes, n, b.x_m, b.y_m) + abs(wrap(b.heading_rad - direction))
        road = lanes.table[n].road
        if road != before and road != target and not _planned(routes, ego.route, road):
            distance += ROUTE_M
        if distance < least:
            best, least = n, distance
    return best


@jit(borrows=True)
def keep_to_route(ego, lanes, routes, rules):  # type: ignore[no-untyped-def]
    """Put the believed car on a lane of its route, of its target or of before where another one is hardly nearer.

    Where lanes cross or part an error of the position would otherwise put it on a road that it does not go.
    """
    b, table = ego.belief, lanes.table
    exact = rules.source == GIVEN and rules.offset_at_m == 0.0 and rules.offset_ct_m == 0.0
    road, before, target = table[b.lane].road, table[ego.placed].road, table[b.target_lane].road
    if not exact and routes[ego.route].road >= 0 and road != before and road != target:
        if not _planned(routes, ego.route, road):
            b.lane = _closest_by_route(ego, before, target, lanes, routes)
    ego.placed = b.lane


@jit(borrows=True)
def keep_rows(rows, egos, lanes, routes, rules):  # type: ignore[no-untyped-def]
    """:func:`keep_to_route` for the environments ``rows``."""
    for e in rows:
        keep_to_route(egos[e], lanes, routes, rules[0])
