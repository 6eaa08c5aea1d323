"""The ego's control by belief: meta-actions, the steering that carries them out, and the actuators."""

from __future__ import annotations

import math

from lanebound.envs.batch.lane_sensor_kernel import body_of
from lanebound.envs.batch.lanes_kernel import (
    PAST_END_M,
    heading_at,
    local,
    of_side,
    place,
    reachable,
)
from lanebound.envs.batch.next_lane_kernel import following
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import remainder, wrap

__all__ = ["FASTER", "IDLE", "LEFT", "RIGHT", "SLOWER", "STEERING_MOST_RAD", "actuate", "decide", "follow_road",
           "intend", "not_zero", "past_end", "pursuit_rad", "steering_rad"]  # fmt: skip

LEFT, IDLE, RIGHT, FASTER, SLOWER = 0, 1, 2, 3, 4  # meta-actions
STEERING_MOST_RAD = math.pi / 3.0  # ControlledVehicle.MAX_STEERING_ANGLE of highway-env
KP_A, KP_HEADING, KP_LATERAL = 1.0 / 0.6, 1.0 / 0.2, 1.0 / 0.6  # of ControlledVehicle
PURSUIT_S = 0.1  # ControlledVehicle.TAU_PURSUIT
LOOK_M, LOOK_S = 6.0, 1.2  # how far ahead: one and a half times the way the wheels need to swing over
SLOPE = 0.25  # at which a lane is approached, across per along
STANDING_MPS, STANDING_MPS2 = 0.05, 0.05  # shown by the wheels and commanded, at which a car is to stand


@jit(inline=True)
def not_zero(x):  # type: ignore[no-untyped-def]
    """x, or 0.01 with its sign when it is smaller."""
    if abs(x) > 1e-2:
        return x
    return 1e-2 if x >= 0.0 else -1e-2


@jit(borrows=True)
def follow_road(ego, lanes, routes, rules):  # type: ignore[no-untyped-def]
    """Take the next lane as the target near the end of the target lane, by the pose of the body."""
    b = body_of(ego, rules)
    b.target_lane, at = following(lanes, routes, ego.route, b.target_lane, b.x_m, b.y_m)
    ego.route = at


@jit(borrows=True)
def decide(b, action, lanes, speeds):  # type: ignore[no-untyped-def]
    """Turn a meta-action into targets: a speed one step up or down from the believed one, or the lane beside.

    The lane is beside the target lane, which :func:`follow_road` has brought up to date.
    """
    if action == FASTER or action == SLOWER:
        last = speeds.shape[0] - 1
        share = (b.speed_mps - speeds[0]) / (speeds[last] - speeds[0])
        index = min(max(round(share * last), 0.0), float(last))
        index += 1.0 if action == FASTER else -1.0
        b.target_speed_mps = speeds[int(min(max(index, 0.0), float(last)))]
    if action == LEFT or action == RIGHT:
        target = lanes.table[b.target_lane]
        goal = of_side(lanes, target.road, max(target.side + (1 if action == RIGHT else -1), 0))
        s, r, _ = local(lanes, goal, b.x_m, b.y_m)
        if reachable(lanes, goal, s, r):
            b.target_lane = goal


@jit(borrows=True)
def past_end(lanes, n, x, y):  # type: ignore[no-untyped-def]
    """Whether a point is near the end of a lane, where highway-env goes on to the next."""
    s, _, _ = local(lanes, n, x, y)
    return s > lanes.table[n].length_m - 0.5 * PAST_END_M


@jit(borrows=True)
def steering_rad(lanes, n, x, y, heading, speed, length, aside):  # type: ignore[no-untyped-def]
    """highway-env's steering angle of a car at a pose, to the line ``aside`` [m] to the right of a lane's middle."""
    s, r, _ = local(lanes, n, x, y)
    ahead = heading_at(lanes, n, s + speed * PURSUIT_S)
    course = math.asin(min(max(-KP_LATERAL * (r - aside) / not_zero(speed), -1.0), 1.0))
    wanted = ahead + min(max(course, -0.25 * math.pi), 0.25 * math.pi)
    rate = KP_HEADING * wrap(wanted - heading)
    slip = math.asin(min(max(0.5 * length / not_zero(speed) * rate, -1.0), 1.0))
    return min(max(math.atan(2.0 * math.tan(slip)), -STEERING_MOST_RAD), STEERING_MOST_RAD)


