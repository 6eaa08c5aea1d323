"""Alert limits from a budget: how far the believed position may be off until the next decision.

Symbols: w width of the lane, W and L width and length of the car, psi its heading less the lane's, d its offset from
the middle of the lane, v its speed, T time between decisions, kappa curvature of the route; d, psi and v are believed.

Across, ``AL_CT = room - kappa (AL_AT + L / 2)^2 / 2`` with

    room = min(w / 2 - |d|, w / 2 - tracking) - (W |cos psi| + L |sin psi|) / 2 - v T |sin psi|

The last term, for a car that moves away from the middle, is what it covers until the next decision. During a commanded
change the room is that to the edges of both lanes; without a lane to keep, of the road. ``kappa (AL_AT + L / 2)^2 / 2``
is how far a corner stands out of a bend when the car is AL_AT ahead of its belief or behind it, on the tangent; with
AL_AT = 0 it is that of the body alone, as in the box of Reid et al. 2019 (arXiv 1906.01061, section III). kappa is the
largest of the stretch that the body may touch until the next decision, AL_AT to both sides.

Along, AL_AT is the least of what applies:

``max(sqrt(2 (stand + bend_share (room - stand)) / kappa) - L / 2, u)``  for each bend: where that term takes what the
body alone takes, ``stand = kappa L^2 / 8``, and a share of the rest; u is how far away the bend is.
``crossing``  where the route crosses other roads, or its lane ends (S2 5.3: 1.5 m, half of a lane of 3 m).
``gap - PL - v (response + T) - max(v^2 - v_lead^2, 0) / (2 b)``  behind a vehicle that is perceived by radio, PL its
level: what reaction and braking to its speed leave of the gap (S1: positions are to avoid collisions). A vehicle beside
counts while the levels of both leave open who is ahead. A sensor measures the gap itself; it has no part of the
position.
``distance - v (response + T) - v^2 / (2 b)``  before the start of a closure that is known on the lane.

The bound of the map's error is in the levels already. Both limits stay between ``least`` and ``most``: where less than
``least`` is left it is not the position that makes driving unsafe. Errors of the heading, vehicles beside the car and
reversing have no part in the budget.

The same terms give the speed that a level permits, :func:`permitted_mps`. A level above the limit at rest would permit
no speed at all, as on straight lanes no term across depends on the speed; so levels count by what they sweep.
"""

from __future__ import annotations

import math

from lanebound.envs.batch.closure_kernel import left_along_m
from lanebound.envs.batch.costs_kernel import UNKNOWN_GAP_M, doubt_m
from lanebound.envs.batch.lanes_kernel import local
from lanebound.envs.batch.route_map_kernel import path_at
from lanebound.integrity.core.accel import jit

__all__ = ["budget_limits", "permitted_mps"]

STEP_M = 2.5  # between the points at which curvature is read, half of a car
STRAIGHT_PM = 1e-6
HALVINGS = 10  # of the limit in the search for a permitted speed: 0.03 m/s of 30 m/s


@jit(inline=True)
def _from(b, station, sweep, length):  # type: ignore[no-untyped-def]
    """How far a station is from what the body covers until the next decision, 0 within."""
    behind = b.longitudinal_m - 0.5 * length - station
    return max(behind, station - b.longitudinal_m - sweep - 0.5 * length, 0.0)


@jit(borrows=True)
def _bends_m(b, car, sweep, room, lanes, routes, rules):  # type: ignore[no-untyped-def]
    """Limit along in the bends of the route, and the largest curvature [1/m] that the body touches within it."""
    f, length = rules.budget, car.length
    first = b.longitudinal_m - f.most_m - 0.5 * length
    count = 2 + int((2.0 * f.most_m + sweep + length) / STEP_M)
    along, most = f.most_m, 0.0
    for n in range(count):
        station = first + n * STEP_M
        curvature = abs(path_at(routes, lanes, b.path, station)[3])
        if curvature >= STRAIGHT_PM:
            stand = 0.125 * curvature * length * length
            spent = stand + f.bend_share * max(room - stand, 0.0)
            least = math.sqrt(2.0 * spent / curvature) - 0.5 * length
            along = min(along, max(least, _from(b, station, sweep, length)))
    for n in range(count):
        station = first + n * STEP_M
        if _from(b, station, sweep, length) <= along:
            most = max(most, abs(path_at(routes, lanes, b.path, station)[3]))
    return along, most


@jit(borrows=True)
def _is_placed(b, sweep, lanes, routes, rules):  # type: ignore[no-untyped-def]
    """Whether the route crosses other roads nearby, or its lane ends."""
    path, f, begin = routes.paths[b.path], rules.budget, -math.inf
    low, high = b.longitudinal_m - f.most_m, b.longitudinal_m + sweep + f.most_m
    placed = path.lane_end_m <= high
    for k in range(path.first, path.last + 1):
        piece = routes.pieces[k]
        if begin <= high and piece.end_m >= low:
            placed = placed or lanes.table[piece.lane].crossed != 0
        begin = piece.end_m
    return placed


