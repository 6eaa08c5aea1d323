"""Alert limits from a budget: how far the believed position may be off until the next decision.

Symbols: w width of the lane, W and L width and length of the car, psi its heading less the lane's, d its offset from
the middle of the lane, v its speed, kappa the largest curvature of the route from the car to where it is at the next
decision, the limit along farther, T time between decisions; d, psi and v are believed.

Across, ``AL_CT = room - kappa (AL_AT + L / 2)^2 / 2`` with

    room = min(w / 2 - |d|, w / 2 - tracking) - (W |cos psi| + L |sin psi|) / 2

During a commanded change the room is that to the edges of both lanes; without a lane to keep, of the road. The other
term is how far a corner stands out of a bend when the car is AL_AT ahead of its belief or behind it, on the tangent;
with AL_AT = 0 it is that of the body alone, as in the box of Reid et al. 2019 (arXiv 1906.01061, section III).

Along, AL_AT is the least of what applies:

``sqrt(2 (stand + bend_share (room - stand)) / kappa) - L / 2``  where that term takes what the body alone takes,
``stand = kappa L^2 / 8``, and a share of the rest.
``crossing``  where the route crosses other roads, or its lane ends (S2 5.3: 1.5 m, half of a lane of 3 m).
``gap - PL - v (response + T) - max(v^2 - v_lead^2, 0) / (2 b)``  behind a vehicle that is perceived by radio, PL its
level: what reaction and braking to its speed leave of the gap (S1: positions are to avoid collisions). A sensor
measures the gap itself; its bounds have no part of the position.
The bound of the map's error is in the levels already. Both limits stay between ``least`` and ``most``.
"""

from __future__ import annotations

import math

from lanebound.envs.batch.costs_kernel import UNKNOWN_GAP_M, doubt_m, lead_of
from lanebound.envs.batch.route_map_kernel import path_at
from lanebound.integrity.core.accel import jit

__all__ = ["budget_limits"]

STEP_M = 2.5  # between the points at which curvature is read, half of a car
STRAIGHT_PM = 1e-6


@jit(borrows=True)
def _ahead(b, lanes, routes, reach):  # type: ignore[no-untyped-def]
    """Largest curvature [1/m] of the route from half a car behind on; whether it crosses other roads or ends."""
    path, most = routes.paths[b.path], 0.0
    station = b.longitudinal_m - STEP_M
    while station <= b.longitudinal_m + reach:
        most = max(most, abs(path_at(routes, lanes, b.path, station)[3]))
        station += STEP_M
    crossed, begin = False, -math.inf
    for k in range(path.first, path.last + 1):
        piece = routes.pieces[k]
        if begin <= b.longitudinal_m + reach and piece.end_m >= b.longitudinal_m - STEP_M:
            crossed = crossed or lanes.table[piece.lane].crossed != 0
        begin = piece.end_m
    return most, crossed or path.lane_end_m - b.longitudinal_m <= reach


@jit(borrows=True)
def _room_m(b, sc, car, lanes, rules):  # type: ignore[no-untyped-def]
    """Room across, from the body to the edges of what it may drive on."""
    half = 0.5 * (car.width * abs(math.cos(b.angle_rad)) + car.length * abs(math.sin(b.angle_rad)))
    whole = rules.keep_lane == 0
    room = -doubt_m(b, sc, 0.0, half, lanes, whole)
    if sc.leaving_side < 0 and not whole:
        room = min(room, 0.5 * b.lane_width_m - rules.budget.tracking_m - half)
    return max(room, 0.0)


@jit(borrows=True)
def _behind_m(b, seen, count, length, lanes, rules):  # type: ignore[no-untyped-def]
    """What reaction and braking leave of the gap to a leader with a radio, infinite without one."""
    lead, gap = lead_of(b, seen, count, length, lanes)
    if lead < 0 or seen[lead].relative != 0:
        return math.inf
    c, v, w = rules.costs, max(b.speed_mps, 0.0), max(seen[lead].speed_mps, 0.0)
    needed = v * (c.response_s + rules.policy_s) + max(v * v - w * w, 0.0) / (2.0 * c.brake_min_mps2)
    return gap - min(seen[lead].pl_at_m, UNKNOWN_GAP_M) - needed


@jit(borrows=True)
def budget_limits(b, sc, car, seen, count, lanes, routes, rules):  # type: ignore[no-untyped-def]
    """Alert limits (along, across) [m] of an ego until its next decision; of the true ``car`` only its size is read."""
    f = rules.budget
    reach = max(b.speed_mps, 0.0) * rules.policy_s + f.most_m
    curvature, placed = _ahead(b, lanes, routes, reach)
    room = _room_m(b, sc, car, lanes, rules)
    along = min(f.most_m, _behind_m(b, seen, count, car.length, lanes, rules))
    if curvature >= STRAIGHT_PM:
        stand = 0.125 * curvature * car.length**2
        spent = stand + f.bend_share * max(room - stand, 0.0)
        along = min(along, math.sqrt(2.0 * spent / curvature) - 0.5 * car.length)
    if placed:
        along = min(along, f.crossing_m)
    along = max(along, f.least_m)
    corner = along + 0.5 * car.length
    across = min(max(room - 0.5 * curvature * corner * corner, f.least_m), f.most_m)
    return along, across
