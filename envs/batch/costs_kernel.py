"""What driving costs, by cause: the constraints of an agent. Truth may enter here, as costs only score.

Symbols: v speed over ground [m/s], dt length of a policy step [s], W and L width and length of the car, w width of the
lane, d lateral offset from the middle of the lane. Costs are >= 0, and but for misleading information 0 for a car at
rest in its lane where a stop is right; each is an integral over time, or 1 once, so that halving the policy's rate
leaves an episode's cost as it is.

``cost_collision``  1 in the step of a crash.
``cost_off_road``  1 in the step in which the car has left the road, or driven against its lane for too long.
``cost_lane``  ``max(0, |d| + half body - w / 2) max(v, v0) dt`` of the TRUE car beyond its corridor, at most 2 m; v0 is
``standing_speed_mps``, 0 by default.
``cost_lane_integrity``  ``max(0, |d_est| + PL_CT + W / 2 - w / 2) max(v, v0) dt`` of the belief, at most 2 m, also
without PL_CT; about the outer edges of both lanes during a change; 0 without a lane to keep (``keep_lane`` off).
``cost_headway``  ``max(0, 1 - (gap_est - PL_AT of both) / d_RSS) dt``, at most dt; a missing level counts as 40 m.
No less than ``max(0, 1 - gap / d_RSS) dt`` in TRUTH, and dt while a vehicle is that near and none perceived ahead.
So a leader that is not perceived, or has no level, does not lower the cost. Without a leader it is 0.
``cost_conflict``  ``max(0, 1 - T2 / 1.5 s)`` at the peak of a conflict with vehicles whose courses cross the car's, in
TRUTH; T2: time until the second one is where the first one is or just was (:mod:`.conflict_kernel`).
``cost_alert``  dt while an alert is older than the TTA and the car drives faster than permitted or changes lane.
``cost_context``  dt while the context monitor warns and the car drives faster than permitted or changes lane.
``cost_hmi``  dt times the share of the step's epochs whose information is hazardously misleading on either axis.
``cost_blocking``  ``max(0, 1 - v cos(psi) / v_least) dt``, at most dt, of the TRUE car; psi: heading less the lane's,
v_least = ``blocking_share v_flow``, under an alert no more than the permitted speed. v_flow is the least of limit,
fastest command, comfortable speed in a bend, speed of a vehicle less than 4 s ahead (also a wreck), and the speed from
which the car stops in comfort before its lane ends. The cost is 0 while a vehicle is to be let pass whose course
crosses (:func:`.conflict_kernel.must_give_way`), and where its weight is 0. Cars that are much slower than the flow
crash more often (Solomon, Accidents on main rural highways, 1964).

``cost_speeding``  ``max(0, (v cos(psi) - 3 km/h) / v_limit - 1) dt``, at most dt, of the TRUE car on its true lane;
v_limit is the announced limit beside a closure, and what the car can reach where there is none.
``cost_route``  1 in the step in which the TRUE car comes onto a road that does not lead to the goal of the world.
``cost_gore``  dt while the TRUE body is over a line of its lane less than ``gore_m`` before or behind a fork.

With a lane sensor the corridor is that of the lane that the camera follows, and ``cost_lane_integrity`` takes offset
and bound of the camera: the car is kept in its lane by the camera, so a level of the navigator of many metres does not
say that it may leave its lane, but that it may be on another road. That has costs of its own: these three, and the
alert.

``cost_overcharge``  1 where a geo-object is settled that is charged and that the TRUE car has not driven, and
``cost_undercharge``  where one is settled that is not charged and that it has (:mod:`.toll_kernel`).

Under an alert the permitted speed is a share of the limit, or it follows from the level as shown at the last decision
(:func:`.budget_kernel.permitted_mps`), or with a lane sensor it is the least limit of the roads that levels leave
possible, and the tolerance of 3 km/h.

The corridor is the lanes that the car may be in: its own, and during a commanded change the lane that the change comes
from. Where a road ends, the lanes that lead to it and on from it count as well, and where several roads meet, all of
theirs: a junction has one pavement. Without ``keep_lane`` every lane of the road counts.
"""

