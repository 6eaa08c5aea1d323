"""Truth against belief at the end of a policy step: errors, misleading information, ends of an episode, rewards, costs.

Terms of the reward, of the TRUE car; v speed, psi heading less the lane's, d offset from its middle, dt policy step:

``progress``  ``v cos(psi) / v_limit dt`` between -dt and dt: reversing takes back, speeding earns nothing.
``lane_centre``  ``progress / (1 + (d / 0.5 m)^2)``, 0 at least: nothing for standing in the middle.
``comfort``  ``-min(1, (|a| / 2 m/s2)^2) dt``, a the acceleration along and across.
``collision``  1 in the step of a crash. ``base``  the wrapped world's own reward.
``toll``  1 where a geo-object is settled with a right claim (:mod:`.toll_kernel`).

An episode is a success if at its end the TRUE car is unharmed, on the road, in the direction of its lane, at the goal
of a world that has one, and in time: its way is at least a share of the way that limit, bends and the vehicle ahead
allowed, and it is no more than ``behind_s`` behind a car at that share, to which no lead adds.
"""

from __future__ import annotations

import math

from lanebound.envs.batch.closure_kernel import closed_ahead
from lanebound.envs.batch.costs_kernel import price
from lanebound.envs.batch.lane_sensor_kernel import beside_m
from lanebound.envs.batch.lanes_kernel import CIRCLE, STRAIGHT, advised, ends, local, straight, width_at
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import ROUNDING_M, remainder, wrap

__all__ = ["count_epoch", "score"]

CREEP_MPS = 0.5  # driving backwards more slowly is no wrong way
CENTRE_SCALE_M = 0.5  # offset at which the credit for the middle of the lane is halved
COMFORT_MPS2 = 2.0  # ISO 2631-1: uncomfortable from 1.25 to 2.5 m/s2
BESIDE_M = 1.0  # of the pavement, from which a car is on another road; more than what a map is wrong by
FOLLOWING_S = 4.0  # a vehicle nearer than so long at the limit is followed; twice the usual time gap


@jit(inline=True)
def _flag(condition):  # type: ignore[no-untyped-def]
    """1.0 or 0.0."""
    return 1.0 if condition else 0.0


@jit(borrows=True)
def _errors(b, car):  # type: ignore[no-untyped-def]
    """The navigator's position less truth along and across the true heading, forward and right positive."""
    dx, dy, cosine, sine = b.fix_x_m - car.x, b.fix_y_m - car.y, math.cos(car.heading), math.sin(car.heading)
    return cosine * dx + sine * dy, cosine * dy - sine * dx


@jit(borrows=True)
def count_epoch(b, sc, car):  # type: ignore[no-untyped-def]
    """Count a navigation epoch: misleading is an available estimate whose error exceeds its level on an axis.

    Hazardously so where it exceeds the alert limit (S3 II.C); an epoch that is hazardous on one axis is no more than
    that. An error beyond its level or limit by no more than rounding equals it, as under ``navigation.source=offset``.
    """
    at, ct = _errors(b, car)
    mi = hmi = False
    for axis in range(2):
        error = (abs(at) if axis == 0 else abs(ct)) - ROUNDING_M
        level = b.pl_at_m if axis == 0 else b.pl_ct_m
        limit = b.al_at_m if axis == 0 else b.al_ct_m
        if b.available != 0 and level <= limit:
            hmi = hmi or error > limit
            mi = mi or level < error <= limit
    sc.epochs += 1
    if hmi:
        sc.hmi += 1
    elif mi:
        sc.mi += 1


@jit(borrows=True)
def _allowed_mps(cars, lanes, limit):  # type: ignore[no-untyped-def]
    """Speed that the limit, the bend (``sqrt(a R)`` at a comfortable a) and the vehicle ahead allow, of the TRUE car.

    A vehicle in the lane counts that is nearer than ``FOLLOWING_S`` at the limit, with its own speed. With a wreck as
    near as that none counts: to wait behind it is no success. -> that speed, and the speed of the flow, for which a
    wreck counts as well, and the end of the lane, before which a car stops in comfort.
    """
    n, allowed, nearest, wreck = cars[0].lane, limit, FOLLOWING_S * limit, False
    lane = lanes.table[n]
    place, _, _ = local(lanes, n, cars[0].x, cars[0].y)
    if lane.advice_last > lane.advice_first:
        allowed = min(allowed, advised(lanes, n, place))
    elif lane.kind == CIRCLE:
        allowed = min(allowed, math.sqrt(COMFORT_MPS2 * lane.radius_m))
    half, flat, leader, near = 0.5 * width_at(lanes, n, place), lane.kind == STRAIGHT, allowed, nearest
    for i in range(1, cars.shape[0]):
        s, r = straight(lane, cars[i].x, cars[i].y) if flat else local(lanes, n, cars[i].x, cars[i].y)[:2]
        ahead = (s > place) & (abs(r) <= half)
        wreck |= ahead & (s - place < near) & (cars[i].crashed != 0)
        if ahead & (s - place < nearest):
            nearest, leader = s - place, max(cars[i].speed, 0.0)
    flow = min(allowed, leader)
    if ends(lanes, n):
        flow = min(flow, math.sqrt(2.0 * COMFORT_MPS2 * max(lane.length_m - place, 0.0)))
    return (allowed if wreck else min(allowed, leader)), flow


