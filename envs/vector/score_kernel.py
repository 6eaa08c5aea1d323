"""Truth against belief at the end of a policy step: verdict, ends of an episode, rewards and costs."""

from __future__ import annotations

import math

from lanebound.envs.vector import columns_kernel as k
from lanebound.envs.vector.columns_kernel import flag
from lanebound.envs.vector.costs_kernel import follow_corridor, price
from lanebound.envs.vector.lanes_kernel import COUNT, LENGTH, LIMIT, SIDE, WIDTH, local, on_lane, remainder, wrap
from lanebound.integrity.core.accel import jit

__all__ = ["glance", "locate", "score"]

CREEP_MPS = 0.5  # of envs/judge.py
CENTRE_SCALE_M, COMFORT_MPS2 = 0.5, 2.0  # of envs/rewards.py


@jit
def locate(b, lanes, meta):  # type: ignore[no-untyped-def]
    """Where the believed pose is on the ego's own map; without meta-actions the lane itself is the target."""
    lane = int(b[k.B_LANE])
    s, r, direction = local(lanes, lane, b[k.B_X], b[k.B_Y])
    b[k.B_ALONG], b[k.B_LATERAL] = s, r
    b[k.B_ANGLE], b[k.B_WIDTH] = wrap(b[k.B_HEADING] - direction), lanes.table[lane, WIDTH]
    if not meta > 0.0:
        b[k.B_TARGET_LANE], b[k.B_TARGET_SPEED] = lane, b[k.B_SPEED]


@jit
def glance(b, sc, c, figures):  # type: ignore[no-untyped-def]
    """Count a navigation epoch: misleading information is an available estimate whose error exceeds its level."""
    at, ct = _errors(b, c)
    mi = hmi = False
    for axis in range(2):
        error = abs(at) if axis == 0 else abs(ct)
        level, limit = b[k.B_PL_AT + axis], figures[k.F_AL_AT + axis]
        if b[k.B_AVAILABLE] > 0.0 and level <= limit:
            hmi = hmi or error > limit
            mi = mi or level < error <= limit
    sc[k.S_EPOCHS] += 1.0
    if hmi:
        sc[k.S_HMI] += 1.0
    elif mi:
        sc[k.S_MI] += 1.0


@jit
def _errors(b, c):  # type: ignore[no-untyped-def]
    """Estimate less truth along and across the true heading."""
    dx, dy = b[k.B_X] - c[k.X, 0], b[k.B_Y] - c[k.Y, 0]
    return c[k.COS, 0] * dx + c[k.SIN, 0] * dy, c[k.COS, 0] * dy - c[k.SIN, 0] * dx


@jit
def _own_reward(b, c, w, table, figures, lateral, angle, on_road):  # type: ignore[no-untyped-def]
    """The wrapped world's own reward: the motorway's, or that of the roads of our own."""
    f, lane = figures[k.F_BASE : k.F_BASE + 8], w[k.LANE, 0]
    crashed = flag(w[k.CRASHED, 0] != 0)
    if f[0] > 0.0:
        progress = min(max(c[k.SPEED, 0] * math.cos(angle) / table[lane, LIMIT], 0.0), 1.0)
        nearness = max(1.0 - (2.0 * lateral / table[lane, WIDTH]) ** 2, 0.0)
        total = f[2] * progress + f[3] * (nearness * min(4.0 * progress, 1.0)) + f[1] * crashed
        return min(max((total - f[1]) / (f[2] + f[3] - f[1]), 0.0), 1.0)
    target = int(b[k.B_TARGET_LANE]) if figures[k.F_META] > 0.0 else lane
    right = table[target, SIDE] / max(table[lane, COUNT] - 1.0, 1.0)
    fast = min(max((c[k.SPEED, 0] * c[k.COS, 0] - f[4]) / (f[5] - f[4]), 0.0), 1.0)
    total = f[1] * crashed + f[2] * right + f[3] * fast
    if f[6] > 0.0:
        total = (total - f[1]) / (f[3] + f[2] - f[1])
    return total * flag(on_road)


