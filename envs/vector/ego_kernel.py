"""The ego: what it decides and commands by its belief, what its actuators make of that, and how the car then moves."""

from __future__ import annotations

import math

from lanebound.envs.vector.collisions_kernel import LENGTH_M
from lanebound.envs.vector.columns_kernel import (
    B_ACCELERATION,
    B_HEADING,
    B_LANE,
    B_SPEED,
    B_STEERING,
    B_TARGET_LANE,
    B_TARGET_SPEED,
    B_THROTTLE,
    B_TURN,
    B_WHEEL,
    B_X,
    B_Y,
    B_YAW_RATE,
    COS,
    CRASHED,
    F_ACTUATED,
    F_HOLD_MPS2,
    F_LATERAL_MPS2,
    F_META,
    F_PURSUES,
    F_SPEED_MAX,
    F_SPEED_MIN,
    F_STEP_S,
    F_WHEEL_RATE,
    HEADING,
    IMPACT_X,
    IMPACT_Y,
    LANE,
    SIN,
    SPEED,
    STRUCK,
    TARGET,
    TARGET_SPEED,
    X,
    Y,
)
from lanebound.envs.vector.idm_kernel import not_zero
from lanebound.envs.vector.lanes_kernel import (
    LENGTH,
    ONWARD,
    ROAD,
    SIDE,
    following,
    heading_at,
    local,
    nearest,
    of_side,
    place,
    reachable,
    remainder,
    wrap,
)
from lanebound.envs.vector.motorway_kernel import KP_HEADING, KP_LATERAL
from lanebound.integrity.core.accel import jit

__all__ = [
    "FASTER",
    "IDLE",
    "LEFT",
    "RIGHT",
    "SLOWER",
    "command",
    "decide",
    "know",
    "move",
    "rates",
    "roll",
    "show_intent",
    "steering_to",
]

LEFT, IDLE, RIGHT, FASTER, SLOWER = range(5)
STEERING_MOST_RAD = math.pi / 3.0  # ControlledVehicle.MAX_STEERING_ANGLE of highway-env
KP_A, PURSUIT_S = 1.0 / 0.6, 0.1
LOOK_M, LOOK_S, SLOPE = 6.0, 1.2, 0.25  # of envs/pursuit.py
STANDING_MPS, STANDING_MPS2 = 0.05, 0.05  # of envs/actuators.py and envs/tracker.py
ACCELERATION_S = 0.3  # of envs/tracker.py


@jit
def decide(b, action, lanes, speeds):  # type: ignore[no-untyped-def]
    """Carry a meta-action into the targets: a speed one step up or down from the believed one, or the lane beside."""
    if action == FASTER or action == SLOWER:
        last = speeds.shape[0] - 1
        share = (b[B_SPEED] - speeds[0]) / (speeds[last] - speeds[0])
        index = min(max(round(share * last), 0.0), float(last))
        index += 1.0 if action == FASTER else -1.0
        b[B_TARGET_SPEED] = speeds[int(min(max(index, 0.0), float(last)))]
        follow(b, lanes)
        return
    follow(b, lanes)
    if action == LEFT or action == RIGHT:
        target = int(b[B_TARGET_LANE])
        side = max(int(lanes.table[target, SIDE]) + (1 if action == RIGHT else -1), 0)
        goal = of_side(lanes.table, int(lanes.table[target, ROAD]), side)
        s, r, _ = local(lanes, goal, b[B_X], b[B_Y])
        if reachable(lanes.table, goal, s, r):
            b[B_TARGET_LANE] = goal


@jit
def follow(b, lanes):  # type: ignore[no-untyped-def]
    """At the end of the target lane, go on to the one after it."""
    b[B_TARGET_LANE] = following(lanes, int(b[B_TARGET_LANE]), b[B_X], b[B_Y])