@jit(borrows=True)
def score(b, body, sc, cars, seen, count, lanes, facts, closure, rules, start, out):  # type: ignore[no-untyped-def]
    """The verdict on a step, or at a start, where no time has passed: fills ``out`` and remembers in ``sc``.

    ``body``: the belief, or the pose of a lane sensor; ``seen``, ``count``: the vehicles that the ego perceives;
    ``facts``: ends and reward of the wrapped world; ``closure``: of a lane. The corridor is up to date.
    """
    policy, speed = rules.policy_s, cars[0].speed
    dt = 0.0 if start else policy
    lane = lanes.table[cars[0].lane]
    limit = lane.speed_limit_mps if lane.speed_limit_mps > 0.0 else rules.max_speed_mps
    limit, room = closed_ahead(closure, cars[0], lanes, limit)
    _s, r, direction = local(lanes, cars[0].lane, cars[0].x, cars[0].y)
    angle = wrap(cars[0].heading - direction)
    along, against = speed * math.cos(angle), abs(angle) > 0.5 * math.pi
    flow = 0.0
    if start:
        sc.heading_rad, sc.speed_mps = cars[0].heading, speed
    else:
        allowed, flow = _allowed_mps(cars, lanes, limit)
        flow = min(flow, math.sqrt(2.0 * COMFORT_MPS2 * room))
        sc.progress_m += along * policy
        sc.allowed_m += allowed * policy
        sc.behind_m = max(sc.behind_m + (rules.success_share * allowed - along) * policy, 0.0)
        backwards = along < -CREEP_MPS or against
        sc.against_s = sc.against_s + policy if backwards else 0.0
    out.yaw_rate_radps = remainder(cars[0].heading - sc.heading_rad) / policy
    sc.heading_rad = cars[0].heading
    _judge(b, sc, cars[0], facts, against, limit, lanes, rules, out)
    price(b, body, sc, cars, seen, count, lanes, rules, dt, along, limit, flow, out)
    rough = math.hypot((speed - sc.speed_mps) / policy, speed * out.yaw_rate_radps) / COMFORT_MPS2
    sc.speed_mps = speed
    progress, w = min(max(along / limit, -1.0), 1.0) * dt, rules.rewards
    out.progress = progress
    out.lane_centre = max(progress, 0.0) / (1.0 + (r / CENTRE_SCALE_M) ** 2)
    out.comfort = -min(rough * rough, 1.0) * dt
    out.collision = out.crashed_now
    out.base = facts.base
    total = w.progress * out.progress + w.lane_centre * out.lane_centre + w.comfort * out.comfort
    out.reward = total + w.collision * out.collision + w.base * out.base + w.toll * out.toll
    _repeat(b, speed, rules, out)


@jit(borrows=True)
def _is_elsewhere(lanes, road, car):  # type: ignore[no-untyped-def]
    """Whether the true car is on another road than ``road``, not one that follows or leads there, and beside it."""
    own = lanes.table[car.lane].road
    for k in range(lanes.table[road].joint_first, lanes.table[road].joint_last):
        if lanes.joints[k].road == own:
            return False
    return own != road and beside_m(lanes, road, car.x, car.y) > BESIDE_M


@jit(inline=True)
def _judge(b, sc, car, facts, against, limit, lanes, rules, out):  # type: ignore[no-untyped-def]
    """What truth says of the step."""
    crashed, on_road = car.crashed != 0, facts.on_road != 0
    over = facts.terminated != 0 or facts.truncated != 0
    out.crashed_now = _flag(crashed and sc.crashed == 0)
    sc.crashed = 1 if crashed or sc.crashed != 0 else 0
    off_road = rules.off_road_ends != 0 and not on_road
    wrong_way = sc.against_s > rules.wrong_way_s
    astray = off_road or wrong_way or (over and against)
    out.astray_now = _flag(astray and sc.astray == 0)
    sc.astray = 1 if astray or sc.astray != 0 else 0
    good = over and on_road and facts.arrived != 0 and not (sc.crashed != 0 or against)
    late = sc.behind_m > rules.behind_s * rules.success_share * limit
    out.err_at_m, out.err_ct_m = _errors(b, car)
    out.mi, out.hmi = _flag(sc.mi > 0), _flag(sc.hmi > 0)
    out.hmi_share = sc.hmi / max(sc.epochs, 1)
    sc.epochs = sc.mi = sc.hmi = 0
    out.crashed, out.off_road, out.wrong_way = _flag(sc.crashed != 0), _flag(off_road), _flag(wrong_way)
    out.is_success = _flag(good and not late and sc.progress_m >= rules.success_share * sc.allowed_m)
    lost = lanes.table[car.lane].lost != 0
    out.lost, out.lost_now = _flag(lost), _flag(lost and sc.lost == 0)
    sc.lost = 1 if lost or sc.lost != 0 else 0
    out.wrong_road = _flag(rules.camera != 0 and _is_elsewhere(lanes, lanes.table[b.lane].road, car))
    out.terminated = _flag(facts.terminated != 0 or sc.crashed != 0 or off_road or wrong_way or lost)
    out.truncated = _flag(facts.truncated != 0)


@jit(inline=True)
def _repeat(b, speed, rules, out):  # type: ignore[no-untyped-def]
    """Copy levels, limits, alert and mode of the belief, and the true speed, into the info."""
    tta = rules.costs.time_to_alert_s
    out.tta_s = max(tta - b.alert_age_s, 0.0) if b.alert != 0 else tta
    out.pl_at_m, out.pl_ct_m, out.al_at_m, out.al_ct_m = b.pl_at_m, b.pl_ct_m, b.al_at_m, b.al_ct_m
    out.margin_at_m, out.margin_ct_m = b.al_at_m - b.pl_at_m, b.al_ct_m - b.pl_ct_m
    out.speed_mps, out.alert, out.available = speed, b.alert, b.available
    out.mode, out.reason = b.mode, b.reason