from __future__ import annotations

import math

from lanebound.envs.batch.conflict_kernel import must_give_way, second_arrival_s
from lanebound.envs.batch.lanes_kernel import NONE, STRAIGHT, local, of_side, straight, width_at
from lanebound.envs.batch.records_kernel import BY_ROADS
from lanebound.integrity.core.accel import jit

__all__ = ["CHANGE_S", "EXCESS_MOST_M", "TOLERANCE_MPS", "UNKNOWN_GAP_M", "begin_corridor", "doubt_m",
           "follow_corridor", "lead_of",
           "overhang_m", "price", "rss_distance_m", "shortfall"]  # fmt: skip

CHANGE_S = 8.0  # two lane changes in a row; one takes 3 to 5 s in traffic, about 3 s by highway-env's control
JOINT_M = 1.0  # lanes that follow each other do not meet exactly in every world of highway-env
UNKNOWN_GAP_M = 40.0  # what a missing level of the gap counts as; as far as observations show levels
EXCESS_MOST_M = 2.0  # beyond a lane's width being further out is no worse; also what a missing level counts as
STANDING_MPS = 0.1
TOLERANCE_MPS = 3.0 / 3.6  # above a limit that does not count: of speed measurements in Germany below 100 km/h


@jit(inline=True)
def begin_corridor(sc, b, lanes):  # type: ignore[no-untyped-def]
    """The corridor at a start: the lane that the car wants."""
    lane = lanes.table[b.target_lane]
    sc.corridor_road, sc.corridor_side, sc.leaving_side, sc.change_s = lane.road, lane.side, NONE, 0.0


@jit(borrows=True)
def follow_corridor(sc, b, car, lanes, rules, dt):  # type: ignore[no-untyped-def]
    """Follow what is commanded, by belief; of the true car only its size is read.

    A change is over when the car believes to be inside its new lane with its whole body; it goes on where the road does
    with lanes of the same number. The time spent changing may not exceed that spent in a lane by more than CHANGE_S:
    commands withdrawn and repeated close the lane that is left. Continuous actions command no change.
    """
    target = lanes.table[b.target_lane]
    side = target.side if rules.meta != 0 else sc.corridor_side
    if target.road == sc.corridor_road and side != sc.corridor_side:
        sc.leaving_side = sc.corridor_side
    sc.corridor_road, sc.corridor_side = target.road, side
    half = 0.5 * (car.width * abs(math.cos(b.angle_rad)) + car.length * abs(math.sin(b.angle_rad)))
    lane = lanes.table[b.lane]
    inside = abs(b.lateral_m) + half < 0.5 * b.lane_width_m
    arrived = lane.road == sc.corridor_road and lane.side == side and inside
    changing = sc.leaving_side >= 0 and not arrived
    sc.change_s = max(sc.change_s + (dt if changing else -dt), 0.0)
    if arrived or sc.change_s > CHANGE_S:
        sc.leaving_side = NONE


@jit(borrows=True)
def _beyond(lanes, low, high, x, y):  # type: ignore[no-untyped-def]
    """How far a point is outside of the lanes from ``low`` to ``high``, negative inside; whether it is beside them."""
    beyond, on = -math.inf, False
    for end in range(2):
        n = low if end == 0 else high
        s, r, _ = local(lanes, n, x, y)
        on = on or -JOINT_M <= s <= lanes.table[n].length_m + JOINT_M
        beyond = max(beyond, (-r if end == 0 else r) - 0.5 * width_at(lanes, n, s))
    return beyond, on