@jit
def steering_to(lanes, lane, x, y, heading, speed):  # type: ignore[no-untyped-def]
    """highway-env's steering angle of a car at a pose, to the middle of a lane."""
    s, r, _ = local(lanes, lane, x, y)
    ahead = heading_at(lanes, lane, s + speed * PURSUIT_S)
    course = math.asin(min(max(-KP_LATERAL * r / not_zero(speed), -1.0), 1.0))
    wanted = ahead + min(max(course, -0.25 * math.pi), 0.25 * math.pi)
    rate = KP_HEADING * wrap(wanted - heading)
    slip = math.asin(min(max(0.5 * LENGTH_M / not_zero(speed) * rate, -1.0), 1.0))
    return min(max(math.atan(2.0 * math.tan(slip)), -STEERING_MOST_RAD), STEERING_MOST_RAD)


@jit
def pursuit(b, lanes):  # type: ignore[no-untyped-def]
    """Pure pursuit of the target lane, :func:`~lanebound.envs.pursuit.pursuit_rad`."""
    lane, x, y = int(b[B_TARGET_LANE]), b[B_X], b[B_Y]
    s, aside, _ = local(lanes, lane, x, y)
    look = max(LOOK_M, LOOK_S * abs(b[B_SPEED]))
    along, beside = s + look, aside - min(max(aside, -SLOPE * look), SLOPE * look)
    if along > lanes.table[lane, LENGTH] and lanes.table[lane, ONWARD] >= 0.0:
        along -= lanes.table[lane, LENGTH]
        lane = int(lanes.table[lane, ONWARD])
    goal_x, goal_y = place(lanes, lane, along, beside)
    dx, dy = goal_x - x, goal_y - y
    alpha = remainder(math.atan2(dy, dx) - b[B_HEADING])
    sine = LENGTH_M * math.sin(min(max(alpha, -1.5), 1.5)) / (math.hypot(dx, dy) + LENGTH_M)
    return math.atan(2.0 * math.tan(math.asin(min(max(sine, -0.99), 0.99))))


@jit
def _limited(b, figures, steering):  # type: ignore[no-untyped-def]
    """Steering as the wheels carry it out: within the lateral acceleration, at a limited rate."""
    if figures[F_LATERAL_MPS2] > 0.0:
        sine = figures[F_LATERAL_MPS2] * 0.5 * LENGTH_M / max(b[B_SPEED] * b[B_SPEED], 1e-9)
        grip = 0.5 * math.pi if sine >= 1.0 else math.atan(2.0 * math.tan(math.asin(sine)))
        steering = min(max(steering, -grip), grip)
    if figures[F_WHEEL_RATE] > 0.0:
        most = figures[F_WHEEL_RATE] * figures[F_STEP_S]
        steering = b[B_WHEEL] + min(max(steering - b[B_WHEEL], -most), most)
    b[B_WHEEL] = steering
    return steering


@jit
def command(b, lanes, figures):  # type: ignore[no-untyped-def]
    """Steering and acceleration of this step, and the brake that holds a standing car (0: none).

    Meta-actions are carried out from the believed pose; commands of a policy are taken as they are.
    """
    if figures[F_META] > 0.0:
        follow(b, lanes)
        if figures[F_PURSUES] > 0.0:
            steering = pursuit(b, lanes)
        else:
            steering = steering_to(lanes, int(b[B_TARGET_LANE]), b[B_X], b[B_Y], b[B_HEADING], b[B_SPEED])
        steering = min(max(steering, -STEERING_MOST_RAD), STEERING_MOST_RAD)
        acceleration = KP_A * (b[B_TARGET_SPEED] - b[B_SPEED])
    else:
        steering, acceleration = b[B_TURN], b[B_THROTTLE]
    hold = 0.0
    if figures[F_ACTUATED] > 0.0:
        steering = _limited(b, figures, steering)
        if abs(b[B_SPEED]) < STANDING_MPS and abs(acceleration) < STANDING_MPS2:
            hold = figures[F_HOLD_MPS2]
    b[B_STEERING] = steering
    return steering, acceleration, hold


