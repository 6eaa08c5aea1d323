"""Positions of other vehicles relative to an ego, by ranges and by broadcasts that are tested against them.

A RELATION follows the position p of another vehicle from the ego, in the axes of the map, by ranges alone: a Kalman
filter whose motion is the broadcast speed and course less the ego's own. Its noise has a covariance P. Constant errors
(of the modules, and of both headings, by which lever arms turn) are not white: their effect on p is followed exactly,
``S <- (I - K h') S - K H``, and ``P + S V S'`` is the covariance (Schmidt's consider filter). Errors of motion are
bounds that persist, so that deviations add up and not variances: P grows as an ellipsoid to which another is added.

Broadcasts do not enter p. Their difference to the ego's position, z, has the covariance B of both levels at one sigma.
So two independent positions are compared at each epoch:

- they agree: the position is that of both, weighted by their covariances;
- ``(z - p)' (B + P + S V S')^-1 (z - p)`` is above its quantile at the stated rate of false alarms: until the cause is
  found, the level covers both;
- that lasts as long as no delay of ranges explains it: the sender is excluded, until its slot is another's.

Ranges are never too short. A claimed position farther than the ranges is wrong after ``window_s``. One that is nearer
may be right, and the ranges late: by diffraction (at most what the link budget permits, :func:`.most_excess`) or by
later paths. n pairs of modules are all on later paths for a time t with probability ``(share exp(-t / late_s))^n``, and
half of the pairs suffice to turn a position, so that ``n / 2`` counts. The sender is excluded once that is below the
rate of false alarms. Where at least three senders are compared and more than half of them disagree, the ego's own
position is as likely the cause: none is excluded.

A line of two modules sees the two sides of it alike. The side is the claimed one; once the sender is excluded, the
level covers the mirrored position, unless the ranges of the way driven since have refuted it.
"""

from __future__ import annotations

import math

from lanebound.envs.batch.perception_kernel import ROUNDING, silence
from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record
from lanebound.integrity.sensors.uwb_kernel import PAIRS, most_excess

__all__ = ["ACROSS", "COOPERATION", "LONG", "RELATION", "SHORT", "relate"]

SHORT, LONG, ACROSS = 1, 2, 3  # why a sender is excluded: ranges shorter or longer than claimed, another bearing
ANYWHERE_M = 50.0  # 1 sigma of what ranges do not show; the reach of a UWB link is twice that
BENT = 0.5  # uncertain across by more than this share of the distance, a circle is no line: the position begins anew
SCALE = 0.01  # bound of the error of a speed by wheels; chosen, four times their scale after calibration
LATE_SIGMAS = 3.0  # a range longer than expected by more counts as late; one in a thousand that is not is lost

COOPERATION = record(
    sigmas="standard deviations of the level",
    level_sigmas="standard deviations in the levels of positions",
    gate="standard deviations beyond which a range contradicts the prediction",
    ellipse="quantile of the squared separation of two positions",
    log_alarm="logarithm of the rate of false alarms, > 0",
    log_risk="logarithm of the integrity risk, > 0",
    window_s="time for which positions must disagree",
    own_heading_rad="error of the ego's heading, 1 sigma",
    heading_rad="error of another's heading, 1 sigma",
    hidden_m="excess of a later path that is not found",
)
RELATION = record(
    known=("i8", "1 while ranges give a position"),
    reason=("i8", "SHORT, LONG or ACROSS once the sender is excluded"),
    used=("i8", "pairs of modules of the last update"),
    x_m="position from the ego's middle",
    y_m="position from the ego's middle",
    xx="covariance by noise",
    xy="covariance by noise",
    yy="covariance by noise",
    bias=("f8", (2, 6), "effect of the errors of both modules of the ego, of the other's, and of both headings"),
    heading_rad="broadcast last",
    speed_mps="broadcast last",
    heard_s="time of that broadcast",
    claimed_x_m="broadcast position from the ego's middle, now",
    claimed_y_m="broadcast position from the ego's middle, now",
    claimed_xx="its covariance",
    claimed_xy="its covariance",
    claimed_yy="its covariance",
    claims=("i8", "1 where there is one, with levels; 2 without levels"),
    silent_s="since the last range",
    begun_s="since the position has begun",
    astray_s="for which less than half of the ranges fit the prediction, less the time for which more do",
    against_s="for which both positions disagree",
    against=("i8", "1 where they do now, and late ranges do not explain it"),
    doubt=("i8", "1 where they do now"),
    sided=("i8", "1 once ranges have refuted the mirrored position"),
    from_x_m="position from which the motion since then is to refute it",
    from_y_m="position from which the motion since then is to refute it",
    moved_x_m="relative motion since",
    moved_y_m="relative motion since",
    driven_m="way of both vehicles since",
    from_mps="broadcast speed then",
    lag_s="age of the oldest speed since",
)