@jit
def score(b, sc, c, w, t, count, lanes, figures, start, out):  # type: ignore[no-untyped-def]
    """The whole verdict on a step, or at a start (no time has passed): fills ``out`` and remembers in ``sc``."""
    policy = figures[k.F_POLICY_S]
    dt = 0.0 if start else policy
    table, lane = lanes.table, w[k.LANE, 0]
    limit = table[lane, LIMIT] if table[lane, LIMIT] > 0.0 else figures[k.F_MAX_SPEED]
    s, r, direction = local(lanes, lane, c[k.X, 0], c[k.Y, 0])
    angle, on_road, speed = wrap(c[k.HEADING, 0] - direction), on_lane(lanes.table, lane, s, r), c[k.SPEED, 0]
    crashed, along = w[k.CRASHED, 0] != 0, speed * math.cos(angle)
    against = abs(angle) > 0.5 * math.pi
    if start:
        sc[k.S_CORRIDOR], sc[k.S_LEAVING] = b[k.B_TARGET_LANE], k.NONE
        sc[k.S_HEADING], sc[k.S_SPEED] = c[k.HEADING, 0], speed
        terminated = truncated = False
    else:
        follow_corridor(sc, b, lanes, figures, policy)
        sc[k.S_TIME] += policy
        terminated = crashed or (figures[k.F_WORLD_OFF_ROAD] > 0.0 and not on_road)
        terminated = terminated or (figures[k.F_AGAINST_ENDS] > 0.0 and against)
        truncated = sc[k.S_TIME] >= figures[k.F_WORLD_DURATION_S] - figures[k.F_WORLD_TOLERANCE_S]
        truncated = truncated or (figures[k.F_END_M] > 0.0 and s > table[lane, LENGTH] - figures[k.F_END_M])
        truncated = truncated or sc[k.S_STEPS] * figures[k.F_STEP_S] >= figures[k.F_DURATION_S] - 0.5 * policy
        sc[k.S_PROGRESS] += along * policy
        sc[k.S_ALLOWED] += limit * policy
        backwards = along < -CREEP_MPS or against
        sc[k.S_AGAINST] = sc[k.S_AGAINST] + policy if backwards else 0.0
    turn = remainder(c[k.HEADING, 0] - sc[k.S_HEADING])
    sc[k.S_HEADING] = c[k.HEADING, 0]
    _verdict(b, sc, c, figures, crashed, on_road, against, terminated or truncated, out)
    out[k.O_TURN_RATE] = turn / policy
    ended = terminated or out[k.O_IS_CRASHED] + out[k.O_OFF_ROAD] + out[k.O_WRONG_WAY] > 0.0
    out[k.O_TERMINATED], out[k.O_TRUNCATED] = flag(ended), flag(truncated)
    price(b, sc, c, w, t, count, lanes, figures, dt, out)
    base = 0.0 if start else _own_reward(b, c, w, table, figures, r, angle, on_road)
    across = speed * out[k.O_TURN_RATE]
    _reward(out, figures, along / limit, r,
            math.hypot((speed - sc[k.S_SPEED]) / policy, across), base, dt)  # fmt: skip
    sc[k.S_SPEED] = speed
    _tell(b, speed, figures, out)


@jit
def _verdict(b, sc, c, figures, crashed, on_road, against, over, out):  # type: ignore[no-untyped-def]
    """What truth says of the step; ``over`` when the world itself says so."""
    now = crashed and not sc[k.S_CRASHED] > 0.0
    sc[k.S_CRASHED] = max(sc[k.S_CRASHED], flag(crashed))
    off_road = figures[k.F_OFF_ROAD_ENDS] > 0.0 and not on_road
    wrong_way = sc[k.S_AGAINST] > figures[k.F_WRONG_WAY_S]
    astray = off_road or wrong_way or (over and against)
    astray_now = astray and not sc[k.S_ASTRAY] > 0.0
    sc[k.S_ASTRAY] = max(sc[k.S_ASTRAY], flag(astray))
    good = over and on_road and not (sc[k.S_CRASHED] > 0.0 or against)
    out[k.O_ERR_AT], out[k.O_ERR_CT] = _errors(b, c)
    out[k.O_MI], out[k.O_HMI] = flag(sc[k.S_MI] > 0.0), flag(sc[k.S_HMI] > 0.0)
    out[k.O_HMI_SHARE] = sc[k.S_HMI] / max(sc[k.S_EPOCHS], 1.0)
    sc[k.S_EPOCHS] = sc[k.S_MI] = sc[k.S_HMI] = 0.0
    out[k.O_IS_CRASHED], out[k.O_CRASHED_NOW] = sc[k.S_CRASHED], flag(now)
    out[k.O_OFF_ROAD], out[k.O_WRONG_WAY], out[k.O_ASTRAY_NOW] = flag(off_road), flag(wrong_way), flag(astray_now)
    enough = sc[k.S_PROGRESS] >= figures[k.F_SUCCESS_SHARE] * sc[k.S_ALLOWED]
    out[k.O_SUCCESS] = flag(good and enough)
    age = figures[k.F_TTA_S] - b[k.B_ALERT_AGE]
    out[k.O_TTA] = max(age, 0.0) if b[k.B_ALERT] > 0.0 else figures[k.F_TTA_S]


@jit
def _reward(out, figures, along, lateral, roughness, base, dt):  # type: ignore[no-untyped-def]
    """The terms of a step's reward and their weighted sum; ``along`` as a share of the limit."""
    progress = min(max(along, -1.0), 1.0) * dt
    roughness /= COMFORT_MPS2
    out[k.O_TERMS] = progress
    out[k.O_TERMS + 1] = max(progress, 0.0) / (1.0 + (lateral / CENTRE_SCALE_M) ** 2)
    out[k.O_TERMS + 2] = -min(roughness * roughness, 1.0) * dt
    out[k.O_TERMS + 3] = out[k.O_CRASHED_NOW]
    out[k.O_TERMS + 4] = base
    total = 0.0
    for n in range(k.TERMS):
        total += figures[k.F_REWARD_WEIGHTS + n] * out[k.O_TERMS + n]
    out[k.O_REWARD] = total


@jit
def _tell(b, speed, figures, out):  # type: ignore[no-untyped-def]
    """What infos repeat of the belief, and the true speed."""
    for axis in range(2):
        level, limit = b[k.B_PL_AT + axis], figures[k.F_AL_AT + axis]
        out[k.O_PL_AT + axis], out[k.O_AL_AT + axis], out[k.O_MARGIN_AT + axis] = level, limit, limit - level
    out[k.O_SPEED], out[k.O_ALERT], out[k.O_AVAILABLE] = speed, b[k.B_ALERT], b[k.B_AVAILABLE]
    out[k.O_MODE], out[k.O_REASON] = b[k.B_MODE], b[k.B_REASON]