@jit
def move(c, w, steering, acceleration, hold, lanes, figures):  # type: ignore[no-untyped-def]
    """One step of the physical car."""
    speed, dt = c[SPEED, 0], figures[F_STEP_S]
    if hold > 0.0:
        acceleration = min(max(-speed / dt, -hold), hold)
    roll(c, w, 0, steering, acceleration, figures[F_SPEED_MIN], figures[F_SPEED_MAX], lanes, dt)


@jit
def settle(c, w, i, dx, dy, heading, speed):  # type: ignore[no-untyped-def]
    """Take over a vehicle's new pose; one that was struck is thrown as well, and has crashed."""
    c[X, i] += dx
    c[Y, i] += dy
    if w[STRUCK, i] != 0:
        c[X, i] += c[IMPACT_X, i]
        c[Y, i] += c[IMPACT_Y, i]
        w[CRASHED, i], w[STRUCK, i] = 1, 0
    c[SPEED, i] = speed
    if heading != c[HEADING, i]:
        c[HEADING, i] = heading
        c[COS, i], c[SIN, i] = math.cos(heading), math.sin(heading)


@jit
def roll(c, w, i, steering, acceleration, slowest, fastest, lanes, dt):  # type: ignore[no-untyped-def]
    """One step of a car by highway-env's bicycle model, held between two speeds; a wreck brakes."""
    speed = c[SPEED, i]
    if w[CRASHED, i] != 0:
        steering, acceleration = 0.0, -speed
    if speed > fastest:
        acceleration = min(acceleration, fastest - speed)
    elif speed < slowest:
        acceleration = max(acceleration, slowest - speed)
    slip = math.atan(0.5 * math.tan(steering))
    cosine, sine = math.cos(slip), math.sin(slip)
    dx = speed * (c[COS, i] * cosine - c[SIN, i] * sine) * dt
    dy = speed * (c[SIN, i] * cosine + c[COS, i] * sine) * dt
    settle(c, w, i, dx, dy, c[HEADING, i] + speed * sine / (0.5 * LENGTH_M) * dt, speed + acceleration * dt)
    w[LANE, i] = nearest(lanes, c[X, i], c[Y, i], c[HEADING, i])


@jit
def show_intent(b, c, w, figures):  # type: ignore[no-untyped-def]
    """What the other drivers may know of the ego's intent: highway-env's own drivers read targets off each other.

    A car that is commanded directly has none: a lane it wants is its own, the speed it wants 0.
    """
    if figures[F_META] > 0.0:
        w[TARGET, 0] = int(b[B_TARGET_LANE])
        c[TARGET_SPEED, 0] = b[B_TARGET_SPEED]
    else:
        w[TARGET, 0] = w[LANE, 0]
        c[TARGET_SPEED, 0] = 0.0


@jit
def rates(turned, speed, speed_before, acceleration, dt):  # type: ignore[no-untyped-def]
    """Yaw rate and smoothed acceleration of a belief that has turned by an angle in ``dt``, as ``Tracker`` has them."""
    yaw_rate = remainder(turned) / dt if abs(speed) > STANDING_MPS else 0.0
    share = 1.0 - math.exp(-dt / ACCELERATION_S)
    return yaw_rate, acceleration + share * ((speed - speed_before) / dt - acceleration)


@jit
def know(b, c, w, lanes, dt):  # type: ignore[no-untyped-def]
    """Perfect navigation: the believed pose is the true one, bit for bit; rates follow from speeds and headings."""
    before_heading, before_speed = b[B_HEADING], b[B_SPEED]
    b[B_X], b[B_Y], b[B_HEADING], b[B_SPEED] = c[X, 0], c[Y, 0], c[HEADING, 0], c[SPEED, 0]
    b[B_LANE] = w[LANE, 0]
    turned = b[B_HEADING] - before_heading
    b[B_YAW_RATE], b[B_ACCELERATION] = rates(turned, b[B_SPEED], before_speed, b[B_ACCELERATION], dt)