@jit(borrows=True)
def _room_m(b, sc, car, sweep, lanes, rules):  # type: ignore[no-untyped-def]
    """Room across, from the body to the edges of what it may drive on."""
    half = 0.5 * (car.width * abs(math.cos(b.angle_rad)) + car.length * abs(math.sin(b.angle_rad)))
    whole = rules.keep_lane == 0
    room = -doubt_m(b, sc, 0.0, half, lanes, whole)
    if sc.leaving_side < 0 and not whole:
        outwards = sweep * abs(math.sin(b.angle_rad)) if b.lateral_m * b.angle_rad > 0.0 else 0.0
        room = min(room - outwards, 0.5 * b.lane_width_m - rules.budget.tracking_m - half)
    return max(room, 0.0)


@jit(borrows=True)
def _behind_m(b, v, seen, count, length, lanes, rules):  # type: ignore[no-untyped-def]
    """What reaction and braking from a speed v leave of the gaps to leaders with a radio, infinite without one."""
    c, least = rules.costs, math.inf
    for i in range(count):
        other = seen[i]
        s, r, _ = local(lanes, b.lane, other.x_m, other.y_m)
        ahead, level = s - b.longitudinal_m, min(other.pl_at_m, UNKNOWN_GAP_M)
        if (
            other.relative == 0
            and abs(r) <= 0.5 * b.lane_width_m
            and ahead + level + min(b.pl_at_m, UNKNOWN_GAP_M) > 0.0
        ):
            w = max(other.speed_mps * math.cos(other.heading_rad - b.heading_rad), 0.0)
            needed = v * (c.response_s + rules.policy_s) + max(v * v - w * w, 0.0) / (2.0 * c.brake_min_mps2)
            least = min(least, ahead - 0.5 * (length + other.length_m) - level - needed)
    return least


@jit(borrows=True)
def budget_limits(b, speed, sc, car, seen, count, lanes, routes, rules):  # type: ignore[no-untyped-def]
    """Alert limits (along, across) [m] of an ego at a speed, until its next decision; of ``car`` only its size is read.

    A speed below 0 counts as 0.
    """
    f, v = rules.budget, max(speed, 0.0)
    sweep = v * rules.policy_s
    room = _room_m(b, sc, car, sweep, lanes, rules)
    along, curvature = _bends_m(b, car, sweep, room, lanes, routes, rules)
    along = min(along, _behind_m(b, v, seen, count, car.length, lanes, rules), left_along_m(b, v, car.length, rules))
    if _is_placed(b, sweep, lanes, routes, rules):
        along = min(along, f.crossing_m)
    along = max(along, f.least_m)
    corner = along + 0.5 * car.length
    across = min(max(room - 0.5 * curvature * corner * corner, f.least_m), f.most_m)
    return along, across


@jit(borrows=True)
def permitted_mps(b, sc, car, seen, count, lanes, routes, rules):  # type: ignore[no-untyped-def]
    """The largest speed at which what the levels sweep keeps to the limits: the limit of the lane without an alert.

    ``v PL <= c v_limit AL(v)`` on both axes, c = ``alert_speed_share`` and AL(v) the limits at that speed, of the
    budget or fixed. It is c of the limit at most, also where levels are small: after a failed test they do not bound
    the error. It is ``alert_speed_least`` of the limit at least (or c, if that is less), also without a level: a level
    that is lost between buildings does not come back for a car that stands there. inf on a lane without a limit.
    """
    limit = lanes.table[b.lane].speed_limit_mps
    if limit <= 0.0:
        return math.inf
    if b.alert == 0:
        return limit
    c = rules.costs
    low, high = min(c.alert_speed_least, c.alert_speed_share) * limit, c.alert_speed_share * limit
    if _keeps(b, high, limit, sc, car, seen, count, lanes, routes, rules):
        return high
    for _ in range(HALVINGS):
        v = 0.5 * (low + high)
        if _keeps(b, v, limit, sc, car, seen, count, lanes, routes, rules):
            low = v
        else:
            high = v
    return low


@jit(borrows=True)
def _keeps(b, v, limit, sc, car, seen, count, lanes, routes, rules):  # type: ignore[no-untyped-def]
    """Whether the levels, swept at a speed, keep to the alert limits at that speed."""
    along, across = b.al_at_m, b.al_ct_m
    if rules.budgets != 0:
        along, across = budget_limits(b, v, sc, car, seen, count, lanes, routes, rules)
    swept = v / (rules.costs.alert_speed_share * limit) if rules.costs.alert_speed_share > 0.0 else math.inf
    return swept * b.pl_at_m <= along and swept * b.pl_ct_m <= across