@jit(borrows=True)
def _range_sigma(r, distance):  # type: ignore[no-untyped-def]
    """Noise of a range; shadowing is correlated, and its mean over time varies as that of fewer independent errors."""
    if r.shadow_db <= 0.0:
        return r.sigma_m
    stays = math.exp(-1.0 / (r.rate_hz * r.late_s))
    sigma = distance * (10.0 ** (r.shadow_db / (10.0 * r.path)) - 1.0)
    return sigma * math.sqrt((1.0 + stays) / (1.0 - stays))


@jit(borrows=True)
def _late_m(r, f, distance, pairs):  # type: ignore[no-untyped-def]
    """Bound of what ``pairs`` ranges are late by together: diffraction, and later paths at the integrity risk."""
    if r.shadow_db > 0.0:  # losses lengthen them up to the margin
        return max(distance * ((r.range_m / max(distance, 1.0)) ** (2.0 / r.path) - 1.0), 0.0)
    late = most_excess(r, distance)
    if r.late_share > 0.0:
        late += r.late_mean_m * max(f.log_risk / max(pairs, 1) + math.log(r.late_share), 0.0)
    return late


@jit(borrows=True)
def _arm(r, module, cos, sin):  # type: ignore[no-untyped-def]
    """Place of a module from the middle of its vehicle, in the axes of the map."""
    front, right = r.arms[module, 0], r.arms[module, 1]
    return cos * front - sin * right, sin * front + cos * right