@jit(borrows=True)
def _span(lanes, sc, road, whole):  # type: ignore[no-untyped-def]
    """The outermost lanes of a road that the corridor holds."""
    own = sc.corridor_side
    left = sc.leaving_side if sc.leaving_side >= 0 else own
    if whole:
        return road, road + lanes.table[road].count - 1
    return of_side(lanes, road, min(own, left)), of_side(lanes, road, max(own, left))


@jit(borrows=True)
def overhang_m(car, sc, lanes, keep):  # type: ignore[no-untyped-def]
    """How far the worst corner of the true body is beyond its corridor, 0 inside.

    A corner is as far out as it is from the stretch that it is nearest to: where stretches meet or fork the body may
    stand on several of them. Beyond the ends of all it is that of the corridor's own lane.
    """
    road, own = sc.corridor_road, sc.corridor_side
    low, high = _span(lanes, sc, road, not keep)
    cosine, sine = math.cos(car.heading), math.sin(car.heading)
    joint_first, joint_last = lanes.table[road].joint_first, lanes.table[road].joint_last
    worst = 0.0
    for corner in range(4):
        along = 0.5 * car.length * (1.0 if corner < 2 else -1.0)
        across = 0.5 * car.width * (-1.0 if corner == 0 or corner == 3 else 1.0)
        x = car.x + cosine * along - sine * across
        y = car.y + sine * along + cosine * across
        endless, on = _beyond(lanes, low, high, x, y)
        out = endless if on else math.inf
        for k in range(joint_first, joint_last):
            first = last = lanes.joints[k].road
            if keep and lanes.joints[k].whole == 0:
                first = last = of_side(lanes, first, own)
            else:
                last += lanes.table[first].count - 1
            beyond, on = _beyond(lanes, first, last, x, y)
            if on:
                out = min(out, beyond)
        worst = max(worst, out if out < math.inf else endless)
    return worst


@jit(borrows=True)
def doubt_m(b, sc, level, half, lanes, whole):  # type: ignore[no-untyped-def]
    """How far beyond the corridor a car of ``half`` width may be by its estimate and a level, negative inside.

    ``whole``: the corridor is the whole road.
    """
    if sc.leaving_side < 0 and not whole:
        return abs(b.lateral_m) + level + half - 0.5 * b.lane_width_m
    low, high = _span(lanes, sc, lanes.table[b.lane].road, whole)
    s, left, _ = local(lanes, low, b.x_m, b.y_m)
    beyond = -left + level + half - 0.5 * width_at(lanes, low, s)
    s, right, _ = local(lanes, high, b.x_m, b.y_m)
    return max(beyond, right + level + half - 0.5 * width_at(lanes, high, s))


@jit(borrows=True)
def rss_distance_m(ego, lead, c):  # type: ignore[no-untyped-def]
    """Longitudinal distance that is always safe (Shalev-Shwartz et al. 2017, definition 1), 0 at least [m].

    ``v rho + a rho^2 / 2 + (v + a rho)^2 / (2 b_min) - v_lead^2 / (2 b_max)``; a car at rest stays so: 0.
    """
    v, w = max(ego, 0.0), max(lead, 0.0)
    if v < STANDING_MPS:
        return 0.0
    a, rho = c.accelerate_mps2, c.response_s
    after = v + a * rho
    travel = v * rho + 0.5 * a * rho**2 + after * after / (2.0 * c.brake_min_mps2)
    return max(travel - w * w / (2.0 * c.brake_max_mps2), 0.0)


@jit(borrows=True)
def _lacking(gap, needed):  # type: ignore[no-untyped-def]
    return min(max(1.0 - gap / needed, 0.0), 1.0) if needed > 0.0 else 0.0