@jit(borrows=True)
def pursuit_rad(lanes, n, onward, b, length):  # type: ignore[no-untyped-def]
    """Steering angle by pure pursuit of a lane, for a car with its centre half way between the axles, right positive.

    The arc from the centre, along its velocity, through a point of the lane at distance l has the curvature
    ``2 sin(alpha - beta) / l`` with alpha the point's bearing off the car's heading and beta the slip angle,
    ``sin(beta) = kappa L / 2``: together ``kappa = 2 sin(alpha) / (l + L)``, to first order in beta. The point lies
    beside the lane's middle while the car is far from it (R. C. Coulter, CMU-RI-TR-92-01, 1992, for the law).
    highway-env's own control answers an offset of centimetres at walking pace with the wheels at their stop, which is
    stable only where they turn at once.

    ``onward``: lane on which the point lies beyond the end of lane n, negative for none.
    """
    s, aside, _ = local(lanes, n, b.x_m, b.y_m)
    look = max(LOOK_M, LOOK_S * abs(b.speed_mps))
    along, beside = s + look, aside - min(max(aside, -SLOPE * look), SLOPE * look)
    if along > lanes.table[n].length_m and onward >= 0:
        along -= lanes.table[n].length_m
        n = onward
    goal_x, goal_y = place(lanes, n, along, beside)
    dx, dy = goal_x - b.x_m, goal_y - b.y_m
    alpha = remainder(math.atan2(dy, dx) - b.heading_rad)
    sine = length * math.sin(min(max(alpha, -1.5), 1.5)) / (math.hypot(dx, dy) + length)
    return math.atan(2.0 * math.tan(math.asin(min(max(sine, -0.99), 0.99))))


@jit(borrows=True)
def intend(b, lanes, onward, rules, length):  # type: ignore[no-untyped-def]
    """Steering and acceleration that carry meta-actions out from the believed pose."""
    if rules.pursues != 0:
        steering = pursuit_rad(lanes, b.target_lane, onward, b, length)
    else:
        steering = steering_rad(lanes, b.target_lane, b.x_m, b.y_m, b.heading_rad, b.speed_mps, length, 0.0)
    steering = min(max(steering, -STEERING_MOST_RAD), STEERING_MOST_RAD)
    return steering, KP_A * (b.target_speed_mps - b.speed_mps)


@jit(borrows=True)
def actuate(b, command, steering, acceleration, length, rules):  # type: ignore[no-untyped-def]
    """The steering that the wheels carry out, and the brake that holds a standing car [m/s2], 0 for none.

    Steering is held within a lateral acceleration at the speed that the wheels show, ``v^2 sin(beta) / (L / 2)`` with
    ``tan(steering) = 2 tan(beta)``, and turns at a limited rate. Where the wheels show standstill and no acceleration
    is commanded, the brake is put on.
    """
    hold = 0.0
    if rules.actuated != 0:
        if rules.lateral_mps2 > 0.0:
            sine = rules.lateral_mps2 * 0.5 * length / max(b.speed_mps * b.speed_mps, 1e-9)
            grip = 0.5 * math.pi if sine >= 1.0 else math.atan(2.0 * math.tan(math.asin(sine)))
            steering = min(max(steering, -grip), grip)
        if rules.wheel_rate_radps > 0.0:
            most = rules.wheel_rate_radps * rules.step_s
            steering = command.wheel_rad + min(max(steering - command.wheel_rad, -most), most)
        command.wheel_rad = steering
        if abs(b.speed_mps) < STANDING_MPS and abs(acceleration) < STANDING_MPS2:
            hold = rules.hold_mps2
    b.steering_rad = steering
    return steering, hold
