"""A lane that closes for an episode: its message, where the car believes it to be, and what it leaves of the speed.

A roadside unit at the start of the closure sends the lane, the start, the end and the limit in coordinates of the map,
by the channel of :mod:`.perception_kernel`: a message over the distance d arrives in time with ``P = share (1 - (d /
range)^4)``. The first that arrives tells all, so one draw u an episode decides which it is: the first after which the
probability that none has arrived, the product of all ``1 - P``, is u at most. Truth enters as the distance alone.

Where the closure begins for the car follows from its believed pose: it is wrong by the error along the track, and on
which side it is by the error across.
"""

from __future__ import annotations

import math

from lanebound.envs.batch.lanes_kernel import local
from lanebound.integrity.core.accel import jit

__all__ = ["NOT_BESIDE", "closed_ahead", "left_along_m", "place_closure", "receive"]

ROUNDING = 1e-9
NOT_BESIDE = 99  # number of the closed lane less that of the car's, where no closure is known


@jit(borrows=True)
def receive(closure, car, radio, time):  # type: ignore[no-untyped-def]
    """One epoch of the message to a car; ``time`` since the start of the episode, radio: RADIO."""
    if closure.there == 0 or closure.known != 0:
        return
    if closure.due_s == math.inf:
        sent = math.floor(time * radio.rate_hz + ROUNDING)
        sent -= math.floor((time - radio.epoch_s) * radio.rate_hz + ROUNDING)
        x, y = (car.x - closure.start_x_m) / radio.range_m, (car.y - closure.start_y_m) / radio.range_m
        fade = min(x * x + y * y, 1.0)
        for _ in range(int(sent)):
            closure.missed *= 1.0 - closure.share * (1.0 - fade * fade)
        if closure.missed <= closure.luck:
            closure.due_s = time + closure.delay_s
    if time >= closure.due_s - ROUNDING:
        closure.known = 1


@jit(borrows=True)
def place_closure(closure, b, lanes):  # type: ignore[no-untyped-def]
    """Where a closure that is known lies from the believed pose, into the belief."""
    b.closure, b.closure_side = 0, NOT_BESIDE
    b.closure_start_m = b.closure_end_m = b.closure_limit_mps = math.inf
    lane = lanes.table[b.lane]
    if closure.known != 0 and lane.road == closure.road:
        start, _, _ = local(lanes, b.lane, closure.start_x_m, closure.start_y_m)
        end, _, _ = local(lanes, b.lane, closure.end_x_m, closure.end_y_m)
        b.closure, b.closure_side = 1, closure.side - lane.side
        b.closure_start_m, b.closure_end_m = start - b.longitudinal_m, end - b.longitudinal_m
        b.closure_limit_mps = closure.limit_mps


@jit(inline=True)
def left_along_m(b, v, length, rules):  # type: ignore[no-untyped-def]
    """Limit along before a closed lane, as behind a vehicle that stands there; inf where none is known on the lane."""
    along, c = math.inf, rules.costs
    if b.closure != 0 and b.closure_side == 0 and b.closure_end_m > -0.5 * length:
        needed = v * (c.response_s + rules.policy_s) + v * v / (2.0 * c.brake_min_mps2)
        along = b.closure_start_m - 0.5 * length - needed
    return along


@jit(borrows=True)
def closed_ahead(closure, car, lanes, limit):  # type: ignore[no-untyped-def]
    """Limit where the TRUE car is, and the road between its front and a closure ahead on its lane, inf without one."""
    room, lane = math.inf, lanes.table[car.lane]
    if closure.there != 0 and lane.road == closure.road:
        place, _, _ = local(lanes, car.lane, car.x, car.y)
        start, _, _ = local(lanes, car.lane, closure.start_x_m, closure.start_y_m)
        end, _, _ = local(lanes, car.lane, closure.end_x_m, closure.end_y_m)
        if start <= place <= end:
            limit = min(limit, closure.limit_mps)
        if lane.side == closure.side and place < end:
            room = max(start - place - 0.5 * car.length, 0.0)
    return limit, room
