"""Conflicts where courses cross: how soon the second of two vehicles is where the first one is, or just was.

Two vehicles go on along their lanes, at their speeds. Let the body of the ego at time a and that of the other vehicle
at time b overlap (now: 0). Both are there from ``max(a, b)`` on, so the least of it over all such pairs is the time T2
at which the second one arrives at the conflict area (Laureshyn, de Ceunynck et al., Accid. Anal. Prev. 98, 46-56,
2017). On a collision course it is the time to collision; when the first one leaves it is the post-encroachment time.
Times down to the last decision count as well, ``max(a, b) - min(a, b, 0)``, so that an encroachment between two
decisions is not missed.

Courses cross where the headings differ by more than 30 degrees (SSAM, FHWA-HRT-08-051: less is lane change or
rear-end); those are conflicts of headway.

To let a vehicle pass whose course crosses soon is a right reason to stop, :func:`must_give_way`.
"""

from __future__ import annotations

import math

from lanebound.envs.batch.lanes_kernel import heading_at, local, place
from lanebound.integrity.core.accel import jit

__all__ = ["CROSSING_COS", "must_give_way", "second_arrival_s"]

STEP_S = 0.1
GIVE_WAY_S = 7.1  # gap that half of the drivers take for a left turn from a minor road; HCM 2010, exhibit 19-10
GIVE_WAY_M = 30.0  # before the conflict; a car stops from 10 m/s in 25 m
CROSSING_COS = math.cos(math.radians(30.0))


@jit(inline=True)
def _onward(cars, lanes, i):  # type: ignore[no-untyped-def]
    """The lane that a vehicle goes on to, by its route or as the only one; NONE without one."""
    return cars[i].onward if cars[i].onward >= 0 else lanes.table[cars[i].lane].onward


@jit(borrows=True)
def _may_cross(cars, lanes, i):  # type: ignore[no-untyped-def]
    """Whether other lanes cross that of a vehicle, or the one that it goes on to."""
    onward = _onward(cars, lanes, i)
    return lanes.table[cars[i].lane].crossed != 0 or (onward >= 0 and lanes.table[onward].crossed != 0)


@jit(borrows=True)
def _pose(cars, lanes, i, s, r):  # type: ignore[no-untyped-def]
    """Middle and direction of a vehicle at a station of its lane, or of the next one past its end, at an offset."""
    n, onward = cars[i].lane, _onward(cars, lanes, i)
    length = lanes.table[n].length_m
    if s > length and onward >= 0:
        n, s = onward, s - length
    x, y = place(lanes, n, s, r)
    return x, y, heading_at(lanes, n, s)


@jit(borrows=True)
def _apart(dx, dy, nx, ny, cars, i, angle, other):  # type: ignore[no-untyped-def]
    """Whether the shadows of two bodies on a unit normal do not meet; ``angle`` and ``other``: their headings."""
    reach = 0.5 * cars[0].length * abs(nx * math.cos(angle) + ny * math.sin(angle))
    reach += 0.5 * cars[0].width * abs(ny * math.cos(angle) - nx * math.sin(angle))
    reach += 0.5 * cars[i].length * abs(nx * math.cos(other) + ny * math.sin(other))
    reach += 0.5 * cars[i].width * abs(ny * math.cos(other) - nx * math.sin(other))
    return abs(nx * dx + ny * dy) > reach


@jit(borrows=True)
def _overlap(cars, i, own, theirs):  # type: ignore[no-untyped-def]
    """Whether the bodies of the ego and of vehicle i meet at an angle; poses (x, y, heading)."""
    dx, dy, angle, other = theirs[0] - own[0], theirs[1] - own[1], own[2], theirs[2]
    square = (cars[0].length + cars[i].length) ** 2 + (cars[0].width + cars[i].width) ** 2
    if 4.0 * (dx * dx + dy * dy) > square or math.cos(other - angle) > CROSSING_COS:
        return False
    for side in range(4):
        heading = (angle if side < 2 else other) + 0.5 * math.pi * (side % 2)
        if _apart(dx, dy, math.cos(heading), math.sin(heading), cars, i, angle, other):
            return False
    return True


@jit(borrows=True)
def _least_s(cars, lanes, i, own, theirs, past_s, least):  # type: ignore[no-untyped-def]
    """T2 with vehicle i, ``least`` at most; own and theirs: station and offset on their lanes now."""
    first, last = -math.ceil(past_s / STEP_S), math.ceil(least / STEP_S)
    for m in range(first, last):
        a = m * STEP_S
        pose = _pose(cars, lanes, 0, own[0] + cars[0].speed * a, own[1])
        for k in range(first, last):
            b = k * STEP_S
            later = max(a, b) - min(a, b, 0.0)
            station = theirs[0] + cars[i].speed * b
            if later < least and _overlap(cars, i, pose, _pose(cars, lanes, i, station, theirs[1])):
                least = later
    return least


@jit(borrows=True)
def second_arrival_s(cars, lanes, horizon_s, past_s):  # type: ignore[no-untyped-def]
    """The least T2 of the true ego with another vehicle that drives, ``horizon_s`` at most.

    ``past_s``: time since the last decision.
    """
    least = horizon_s
    if not _may_cross(cars, lanes, 0):
        return least
    own = local(lanes, cars[0].lane, cars[0].x, cars[0].y)
    for i in range(1, cars.shape[0]):
        reach = horizon_s * (abs(cars[0].speed) + abs(cars[i].speed)) + cars[0].length + cars[i].length
        near = math.hypot(cars[i].x - cars[0].x, cars[i].y - cars[0].y) < reach
        if near and cars[i].crashed == 0 and _may_cross(cars, lanes, i):
            theirs = local(lanes, cars[i].lane, cars[i].x, cars[i].y)
            least = _least_s(cars, lanes, i, own, theirs, past_s, least)
    return least


@jit(borrows=True)
def must_give_way(cars, lanes):  # type: ignore[no-untyped-def]
    """Whether another vehicle that drives crosses the next ``GIVE_WAY_M`` of the true ego's way in ``GIVE_WAY_S``.

    Poses of the ego are a length apart, those of others a quarter of a second at the speed of the moment. A vehicle
    that stands counts where its body is on the ego's way.
    """
    if not _may_cross(cars, lanes, 0):
        return False
    s, r, _ = local(lanes, cars[0].lane, cars[0].x, cars[0].y)
    for i in range(1, cars.shape[0]):
        reach = GIVE_WAY_M + GIVE_WAY_S * abs(cars[i].speed) + cars[0].length + cars[i].length
        near = math.hypot(cars[i].x - cars[0].x, cars[i].y - cars[0].y) < reach
        if near and cars[i].crashed == 0 and _may_cross(cars, lanes, i) and _crosses_way(cars, lanes, i, s, r):
            return True
    return False


@jit(borrows=True)
def _crosses_way(cars, lanes, i, s, r):  # type: ignore[no-untyped-def]
    """Whether vehicle i will be on the way of the ego, which is at station s and offset r of its lane."""
    start, aside, _ = local(lanes, cars[i].lane, cars[i].x, cars[i].y)
    for k in range(math.ceil(4.0 * GIVE_WAY_S)):
        theirs = _pose(cars, lanes, i, start + 0.25 * k * cars[i].speed, aside)
        for m in range(math.ceil(GIVE_WAY_M / cars[0].length)):
            if _overlap(cars, i, _pose(cars, lanes, 0, s + m * cars[0].length, r), theirs):
                return True
    return False
