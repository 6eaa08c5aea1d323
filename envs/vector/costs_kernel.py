"""What driving costs, by cause, over arrays: the formulas of :mod:`..costs`, which tells their reasons.

``b`` (BELIEF,) is what the ego believes, ``sc`` (SCORE,) what has been scored, ``t`` (C, SEEN) whom it perceives.
"""

from __future__ import annotations

import math

from lanebound.envs.vector.collisions_kernel import LENGTH_M, WIDTH_M
from lanebound.envs.vector.columns_kernel import (
    B_ALERT,
    B_ALERT_AGE,
    B_ALONG,
    B_ANGLE,
    B_LANE,
    B_LATERAL,
    B_PL_AT,
    B_PL_CT,
    B_SPEED,
    B_TARGET_LANE,
    B_WIDTH,
    B_X,
    B_Y,
    CAUSES,
    COS,
    F_ACCELERATE,
    F_ALERT_SHARE,
    F_BRAKE_MAX,
    F_BRAKE_MIN,
    F_COST_WEIGHTS,
    F_KEEP_LANE,
    F_META,
    F_RESPONSE_S,
    F_TTA_S,
    LANE,
    NONE,
    O_ASTRAY_NOW,
    O_CAUSES,
    O_COST,
    O_CRASHED_NOW,
    O_HMI_SHARE,
    S_CHANGE,
    S_CORRIDOR,
    S_LEAVING,
    SIN,
    SPEED,
    T_LENGTH,
    T_PL_AT,
    T_RELATIVE,
    T_SPEED,
    T_X,
    T_Y,
    X,
    Y,
    population,
)
from lanebound.envs.vector.lanes_kernel import (
    COUNT,
    JOINED_FIRST,
    JOINED_LAST,
    LENGTH,
    LIMIT,
    ROAD,
    SIDE,
    STRAIGHT,
    WIDTH,
    local,
    of_side,
    on_straight,
)
from lanebound.integrity.core.accel import jit

__all__ = ["follow_corridor", "price"]

CHANGE_S, JOINT_M, UNKNOWN_GAP_M, EXCESS_MAX_M = 8.0, 1.0, 40.0, 2.0  # of envs/costs.py
STANDING_MPS = 0.1


@jit
def follow_corridor(sc, b, lanes, figures, dt):  # type: ignore[no-untyped-def]
    """The lanes that the car may be in: its own, and during a commanded change the one that it comes from."""
    here = int(sc[S_CORRIDOR])
    table, target = lanes.table, int(b[B_TARGET_LANE])
    if not figures[F_META] > 0.0:
        target = of_side(table, int(table[target, ROAD]), int(table[here, SIDE]))
    if target != here and table[target, ROAD] == table[here, ROAD]:
        sc[S_LEAVING] = table[here, SIDE]
    sc[S_CORRIDOR] = target
    half = 0.5 * (WIDTH_M * abs(math.cos(b[B_ANGLE])) + LENGTH_M * abs(math.sin(b[B_ANGLE])))
    arrived = int(b[B_LANE]) == target and abs(b[B_LATERAL]) + half < 0.5 * b[B_WIDTH]
    changing = sc[S_LEAVING] >= 0.0 and not arrived
    sc[S_CHANGE] = max(sc[S_CHANGE] + (dt if changing else -dt), 0.0)
    if arrived or sc[S_CHANGE] > CHANGE_S:
        sc[S_LEAVING] = NONE


@jit
def _beyond(lanes, low, high, x, y):  # type: ignore[no-untyped-def]
    """How far a point is outside of the lanes from ``low`` to ``high``, negative inside; whether it is beside them."""
    table, beyond, on = lanes.table, -math.inf, False
    for end in range(2):
        lane = low if end == 0 else high
        s, r, _ = local(lanes, lane, x, y)
        on = on or -JOINT_M <= s <= table[lane, LENGTH] + JOINT_M
        beyond = max(beyond, (-r if end == 0 else r) - 0.5 * table[lane, WIDTH])
    return beyond, on


@jit
def _span(table, sc, road, whole):  # type: ignore[no-untyped-def]
    """The outermost lanes of a road that the corridor holds."""
    own = int(table[int(sc[S_CORRIDOR]), SIDE])
    left = int(sc[S_LEAVING]) if sc[S_LEAVING] >= 0.0 else own
    if whole:
        return road, road + int(table[road, COUNT]) - 1
    return of_side(table, road, min(own, left)), of_side(table, road, max(own, left))


@jit
def _overhang(c, sc, lanes, keep):  # type: ignore[no-untyped-def]
    """How far the worst corner of the true body is beyond the corridor, 0 inside."""
    table = lanes.table
    road, own = int(table[int(sc[S_CORRIDOR]), ROAD]), int(table[int(sc[S_CORRIDOR]), SIDE])
    low, high = _span(table, sc, road, not keep)
    worst = 0.0
    for corner in range(4):
        along = 0.5 * LENGTH_M * (1.0 if corner < 2 else -1.0)
        across = 0.5 * WIDTH_M * (-1.0 if corner == 0 or corner == 3 else 1.0)
        x = c[X, 0] + c[COS, 0] * along - c[SIN, 0] * across
        y = c[Y, 0] + c[SIN, 0] * along + c[COS, 0] * across
        endless, on = _beyond(lanes, low, high, x, y)
        out = endless if on else math.inf
        for k in range(int(table[road, JOINED_FIRST]), int(table[road, JOINED_LAST])):
            other = lanes.joined[k, 0]
            if keep and lanes.joined[k, 1] == 0:
                lane = of_side(table, other, own)
                beyond, on = _beyond(lanes, lane, lane, x, y)
            else:
                last = other + int(table[other, COUNT]) - 1
                beyond, on = _beyond(lanes, other, last, x, y)
            if on:
                out = min(out, beyond)
        worst = max(worst, out if out < math.inf else endless)
    return worst