@jit(borrows=True)
def shortfall(cars, lanes, c):  # type: ignore[no-untyped-def]
    """Share of the RSS distance that in truth lacks to a vehicle ahead, within half the lane's width; 0 to 1."""
    n, worst = cars[0].lane, 0.0
    lane = lanes.table[n]
    place, _, _ = local(lanes, n, cars[0].x, cars[0].y)
    half, flat = 0.5 * width_at(lanes, n, place), lane.kind == STRAIGHT
    for i in range(1, cars.shape[0]):
        s, r = straight(lane, cars[i].x, cars[i].y) if flat else local(lanes, n, cars[i].x, cars[i].y)[:2]
        if (s > place) & (abs(r) <= half):
            needed = rss_distance_m(cars[0].speed, cars[i].speed, c)
            worst = max(worst, _lacking(s - place - 0.5 * (cars[0].length + cars[i].length), needed))
    return worst


@jit(borrows=True)
def lead_of(b, seen, count, length, lanes):  # type: ignore[no-untyped-def]
    """Which of ``count`` perceived vehicles the ego believes to follow, NONE for none, and the gap to it.

    The nearest ahead within half a lane width of the believed lane, bumper to bumper [m]; the lane goes on straight
    past its end, as in highway-env's local coordinates.
    """
    n, gap, lead = b.lane, math.inf, NONE
    lane, half = lanes.table[n], 0.5 * b.lane_width_m
    flat = lane.kind == STRAIGHT
    for i in range(count):
        x, y = seen[i].x_m, seen[i].y_m
        s, r = straight(lane, x, y) if flat else local(lanes, n, x, y)[:2]
        ahead = s - b.longitudinal_m
        distance = ahead - 0.5 * (length + seen[i].length_m)
        if (ahead > 0.0) & (abs(r) <= half) & (distance < gap):
            gap, lead = distance, i
    return lead, gap


@jit(borrows=True)
def _headway(b, cars, seen, count, lanes, c):  # type: ignore[no-untyped-def]
    """Share of the RSS distance that lacks: by what is believed of the lead, or in truth if that is worse."""
    truly = shortfall(cars, lanes, c)
    lead, gap = lead_of(b, seen, count, cars[0].length, lanes)
    if lead < 0:
        return 1.0 if truly > 0.0 else 0.0
    bound = seen[lead].pl_at_m + (0.0 if seen[lead].relative != 0 else b.pl_at_m)
    gap -= min(bound, UNKNOWN_GAP_M)
    return max(truly, _lacking(gap, rss_distance_m(b.speed_mps, seen[lead].speed_mps, c)))


@jit(borrows=True)
def _conflict(cars, sc, lanes, c, dt):  # type: ignore[no-untyped-def]
    """By how much a conflict of crossing courses has become more severe in a step: in sum the peak of each conflict."""
    severity = max(1.0 - second_arrival_s(cars, lanes, c.conflict_s, dt) / c.conflict_s, 0.0)
    more = max(severity - sc.conflict, 0.0) if dt > 0.0 else 0.0
    sc.conflict = max(severity, sc.conflict) if severity > 0.0 else 0.0
    return more


@jit(borrows=True)
def _blocking(cars, lanes, along, least):  # type: ignore[no-untyped-def]
    """By how much the ego is slower than what the flow asks of it, where nobody is to be let pass; 0 to 1."""
    if least < STANDING_MPS or along >= least or must_give_way(cars, lanes):
        return 0.0
    return min(1.0 - along / least, 1.0)


@jit(inline=True)
def _speeding(along, limit):  # type: ignore[no-untyped-def]
    """Share by which the true car exceeds the limit where it is, at most 1."""
    return min(max((along - TOLERANCE_MPS) / limit - 1.0, 0.0), 1.0)


@jit(borrows=True)
def _forks(lanes, road):  # type: ignore[no-untyped-def]
    """Whether a road forks at its end, and whether it begins at a fork."""
    ends = lanes.table[road].joint_last - lanes.table[road].joint_onward > 1
    begins = False
    for k in range(lanes.table[road].joint_first, lanes.table[road].joint_onward):
        before = lanes.joints[k].road
        begins = begins or lanes.table[before].joint_last - lanes.table[before].joint_onward > 1
    return ends, begins