@jit(borrows=True)
def _expect(rel, r, pair, x, y, cos, sin):  # type: ignore[no-untyped-def]
    """Distance of a pair for a position (x, y), its gradient, and its change by both headings."""
    ax, ay = _arm(r, pair // 2, cos, sin)
    bx, by = _arm(r, pair % 2, math.cos(rel.heading_rad), math.sin(rel.heading_rad))
    dx, dy = x + bx - ax, y + by - ay
    distance = max(math.hypot(dx, dy), ROUNDING)
    ux, uy = dx / distance, dy / distance
    return distance, ux, uy, ux * ay - uy * ax, uy * bx - ux * by


@jit(borrows=True)
def _covariance(rel, f, module):  # type: ignore[no-untyped-def]
    """Covariance of the position by ranges: noise, and constant errors, of a module with the variance ``module``."""
    xx, xy, yy = rel.xx, rel.xy, rel.yy
    for k in range(PAIRS + 2):
        v = module if k < PAIRS else f.own_heading_rad**2 if k == PAIRS else f.heading_rad**2
        sx, sy = rel.bias[0, k], rel.bias[1, k]
        xx, xy, yy = xx + v * sx * sx, xy + v * sx * sy, yy + v * sy * sy
    return xx, xy, yy


@jit(inline=True)
def _along(x, y, xx, xy, yy):  # type: ignore[no-untyped-def]
    """Variance along a direction (x, y)."""
    return x * x * xx + 2.0 * x * y * xy + y * y * yy


@jit(borrows=True)
def _change(rel, k, change, pair, turn_own, turn):  # type: ignore[no-untyped-def]
    """Add to the effect of constant errors on coordinate ``k`` what a gain ``-change`` of a pair brings in."""
    rel.bias[k, pair // 2] += change
    rel.bias[k, 2 + pair % 2] += change
    rel.bias[k, PAIRS] += change * turn_own
    rel.bias[k, PAIRS + 1] += change * turn


@jit(borrows=True)
def _claim(rel, said, f, tracking, time, b, t):  # type: ignore[no-untyped-def]
    """What the newest message says now: motion, and the position from the ego with the covariance of both levels.

    The ego's position is its solution as it is: without the error of its map, and without what a jump has left to be
    taken over, which the level of the belief has on top.
    """
    rel.claims = 0
    age = time - said.time_s
    if not age <= tracking.drop_after_s + ROUNDING:
        return
    rel.heading_rad, rel.speed_mps, rel.heard_s = said.heading_rad, said.speed_mps, said.time_s
    cos, sin = math.cos(said.heading_rad), math.sin(said.heading_rad)
    driven = said.speed_mps * age + 0.5 * said.acceleration_mps2 * age * age
    rel.claimed_x_m = said.x_m + driven * cos - (b.fix_x_m - t.residual_x_m - t.map_x_m)
    rel.claimed_y_m = said.y_m + driven * sin - (b.fix_y_m - t.residual_y_m - t.map_y_m)
    growth_at = 0.5 * tracking.along_mps2 * age * age / f.sigmas  # bounds, whatever the risk
    growth_ct = (0.5 * tracking.across_mps2 * age + tracking.course_sin * abs(said.speed_mps)) * age / f.sigmas
    at, ct = said.pl_at_m / f.level_sigmas + growth_at, said.pl_ct_m / f.level_sigmas + growth_ct
    own_cos, own_sin = math.cos(b.heading_rad), math.sin(b.heading_rad)
    left_at = abs(own_cos * t.residual_x_m + own_sin * t.residual_y_m)
    left_ct = abs(own_cos * t.residual_y_m - own_sin * t.residual_x_m)
    own_at, own_ct = (b.pl_at_m - left_at) / f.level_sigmas, (b.pl_ct_m - left_ct) / f.level_sigmas
    if not at + ct + own_at + own_ct < math.inf:
        rel.claims = 2
        return
    rel.claimed_xx = (at * cos) ** 2 + (ct * sin) ** 2 + (own_at * own_cos) ** 2 + (own_ct * own_sin) ** 2
    rel.claimed_yy = (at * sin) ** 2 + (ct * cos) ** 2 + (own_at * own_sin) ** 2 + (own_ct * own_cos) ** 2
    rel.claimed_xy = (at * at - ct * ct) * cos * sin + (own_at * own_at - own_ct * own_ct) * own_cos * own_sin
    rel.claims = 1


@jit(borrows=True)
def _move(rel, f, tracking, time, b, dt):  # type: ignore[no-untyped-def]
    """Carry the position on by both motions, and widen it by the bounds of their errors."""
    cos, sin = math.cos(rel.heading_rad), math.sin(rel.heading_rad)
    own_cos, own_sin = math.cos(b.heading_rad), math.sin(b.heading_rad)
    x, y = (rel.speed_mps * cos - b.speed_mps * own_cos) * dt, (rel.speed_mps * sin - b.speed_mps * own_sin) * dt
    age = max(time - rel.heard_s, 0.0) + 0.5 * dt
    rel.x_m, rel.y_m, rel.moved_x_m, rel.moved_y_m = rel.x_m + x, rel.y_m + y, rel.moved_x_m + x, rel.moved_y_m + y
    rel.driven_m, rel.lag_s = rel.driven_m + (abs(rel.speed_mps) + abs(b.speed_mps)) * dt, max(rel.lag_s, age)
    at = tracking.along_mps2 * age * dt / f.sigmas
    ct = (tracking.across_mps2 * age + tracking.course_sin * abs(rel.speed_mps)) * dt / f.sigmas
    own_at, own_ct = SCALE * b.speed_mps * dt / f.sigmas, f.own_heading_rad * b.speed_mps * dt
    xx = (at * cos) ** 2 + (ct * sin) ** 2 + (own_at * own_cos) ** 2 + (own_ct * own_sin) ** 2
    yy = (at * sin) ** 2 + (ct * cos) ** 2 + (own_at * own_sin) ** 2 + (own_ct * own_cos) ** 2
    xy = (at * at - ct * ct) * cos * sin + (own_at * own_at - own_ct * own_ct) * own_cos * own_sin
    if xx + yy > 0.0:
        share = math.sqrt((rel.xx + rel.yy) / (xx + yy))
        one, other = 1.0 + 1.0 / max(share, ROUNDING), 1.0 + share
        rel.xx, rel.xy, rel.yy = one * rel.xx + other * xx, one * rel.xy + other * xy, one * rel.yy + other * yy


@jit(borrows=True)
def _mirrored(r, x, y, own_cos, own_sin):  # type: ignore[no-untyped-def]
    """A position mirrored at the line through the modules of the ego, of which it has two."""
    ax, ay = _arm(r, 0, own_cos, own_sin)
    bx, by = _arm(r, 1, own_cos, own_sin)
    ex, ey = bx - ax, by - ay
    length2 = ex * ex + ey * ey
    along = ((x - ax) * ex + (y - ay) * ey) / length2
    return 2.0 * (ax + along * ex) - x, 2.0 * (ay + along * ey) - y


@jit(borrows=True)
def _start_mirror(rel):  # type: ignore[no-untyped-def]
    """Begin to look for motion that refutes the mirrored position."""
    rel.sided, rel.from_x_m, rel.from_y_m, rel.from_mps = 0, rel.x_m, rel.y_m, rel.speed_mps
    rel.moved_x_m = rel.moved_y_m = rel.driven_m = rel.lag_s = 0.0


@jit(borrows=True)
def _refute_side(rel, r, f, tracking, cos, sin, xx, xy, yy):  # type: ignore[no-untyped-def]
    """Whether motion has brought the mirrored position to another distance than the ranges show, or only our own.

    Speeds that are ``lag`` old are wrong together by the change of the speed times that, wheels by their scale, and
    the first ranges may have been late. Returns whether ours is refuted.
    """
    x, y = _mirrored(r, rel.x_m, rel.y_m, cos, sin)
    x, y = rel.x_m - x, rel.y_m - y
    gap = max(math.hypot(x, y), ROUNDING)
    if 0.5 * gap < f.sigmas * math.sqrt(_along(x / gap, y / gap, xx, xy, yy)):  # both sides are one
        _start_mirror(rel)
    if rel.sided != 0:
        return False
    x, y = _mirrored(r, rel.from_x_m, rel.from_y_m, cos, sin)
    size = max(math.hypot(rel.x_m, rel.y_m), ROUNDING)
    other = abs(math.hypot(x + rel.moved_x_m, y + rel.moved_y_m) - size)
    own = abs(math.hypot(rel.from_x_m + rel.moved_x_m, rel.from_y_m + rel.moved_y_m) - size)
    noise = 2.0 * f.sigmas * math.sqrt(_along(rel.x_m / size, rel.y_m / size, xx, xy, yy))
    if r.late_share > 0.0:
        noise += r.late_mean_m * max(0.5 * f.log_risk + math.log(r.late_share), 0.0)
    change = abs(rel.speed_mps - rel.from_mps) + tracking.along_mps2 * rel.lag_s
    bound = noise + rel.lag_s * change + SCALE * rel.driven_m
    if own > bound and other > bound:
        _start_mirror(rel)
    elif other > bound:
        rel.sided = 1
    return own > bound and other <= bound


@jit(borrows=True)
def _by_distance(rel, r, ranges, x, y, cos, sin):  # type: ignore[no-untyped-def]
    """Begin with a distance in the direction of (x, y): that of the shortest range where they may be late, or the mean.

    Ranges are those of the middles once the lever arms along that direction are taken off.
    """
    size, mean, least, count = max(math.hypot(x, y), ROUNDING), 0.0, math.inf, 0
    ux, uy = x / size, y / size
    for pair in range(PAIRS):
        if ranges[pair] >= 0.0:
            ax, ay = _arm(r, pair // 2, cos, sin)
            bx, by = _arm(r, pair % 2, math.cos(rel.heading_rad), math.sin(rel.heading_rad))
            distance = ranges[pair] - ux * (bx - ax) - uy * (by - ay)
            mean, least, count = mean + distance, min(least, distance), count + 1
    distance = least if r.late_share > 0.0 else mean / count
    along, across = _range_sigma(r, distance) ** 2 / (1 if r.late_share > 0.0 else count), ANYWHERE_M**2
    rel.x_m, rel.y_m = ux * distance, uy * distance
    rel.xx, rel.yy = along * ux * ux + across * uy * uy, along * uy * uy + across * ux * ux
    rel.xy = (along - across) * ux * uy
    rel.bias[:] = 0.0
    for pair in range(PAIRS):
        if ranges[pair] >= 0.0:
            _change(rel, 0, -ux / count, pair, 0.0, 0.0)
            _change(rel, 1, -uy / count, pair, 0.0, 0.0)
    rel.used = count


@jit(borrows=True)
def _by_bearing(rel, r, f, ranges, x, y, cos, sin):  # type: ignore[no-untyped-def]
    """The position at which both modules of the ego have their ranges, on the side of (x, y); whether there is one."""
    ax, ay = _arm(r, 0, cos, sin)
    ex, ey = _arm(r, 1, cos, sin)
    base, sigma = math.hypot(ex - ax, ey - ay), _range_sigma(r, math.hypot(rel.x_m, rel.y_m))
    if f.sigmas * sigma * math.sqrt(2.0) >= BENT * base:
        return False
    ex, ey = (ex - ax) / base, (ey - ay) / base
    side = 1.0 if ex * (y - ay) - ey * (x - ax) >= 0.0 else -1.0
    guess_x, guess_y, found = 0.0, 0.0, 0
    for j in range(2):
        near, far = ranges[j], ranges[2 + j]
        if near < 0.0 or far < 0.0:
            continue
        along = (base * base + near * near - far * far) / (2.0 * base)
        if abs(along) > near:  # one of both is late
            continue
        off = side * math.sqrt(near * near - along * along)
        bx, by = _arm(r, j, math.cos(rel.heading_rad), math.sin(rel.heading_rad))
        guess_x, guess_y = guess_x + ax + along * ex - off * ey - bx, guess_y + ay + along * ey + off * ex - by
        found += 1
    if found > 0:
        rel.x_m, rel.y_m = guess_x / found, guess_y / found
    return found > 0


@jit(borrows=True)
def _begin(rel, r, f, ranges, x, y, cos, sin):  # type: ignore[no-untyped-def]
    """A position by the ranges of one epoch alone, on the side of (x, y).

    Least squares; a range that is too long for the others is left out while three are left. Where the rest do not
    fit, the distance is all that is taken from them.
    """
    _by_distance(rel, r, ranges, x, y, cos, sin)
    rel.known, rel.silent_s, rel.astray_s, rel.begun_s = 1, 0.0, 0.0, 0.0
    if not _by_bearing(rel, r, f, ranges, x, y, cos, sin):
        return
    left, out, worst = rel.used, 0, 0.0  # out: a bit for each pair that is left out
    for turn in range(2 * PAIRS):
        weak = 1.0 / ANYWHERE_M**2
        nxx, nxy, nyy, gx, gy = weak, 0.0, weak, 0.0, 0.0
        for pair in range(PAIRS):
            if ranges[pair] >= 0.0 and (out >> pair) & 1 == 0:
                distance, ux, uy, _, _ = _expect(rel, r, pair, rel.x_m, rel.y_m, cos, sin)
                w = 1.0 / (_range_sigma(r, ranges[pair]) ** 2 + 2.0 * r.module_sigma_m**2)
                nxx, nxy, nyy = nxx + w * ux * ux, nxy + w * ux * uy, nyy + w * uy * uy
                gx, gy = gx + w * ux * (ranges[pair] - distance), gy + w * uy * (ranges[pair] - distance)
        det = nxx * nyy - nxy * nxy
        rel.xx, rel.xy, rel.yy = nyy / det, -nxy / det, nxx / det
        rel.x_m, rel.y_m = rel.x_m + rel.xx * gx + rel.xy * gy, rel.y_m + rel.xy * gx + rel.yy * gy
        if turn % 2 == 0:
            continue
        most, at, worst = 0.0, -1, 0.0
        for pair in range(PAIRS):
            if ranges[pair] >= 0.0 and (out >> pair) & 1 == 0:
                distance, _, _, _, _ = _expect(rel, r, pair, rel.x_m, rel.y_m, cos, sin)
                over = (ranges[pair] - distance) / math.sqrt(_range_sigma(r, distance) ** 2 + 2.0 * r.module_sigma_m**2)
                worst = max(worst, abs(over))
                if over > most:
                    most, at = over, pair
        if most < 0.5 * f.gate or left <= 3:
            break
        out, left = out | (1 << at), left - 1
    if not worst < f.gate:
        _by_distance(rel, r, ranges, x, y, cos, sin)
        return
    rel.used, rel.bias[:] = left, 0.0
    for pair in range(PAIRS):
        if ranges[pair] >= 0.0 and (out >> pair) & 1 == 0:
            _, ux, uy, turn_own, turn_other = _expect(rel, r, pair, rel.x_m, rel.y_m, cos, sin)
            w = 1.0 / (_range_sigma(r, ranges[pair]) ** 2 + 2.0 * r.module_sigma_m**2)
            _change(rel, 0, -w * (rel.xx * ux + rel.xy * uy), pair, turn_own, turn_other)
            _change(rel, 1, -w * (rel.xy * ux + rel.yy * uy), pair, turn_own, turn_other)


@jit(borrows=True)
def _begin_anew(rel, r, f, ranges, x, y, cos, sin):  # type: ignore[no-untyped-def]
    """Begin another time; motion is to refute the mirrored position from there, if that is elsewhere."""
    last_x, last_y = rel.x_m, rel.y_m
    _begin(rel, r, f, ranges, x, y, cos, sin)
    if math.hypot(rel.x_m - last_x, rel.y_m - last_y) > 0.5 * BENT * math.hypot(last_x, last_y):
        _start_mirror(rel)


@jit(borrows=True)
def _update(rel, r, f, ranges, cos, sin):  # type: ignore[no-untyped-def]
    """Take the ranges of an epoch in; returns whether one is shorter than the position permits.

    Ranges that are too long are of a later path, or the position is wrong: they are left out.
    """
    used, short = 0, False
    for pair in range(PAIRS):
        if ranges[pair] < 0.0:
            continue
        distance, ux, uy, turn_own, turn_other = _expect(rel, r, pair, rel.x_m, rel.y_m, cos, sin)
        xx, xy, yy = _covariance(rel, f, r.module_sigma_m**2)
        noise = _range_sigma(r, distance) ** 2
        constant = 2.0 * r.module_sigma_m**2
        variance = _along(ux, uy, xx, xy, yy) + noise + constant
        innovation, sigma = ranges[pair] - distance, math.sqrt(variance)
        if innovation > LATE_SIGMAS * sigma or innovation < -f.gate * sigma:
            short = short or innovation < 0.0
            continue
        px, py = rel.xx * ux + rel.xy * uy, rel.xy * ux + rel.yy * uy
        total = px * ux + py * uy + noise + constant
        kx, ky = px / total, py / total
        rel.x_m, rel.y_m = rel.x_m + kx * innovation, rel.y_m + ky * innovation
        whole = total - constant  # Joseph's form: the gain is not the optimal one for the noise alone
        rel.xx += kx * kx * whole - 2.0 * kx * px
        rel.xy += kx * ky * whole - kx * py - ky * px
        rel.yy += ky * ky * whole - 2.0 * ky * py
        for k in range(PAIRS + 2):
            seen = ux * rel.bias[0, k] + uy * rel.bias[1, k]
            rel.bias[0, k] -= kx * seen
            rel.bias[1, k] -= ky * seen
        _change(rel, 0, -kx, pair, turn_own, turn_other)
        _change(rel, 1, -ky, pair, turn_own, turn_other)
        used += 1
    rel.used = used
    return short


@jit(borrows=True)
def _follow(rel, r, f, ranges, tracking, time, b, dt):  # type: ignore[no-untyped-def]
    """One epoch of the position by ranges. Of a sender that is trusted the side is the claimed one."""
    cos, sin, count = math.cos(b.heading_rad), math.sin(b.heading_rad), 0
    for pair in range(PAIRS):
        count += 1 if ranges[pair] >= 0.0 else 0
    if rel.known != 0:
        _move(rel, f, tracking, time, b, dt)
        rel.begun_s += dt
        rel.silent_s = 0.0 if count > 0 else rel.silent_s + dt
        if rel.silent_s > tracking.drop_after_s + ROUNDING:
            rel.known = 0
    if count == 0 or (rel.known == 0 and rel.claims == 0):
        return
    x, y = rel.x_m, rel.y_m
    if rel.known == 0 or (rel.claims != 0 and rel.reason == 0):
        x, y = rel.claimed_x_m, rel.claimed_y_m
    if rel.known == 0:
        _begin(rel, r, f, ranges, x, y, cos, sin)
        _start_mirror(rel)
        return
    xx, xy, yy = _covariance(rel, f, r.module_sigma_m**2)
    size = max(math.hypot(rel.x_m, rel.y_m), ROUNDING)
    if f.sigmas * math.sqrt(_along(-rel.y_m / size, rel.x_m / size, xx, xy, yy)) > BENT * size:
        _begin_anew(rel, r, f, ranges, x, y, cos, sin)
        return
    short = _update(rel, r, f, ranges, cos, sin)
    rel.astray_s = max(rel.astray_s - dt, 0.0) if 2 * rel.used >= count else rel.astray_s + dt
    if short or rel.astray_s > f.window_s:
        _begin_anew(rel, r, f, ranges, x, y, cos, sin)
    elif r.modules == 2 and _refute_side(rel, r, f, tracking, cos, sin, xx, xy, yy) and rel.reason != 0:
        x, y = _mirrored(r, rel.x_m, rel.y_m, cos, sin)
        _begin(rel, r, f, ranges, x, y, cos, sin)
        _start_mirror(rel)
        rel.sided = 1


@jit(borrows=True)
def _patience_s(r, f, pairs):  # type: ignore[no-untyped-def]
    """For how long later paths of ``pairs`` pairs may explain too long ranges at the rate of false alarms."""
    if r.late_share <= 0.0:
        return f.window_s
    return max(f.window_s, r.late_s * (2.0 * f.log_alarm / max(pairs, 1) + math.log(r.late_share)))


@jit(borrows=True)
def _below_gate_m(rel, r, f):  # type: ignore[no-untyped-def]
    """Excess of a pair that is not found: below the gate, or by diffraction, by which pairs are late differently."""
    return max(f.hidden_m, most_excess(r, math.hypot(rel.x_m, rel.y_m)))


@jit(borrows=True)
def _compare(rel, r, f, dt):  # type: ignore[no-untyped-def]
    """Compare both positions: whether they disagree, and how (SHORT, LONG, ACROSS)."""
    rel.against = rel.doubt = 0
    if rel.known == 0 or rel.claims != 1:
        return 0
    xx, xy, yy = _covariance(rel, f, r.module_sigma_m**2 + 0.5 * (_below_gate_m(rel, r, f) / f.sigmas) ** 2)
    xx, xy, yy = xx + rel.claimed_xx, xy + rel.claimed_xy, yy + rel.claimed_yy
    size = max(math.hypot(rel.x_m, rel.y_m), ROUNDING)
    ux, uy = rel.x_m / size, rel.y_m / size
    dx, dy = rel.x_m - rel.claimed_x_m, rel.y_m - rel.claimed_y_m
    radial = dx * ux + dy * uy
    det = xx * yy - xy * xy
    rel.doubt = 1 if (dx * dx * yy - 2.0 * dx * dy * xy + dy * dy * xx) / det > f.ellipse else 0
    if radial > 0.0:  # what delays explain
        late = min(radial, _late_m(r, f, size, rel.used))
        dx, dy, radial = dx - late * ux, dy - late * uy, radial - late
    rel.against = (
        1 if (dx * dx * yy - 2.0 * dx * dy * xy + dy * dy * xx) / det > f.ellipse and rel.astray_s <= 0.0 else 0
    )
    rel.against_s = rel.against_s + dt if rel.against != 0 else 0.0
    if radial * radial > f.ellipse * _along(ux, uy, xx, xy, yy):
        return SHORT if radial < 0.0 else LONG
    return ACROSS


@jit(borrows=True)
def _hidden_m(rel, r, f):  # type: ignore[no-untyped-def]
    """Excess of two later paths together that is not found: below the gate, or there since the position has begun."""
    if r.late_share <= 0.0:
        return 0.0
    since = 0.5 * f.log_risk + math.log(r.late_share) - rel.begun_s / r.late_s
    return max(_below_gate_m(rel, r, f), r.late_mean_m * since)


@jit(borrows=True)
def _hidden(rel, hidden, x, y):  # type: ignore[no-untyped-def]
    """Error in a direction (x, y) by later paths with an excess up to ``hidden``.

    That both pairs of one module are on such paths is likelier than the risk, so it is no matter of deviations. All
    pairs are not: at most three of four, one and a half times the effect of a module.
    """
    most = 0.0
    for k in range(PAIRS):
        most = max(most, abs(x * rel.bias[0, k] + y * rel.bias[1, k]))
    return 1.5 * hidden * most


@jit(borrows=True)
def _show(rel, r, f, track, time, b):  # type: ignore[no-untyped-def]
    """Fill the track of a vehicle: the position by all that is trusted, with its levels."""
    if rel.known == 0:
        silence(track, math.inf)
        return
    xx, xy, yy = _covariance(rel, f, r.module_sigma_m**2)
    cxx, cxy, cyy = rel.claimed_xx, rel.claimed_xy, rel.claimed_yy
    dx, dy, size = rel.claimed_x_m - rel.x_m, rel.claimed_y_m - rel.y_m, max(math.hypot(rel.x_m, rel.y_m), ROUNDING)
    ux, uy = rel.x_m / size, rel.y_m / size
    late, hidden = _late_m(r, f, size, rel.used), _hidden_m(rel, r, f)
    gxx, gxy, gyx, gyy = 0.0, 0.0, 0.0, 0.0  # gain of the broadcast position: P (P + B)^-1
    if rel.claims == 1 and rel.reason == 0 and rel.doubt == 0:
        sxx, sxy, syy = xx + cxx, xy + cxy, yy + cyy
        det = sxx * syy - sxy * sxy
        gxx, gxy = (xx * syy - xy * sxy) / det, (xy * sxx - xx * sxy) / det
        gyx, gyy = (xy * syy - yy * sxy) / det, (yy * sxx - xy * sxy) / det
        # Late ranges put the position too far away, by no more than the broadcast one permits.
        nearest = ux * dx + uy * dy + size - f.sigmas * math.sqrt(_along(ux, uy, cxx, cxy, cyy))
        far = ux * (rel.x_m + gxx * dx + gxy * dy) + uy * (rel.y_m + gyx * dx + gyy * dy)
        own = 1.0 - (ux * (gxx * ux + gxy * uy) + uy * (gyx * ux + gyy * uy))
        late = max(min(late * own, far - nearest), 0.0)
    x, y = rel.x_m + gxx * dx + gxy * dy, rel.y_m + gyx * dx + gyy * dy
    tx, ty = gyx * ux - gxx * uy, gyy * ux - gxy * uy
    spread = _along(-uy - tx, ux - ty, xx, xy, yy) + _along(tx, ty, cxx, cxy, cyy)
    late += 0.5 * f.sigmas**2 * spread / size  # a circle is no line
    cos, sin = math.cos(rel.heading_rad), math.sin(rel.heading_rad)
    for across in range(2):
        ax, ay = (-sin, cos) if across else (cos, sin)
        tx, ty = gxx * ax + gyx * ay, gxy * ax + gyy * ay  # what a direction takes from the broadcast, and the rest
        wx, wy = ax - tx, ay - ty
        level = f.sigmas * math.sqrt(_along(wx, wy, xx, xy, yy) + _along(tx, ty, cxx, cxy, cyy))
        level += _hidden(rel, hidden, wx, wy) + late * abs(ax * ux + ay * uy)
        if rel.reason == 0 and rel.doubt != 0:  # either may be right
            level = max(level, abs(ax * dx + ay * dy) + f.sigmas * math.sqrt(_along(ax, ay, cxx, cxy, cyy)))
        if (rel.reason != 0 or rel.doubt != 0) and rel.sided == 0 and r.modules == 2:
            mx, my = _mirrored(r, x, y, math.cos(b.heading_rad), math.sin(b.heading_rad))
            level += abs(ax * (mx - x) + ay * (my - y))
        if across:
            track.pl_ct_m = level
        else:
            track.pl_at_m = level
    if rel.claims == 1 and rel.reason == 0 and rel.doubt == 0:  # ranges that have just begun may help too little
        at = f.sigmas * math.sqrt(_along(cos, sin, cxx, cxy, cyy))
        ct = f.sigmas * math.sqrt(_along(-sin, cos, cxx, cxy, cyy))
        if at + ct < track.pl_at_m + track.pl_ct_m:
            track.pl_at_m, track.pl_ct_m, x, y = at, ct, rel.claimed_x_m, rel.claimed_y_m
    track.x_m, track.y_m, track.time_s = b.x_m + x, b.y_m + y, 0.0
    track.heading_rad, track.speed_mps, track.lag_s = rel.heading_rad, rel.speed_mps, max(time - rel.heard_s, 0.0)


@jit(borrows=True)
def relate(picture, relations, held, tracks, ranges, r, f, tracking, time, b, t):  # type: ignore[no-untyped-def]
    """One epoch of an ego: follow the vehicles of C slots by ranges, test what they broadcast, and fill their tracks.

    relations (C,) RELATION; held (C,) SIGHTING of the radio, of which those of excluded senders are cleared; tracks
    (C + 1,) SIGHTING; ranges (C, PAIRS); r: RANGING; f: COOPERATION; tracking: TRACKING; b: BELIEF; t: TRACK.
    """
    dt, compared, against = r.epoch_s, 0, 0
    for i in range(relations.shape[0]):
        rel = relations[i]
        _claim(rel, held[i], f, tracking, time, b, t)
        _follow(rel, r, f, ranges[i], tracking, time, b, dt)
        kind = _compare(rel, r, f, dt)
        if rel.reason == 0 and kind != 0:
            compared += 1
            against += rel.against
    picture.excluded = 0
    for i in range(relations.shape[0]):
        rel = relations[i]
        if rel.against != 0 and rel.reason == 0 and not (compared >= 3 and 2 * against > compared):
            kind = _compare(rel, r, f, 0.0)
            patience = f.window_s if kind == SHORT else _patience_s(r, f, rel.used)
            if rel.against_s >= patience - ROUNDING:
                rel.reason = picture.reason = kind
        if rel.reason != 0:
            silence(held[i], -math.inf)
            picture.excluded += 1
        _show(rel, r, f, tracks[i], time, b)