@jit
def _doubt(b, sc, lanes):  # type: ignore[no-untyped-def]
    """How far beyond the corridor the estimate and its level allow the car to be, negative inside."""
    if not sc[S_LEAVING] >= 0.0:
        return abs(b[B_LATERAL]) + b[B_PL_CT] + 0.5 * WIDTH_M - 0.5 * b[B_WIDTH]
    table = lanes.table
    low, high = _span(table, sc, int(table[int(b[B_LANE]), ROAD]), False)
    _, left, _ = local(lanes, low, b[B_X], b[B_Y])
    _, right, _ = local(lanes, high, b[B_X], b[B_Y])
    beyond = -left + b[B_PL_CT] + 0.5 * WIDTH_M - 0.5 * table[low, WIDTH]
    return max(beyond, right + b[B_PL_CT] + 0.5 * WIDTH_M - 0.5 * table[high, WIDTH])


@jit
def safe_distance(ego, lead, figures):  # type: ignore[no-untyped-def]
    """Longitudinal distance that is always safe (Shalev-Shwartz et al. 2017, definition 1), 0 at least [m]."""
    v, w = max(ego, 0.0), max(lead, 0.0)
    if v < STANDING_MPS:
        return 0.0
    a, rho = figures[F_ACCELERATE], figures[F_RESPONSE_S]
    after = v + a * rho
    travel = v * rho + 0.5 * a * rho**2 + after * after / (2.0 * figures[F_BRAKE_MIN])
    return max(travel - w * w / (2.0 * figures[F_BRAKE_MAX]), 0.0)


@jit
def _lacking(gap, needed):  # type: ignore[no-untyped-def]
    return min(max(1.0 - gap / needed, 0.0), 1.0) if needed > 0.0 else 0.0


@jit
def _shortfall(c, w, lanes, figures):  # type: ignore[no-untyped-def]
    """Share of the safe distance that in truth lacks to a vehicle ahead in the lane."""
    table, lane, worst = lanes.table, w[LANE, 0], 0.0
    straight, half = table[lane, STRAIGHT] > 0.0, 0.5 * table[lane, WIDTH]
    place, _, _ = local(lanes, lane, c[X, 0], c[Y, 0])
    for i in range(1, population(w)):
        x, y = c[X, i], c[Y, i]
        s, r = on_straight(table, lane, x, y) if straight else local(lanes, lane, x, y)[:2]
        if (s > place) & (abs(r) <= half):
            needed = safe_distance(c[SPEED, 0], c[SPEED, i], figures)
            worst = max(worst, _lacking(s - place - LENGTH_M, needed))
    return worst


@jit
def _headway(b, c, w, t, count, lanes, figures):  # type: ignore[no-untyped-def]
    """Share of the safe distance that lacks: by what is believed of the nearest ahead, or in truth if that is worse."""
    truly = _shortfall(c, w, lanes, figures)
    table, lane, gap, lead = lanes.table, int(b[B_LANE]), math.inf, -1
    straight, half = table[lane, STRAIGHT] > 0.0, 0.5 * b[B_WIDTH]
    for i in range(count):
        x, y = t[i, T_X], t[i, T_Y]
        s, r = on_straight(table, lane, x, y) if straight else local(lanes, lane, x, y)[:2]
        ahead = s - b[B_ALONG]
        distance = ahead - 0.5 * (LENGTH_M + t[i, T_LENGTH])
        if (ahead > 0.0) & (abs(r) <= half) & (distance < gap):
            gap, lead = distance, i
    if lead < 0:
        return 1.0 if truly > 0.0 else 0.0
    bound = t[lead, T_PL_AT] + (0.0 if t[lead, T_RELATIVE] > 0.0 else b[B_PL_AT])
    gap -= min(bound, UNKNOWN_GAP_M)
    return max(truly, _lacking(gap, safe_distance(b[B_SPEED], t[lead, T_SPEED], figures)))


@jit
def price(b, sc, c, w, t, count, lanes, figures, dt, out):  # type: ignore[no-untyped-def]
    """Fill the costs of a step by cause, and their weighted sum; ``out`` holds the verdict already."""
    keep, speed = figures[F_KEEP_LANE] > 0.0, abs(c[SPEED, 0])
    beyond = min(max(_overhang(c, sc, lanes, keep), 0.0), EXCESS_MAX_M)
    doubt = min(max(_doubt(b, sc, lanes), 0.0), EXCESS_MAX_M) if keep else 0.0
    late = b[B_ALERT] > 0.0 and b[B_ALERT_AGE] > figures[F_TTA_S]
    limit = lanes.table[int(b[B_LANE]), LIMIT]
    fast = limit > 0.0 and speed > figures[F_ALERT_SHARE] * limit
    out[O_CAUSES] = out[O_CRASHED_NOW]
    out[O_CAUSES + 1] = out[O_ASTRAY_NOW]
    out[O_CAUSES + 2] = beyond * speed * dt
    out[O_CAUSES + 3] = doubt * speed * dt
    out[O_CAUSES + 4] = _headway(b, c, w, t, count, lanes, figures) * dt
    out[O_CAUSES + 5] = dt if late and (fast or sc[S_LEAVING] >= 0.0) else 0.0
    out[O_CAUSES + 6] = out[O_HMI_SHARE] * dt
    total = 0.0
    for k in range(CAUSES):
        total += figures[F_COST_WEIGHTS + k] * out[O_CAUSES + k]
    out[O_COST] = total