@jit(borrows=True)
def _changes_late(car, lanes, gore_m):  # type: ignore[no-untyped-def]
    """Whether the true body is over a line of its lane within a distance of a fork."""
    lane = lanes.table[car.lane]
    s, r, direction = local(lanes, car.lane, car.x, car.y)
    ends, begins = _forks(lanes, lane.road)
    near = (ends and s > lane.length_m - gore_m) or (begins and s < gore_m)
    angle = car.heading - direction
    half = 0.5 * (car.width * abs(math.cos(angle)) + car.length * abs(math.sin(angle)))
    return near and abs(r) + half > 0.5 * width_at(lanes, car.lane, s)


@jit(borrows=True)
def price(b, body, sc, cars, seen, count, lanes, rules, dt, along, limit, flow, out):  # type: ignore[no-untyped-def]
    """Fill the costs of a step by cause, and their weighted sum; ``out`` holds the verdict and the costs of tolls.

    body: the belief, or the pose of a lane sensor; along: speed of the true car along its lane; limit, flow: the limit
    there, and the speed of the flow [m/s].
    """
    keep, speed, c = rules.keep_lane != 0, abs(cars[0].speed), rules.costs
    # A body beyond its lane may be struck while it stands as well; that it stands so is not excluded by a level.
    exposed = max(speed, c.standing_speed_mps)
    beyond = min(max(overhang_m(cars[0], sc, lanes, keep), 0.0), EXCESS_MOST_M)
    doubt = 0.0
    if keep:
        doubt = min(max(doubt_m(body, sc, body.pl_ct_m, 0.5 * cars[0].width, lanes, False), 0.0), EXCESS_MOST_M)
    late = b.alert != 0 and b.alert_age_s > c.time_to_alert_s
    believed = lanes.table[b.lane].speed_limit_mps
    share = c.alert_speed_share * believed if believed > 0.0 else math.inf
    permitted = b.permitted_mps if rules.permits != 0 else share
    least = c.blocking_share * min(flow, rules.fastest_mps)
    # The speed that an alert permits is fast enough, a slower one is not; of possible roads their limit is, and the
    # tolerance above it is not asked for.
    if b.alert != 0:
        least = min(least, permitted - (TOLERANCE_MPS if rules.permits == BY_ROADS else 0.0))
    out.cost_collision = out.crashed_now
    out.cost_off_road = out.astray_now
    out.cost_lane = beyond * exposed * dt
    out.cost_lane_integrity = doubt * exposed * dt
    out.cost_headway = _headway(b, cars, seen, count, lanes, c) * dt
    out.cost_conflict = _conflict(cars, sc, lanes, c, dt)
    out.cost_alert = dt if late and (speed > permitted or sc.leaving_side >= 0) else 0.0
    out.cost_hmi = out.hmi_share * dt
    out.cost_context = dt if b.context_warning != 0 and (speed > share or sc.leaving_side >= 0) else 0.0
    # Only where it has a weight: to look who crosses takes a tenth of a step without sensing in Intersection.
    out.cost_blocking = _blocking(cars, lanes, along, least) * dt if c.blocking > 0.0 else 0.0
    total = c.collision * out.cost_collision + c.off_road * out.cost_off_road + c.lane * out.cost_lane
    total += c.lane_integrity * out.cost_lane_integrity
    total += c.headway * out.cost_headway + c.conflict * out.cost_conflict
    total += c.alert * out.cost_alert
    total += c.hmi * out.cost_hmi + c.context * out.cost_context
    out.cost_speeding = _speeding(along, limit) * dt
    out.cost_route = out.lost_now
    out.cost_gore = dt if c.gore > 0.0 and _changes_late(cars[0], lanes, c.gore_m) else 0.0
    total += c.blocking * out.cost_blocking + c.speeding * out.cost_speeding
    total += c.route * out.cost_route + c.gore * out.cost_gore
    out.cost = total + (c.overcharge * out.cost_overcharge + c.undercharge * out.cost_undercharge)
