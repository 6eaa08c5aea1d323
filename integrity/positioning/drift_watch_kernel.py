"""The drift watch: RTK displacements against the path by gyro and odometer, over windows of up to some seconds.

The path from an anchor, ``a`` in E and N, has an almost constant error of scale s and of course c. The displacement of
RTK over the same window is ``(1 + s) a + c a_right + noise``: a path enlarged and turned. A position that drifts away
differs from it by ``m``, the misfit. Both s and c are estimated from the windows before the anchor, so what is left of
their errors is small against the declared bounds of scale and heading, which the levels of dead reckoning must use.

For a window of T seconds, of which the vehicle moves M, with path L, at every epoch and for every anchor:

    along   |m_a - s L|  <=  K sqrt(var_rtk + var_o(M) + L^2 (P_s + q_s T) + 2 L g_s var_0)  +  B_a
    across  |m_c - c L|  <=  K sqrt(var_rtk + L^2 (P_c + (W - W_0) / 3) + 2 L g_c var_0)     +  B_c

``var_o(M) = 2 sigma^2 tau (M - tau (1 - exp(-M / tau)))`` is of the odometer's correlated noise, P_s and P_c are the
variances of s and c at the anchor; g_s and g_c are the gains by which the RTK error at the anchor, of variance var_0,
entered s and c (it is in both parts of the misfit with the same sign). ``W`` is the variance by which the gyro's
heading has walked (:func:`walk_of`), and B holds the bounds: speed bias ``b |M - p L|``, of which s already holds
``b p`` (p the mean of 1 / v where it was learnt); slip ``g |v^2 - v_0^2| / 2`` of the wheels; creep at rest, axle
distance, heading drift, phase biases. Where the window bends, along and across mix by the sine of the turn. A course
that is wrong by e shortens the path by ``L (1 - cos e)``: B_a has it for K sigmas of the course, which is all of the
path while the heading is unknown, as before the first motion. Until K sigmas are below LARGEST_COURSE nothing is learnt
and a window shows drifts at rest only; then windows begin anew. K follows from the false alarms allowed for an hour by
the union bound over epochs, anchors, axes and signs.

The smallest drift that is found is the right side over T. Not found: a slower one, and one that has always been there,
which s and c take for their own. What is found is a drift of RTK or an error of gyro and odometer of the same rate: a
step of the odometer's scale (snow, slip) is a drift along the track. Doppler tells of the gyro's bias and scale, and
decides only how long RTK waits (:func:`blames_odometer`).
"""

from __future__ import annotations

import math
from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record

__all__ = [
    "ANCHOR",
    "DRIFT",
    "DRIFT_RULES",
    "advance",
    "allowed",
    "begin_watch",
    "blames_odometer",
    "find_drift",
    "fold_doppler",
    "learn",
    "misfit",
    "odometer_variance",
    "rates_of",
    "walk_of",
]

DRIFT_RULES = record(
    spacing="time between two anchors [s]",
    window="longest window [s]",
    k="threshold in sigmas [-]",
    scale="declared bound of the scale error, its prior as 1 sigma [-]",
    scale_walk="its random walk [1/sqrt(s)]",
    slip="bound of the wheels' slip per acceleration [s^2/m]",
    sigma="odometer speed, 1 sigma [m/s]",
    tau="correlation time of its error [s]",
    bias="bound of a constant error [m/s]",
    creep="speed that the odometer may show as rest [m/s]",
    axle="bound of the error of the axle distance [m]",
    heading_drift="growth of the heading's bound [rad/s]",
    phase="bound of the position's error by phase biases, at both ends of a window [m]",
)
"""DriftWatchConfig as the kernel takes it, with the declared figures of dead reckoning."""

DRIFT = record(
    path_e="path by gyro and odometer, East [m]",
    path_n="the same, North [m]",
    heading="heading by the gyro alone, from that of the vehicle at the first anchor [rad]",
    turned="turn, signed [rad]",
    moving_s="time in motion [s]",
    rest_s="time at rest [s]",
    walked="W, variance by which the error of that heading has walked [rad^2]",
    scale="s, RTK over the odometer, less one [-]",
    p_scale="its variance [-]",
    has_scale=("?", "s begins with the prior"),
    pace="what s has in it of a constant error of the speed, per m/s [s/m]",
    gain_scale="g_s, by which the RTK error at the last anchor is in s [1/m]",
    course="c, course of RTK less that of the path [rad]",
    p_course="its variance [rad^2]",
    gain_course="g_c, by which the RTK error at the last anchor is in c [1/m]",
    doppler_e="path by Doppler, East [m]",
    doppler_n="the same, North [m]",
    seen=("?", "the epoch before had a Doppler velocity"),
    last_e="that velocity, East [m/s]",
    last_n="the same, North [m/s]",
    unseen_s="time without a Doppler velocity [s]",
    since_anchor="time since the last anchor [s]",
    anchors=("i8", "anchors in use"),
    next=("i8", "place of the next one"),
)
"""State of the drift watch."""

ANCHOR = record(
    east="RTK position, East [m]",
    north="North [m]",
    variance="its variance, on the worst axis [m^2]",
    speed="odometer speed [m/s]",
    at=(DRIFT, "the drift watch at that time"),
)
"""Where a window begins."""

LEAST_PATH_M = 2.0  # of a window that tells scale and course
LARGEST_COURSE = 0.2  # K sigmas of the course up to which sines are angles [rad]; it shortens the path by 2 %


@jit
def odometer_variance(moving: float, sigma: float, tau: float) -> float:
    """Variance of the distance by a Gauss-Markov error of the speed over a time [m^2]."""
    return 2.0 * sigma * sigma * tau * (moving - tau * (1.0 - math.exp(-moving / tau)))


@jit
def begin_watch(d: Any) -> None:
    """Forget all anchors: there is no RTK position, or it is not trusted; s and c remain."""
    d.anchors, d.next, d.since_anchor = 0, 0, 0.0


@jit
def advance(
    dt: float, distance: float, slip: float, turning: float, resting: bool, walk: float, rules: Any, d: Any
) -> None:
    """Advance the path by an epoch.

    Parameters
    ----------
    distance : of the odometer [m]; slip : angle from the heading to the course of the reference point [rad].
    turning : yaw rate less what is known of its bias and scale [rad/s].
    walk : variance rate of the error that turning adds to the course, :func:`walk_of` [rad^2/s].
    """
    if resting:
        d.rest_s += dt
    else:
        course = d.heading + 0.5 * dt * turning + slip
        d.path_e += distance * math.sin(course)
        d.path_n += distance * math.cos(course)
        d.heading += turning * dt
        d.turned += turning * dt
        d.moving_s += dt
        d.walked += dt * walk
        d.p_course += dt * walk
    d.p_scale += dt * rules.scale_walk * rules.scale_walk
    d.since_anchor += dt


@jit
def fold_doppler(dt: float, tested: bool, v_e: float, v_n: float, d: Any) -> None:
    """Advance the path by Doppler by the velocity (v_e, v_n) [m/s] at the end of an epoch, if it is ``tested``."""
    if tested:
        before_e, before_n = (d.last_e, d.last_n) if d.seen else (v_e, v_n)
        d.doppler_e += 0.5 * dt * (before_e + v_e)
        d.doppler_n += 0.5 * dt * (before_n + v_n)
        d.last_e, d.last_n = v_e, v_n
    else:
        d.unseen_s += dt
    d.seen = tested


@jit
def walk_of(noise: float, p_bias: float, p_scale: float, turning: float, rules: Any) -> float:
    """Variance rate of a random walk that bounds the gyro's error over any window [rad^2/s].

    noise : angle random walk [rad/sqrt(s)]; p_bias, p_scale : variances of the gyro's bias [rad^2/s^2] and scale [-],
    which last: ``(b T)^2 <= b^2 T_max T`` over windows of at most T_max, and ``(s a)^2 <= s^2 pi a`` for turns to pi.
    """
    return float(noise * noise + p_bias * rules.window + p_scale * math.pi * abs(turning))


@jit
def find_drift(
    east: float, north: float, variance: float, speed: float, rules: Any, d: Any, anchors: Records
) -> int:  # fmt: skip
    """Place of the anchor since which RTK at (east, north) [m] has drifted most; -1 if it has not drifted.

    variance : of the RTK position on its worst axis [m^2]; anchors (N,) of the vehicle.
    """
    found, most = -1, 0.0
    for i in range(d.anchors):
        along, across, _, _ = misfit(east, north, d, anchors[i])
        most_along, most_across = allowed(variance, speed, rules, d, anchors[i])
        size = math.hypot(along, across)
        if (abs(along) > most_along or abs(across) > most_across) and size > most:
            found, most = i, size
    return found


@jit
def rates_of(
    east: float, north: float, variance: float, speed: float, rules: Any, d: Any, anchors: Records
) -> tuple[float, float]:
    """Largest rates at which RTK leaves the path, along and across [m/s], of windows that show it or last a spacing.

    A drift or error that begins inside a long window has a larger rate than the window's mean. One that is found sooner
    than after a spacing is larger than this: its windows, too, began before it.
    """
    rate_along, rate_across = 0.0, 0.0
    for i in range(d.anchors):
        at = anchors[i].at
        along, across, _, _ = misfit(east, north, d, anchors[i])
        most_along, most_across = allowed(variance, speed, rules, d, anchors[i])
        time = d.moving_s - at.moving_s + d.rest_s - at.rest_s
        if time >= rules.spacing or (time > 0.0 and (abs(along) > most_along or abs(across) > most_across)):
            if abs(along) > abs(rate_along) * time:
                rate_along = along / time
            if abs(across) > abs(rate_across) * time:
                rate_across = across / time
    return rate_along, rate_across


@jit
def blames_odometer(
    east: float, north: float, variance: float, speed: float, rules: Any, d: Any, anchor: Any
) -> bool:  # fmt: skip
    """Whether the odometer explains the misfit of a window: within its declared scale, and Doppler agrees with RTK.

    The displacement by Doppler lies nearer to that of RTK than to the path; across nothing is found; and the scale
    that RTK shows is one that the declared bound allows. A spoofer that moves Doppler as well meets the first two.
    """
    at = anchor.at
    if d.unseen_s > at.unseen_s:
        return False
    along, across, _, _ = misfit(east, north, d, anchor)
    _, most_across = allowed(variance, speed, rules, d, anchor)
    length = math.hypot(d.path_e - at.path_e, d.path_n - at.path_n)
    if abs(across) > most_across or abs(along + at.scale * length) > rules.scale * length:
        return False
    off_e = east - anchor.east - (d.doppler_e - at.doppler_e)
    off_n = north - anchor.north - (d.doppler_n - at.doppler_n)
    return bool(math.hypot(off_e, off_n) < 0.5 * math.hypot(along, across))


@jit
def misfit(east: float, north: float, d: Any, anchor: Any) -> tuple[float, float, float, float]:
    """Misfit along and across the window's path [m], less that of scale and course; sine and cosine of its azimuth."""
    at = anchor.at
    a_e, a_n = d.path_e - at.path_e, d.path_n - at.path_n
    m_e, m_n = east - anchor.east - a_e, north - anchor.north - a_n
    length = math.hypot(a_e, a_n)
    sin_u, cos_u = (a_e / length, a_n / length) if length > 0.0 else (0.0, 1.0)
    along = m_e * sin_u + m_n * cos_u - at.scale * length
    across = m_e * cos_u - m_n * sin_u - at.course * length
    return along, across, sin_u, cos_u


@jit
def allowed(variance: float, speed: float, rules: Any, d: Any, anchor: Any) -> tuple[float, float]:
    """What a healthy window may misfit by along and across [m]."""
    at = anchor.at
    moving, rest = d.moving_s - at.moving_s, d.rest_s - at.rest_s
    length = math.hypot(d.path_e - at.path_e, d.path_n - at.path_n)
    turned = abs(d.turned - at.turned)
    bend = math.sin(min(turned, 0.5 * math.pi))
    noise = odometer_variance(moving, rules.sigma, rules.tau)
    scale = at.p_scale + rules.scale_walk * rules.scale_walk * (moving + rest)
    course = at.p_course + (d.walked - at.walked) / 3.0
    along = noise + length * length * scale + 2.0 * length * at.gain_scale * anchor.variance
    across = length * length * course + 2.0 * length * at.gain_course * anchor.variance
    common = rules.phase + rest * rules.creep + 2.0 * rules.axle * math.sin(0.5 * min(turned, math.pi))
    wheels = rules.bias * abs(moving - at.pace * length) + 0.5 * rules.slip * abs(
        speed * speed - anchor.speed * anchor.speed
    )
    drift = rules.heading_drift * (moving + rest)
    turn = 0.5 * drift * length
    farthest = rules.k * math.sqrt(at.p_course + d.walked - at.walked) + drift
    wheels += length * (1.0 - math.cos(min(farthest, math.pi)))
    rtk, b2 = variance + anchor.variance, bend * bend
    most_along = rules.k * math.sqrt(rtk + along + b2 * across) + common + wheels + bend * turn
    most_across = rules.k * math.sqrt(rtk + across + b2 * along) + common + turn + bend * wheels
    return most_along, most_across


@jit
def learn(
    east: float, north: float, variance: float, speed: float, heading: float, p_course: float, rules: Any, d: Any,
    anchors: Records,
) -> None:  # fmt: skip
    """After each spacing: learn s and c from the window since the last anchor, and set a new one at (east, north) [m].

    Without an anchor the path turns to ``heading`` [rad], whose variance ``p_course`` [rad^2] is that of c; of s
    remains what is known. So does it where the course of the windows was unknown and the heading is not any more.
    """
    n, known = anchors.shape[0], _course_known(d.p_course, rules)
    if d.anchors > 0 and not known and _course_known(p_course, rules):
        begin_watch(d)
    if d.anchors > 0 and d.since_anchor < rules.spacing:
        return
    d.gain_scale, d.gain_course = 0.0, 0.0
    if d.anchors == 0:
        d.heading, d.course, d.p_course = heading, 0.0, p_course
        if not d.has_scale:
            d.scale, d.p_scale, d.pace, d.has_scale = 0.0, rules.scale * rules.scale, 0.0, True
    else:
        anchor = anchors[(d.next - 1) % n]
        at = anchor.at
        along, across, _, _ = misfit(east, north, d, anchor)
        square = (d.path_e - at.path_e) ** 2 + (d.path_n - at.path_n) ** 2
        bend = math.sin(min(abs(d.turned - at.turned), 0.5 * math.pi))
        if known and square > LEAST_PATH_M * LEAST_PATH_M:
            moving = d.moving_s - at.moving_s
            noise = 2.0 * rules.sigma * rules.sigma * rules.tau * moving
            rtk, length = variance + anchor.variance, math.sqrt(square)
            across += (at.course - d.course) * length  # both are those of the anchor, unless learnt since
            along += (at.scale - d.scale) * length
            k_s = d.p_scale / (d.p_scale + (rtk + noise) / square)
            k_c = d.p_course / (d.p_course + (rtk + bend * bend * noise) / square)
            d.scale += k_s * along / length
            d.pace += k_s * (moving / length - d.pace)
            d.course += k_c * across / length
            d.p_scale *= 1.0 - k_s
            d.p_course *= 1.0 - k_c
            d.gain_scale, d.gain_course = k_s / length, k_c / length
    d.since_anchor = 0.0
    anchor = anchors[d.next]
    anchor.east, anchor.north, anchor.variance, anchor.speed = east, north, variance, speed
    copy_watch(d, anchor.at)
    d.next = (d.next + 1) % n
    d.anchors = min(d.anchors + 1, n)


@jit
def _course_known(p_course: float, rules: Any) -> bool:
    """Whether a course of this variance [rad^2] is good enough to learn from a window."""
    return bool(rules.k * math.sqrt(p_course) < LARGEST_COURSE)


@jit
def copy_watch(source: Any, to: Any) -> None:
    """Copy what windows compare."""
    to.path_e, to.path_n, to.turned = source.path_e, source.path_n, source.turned
    to.moving_s, to.rest_s, to.walked = source.moving_s, source.rest_s, source.walked
    to.scale, to.p_scale, to.gain_scale, to.pace = source.scale, source.p_scale, source.gain_scale, source.pace
    to.course, to.p_course, to.gain_course = source.course, source.p_course, source.gain_course
    to.doppler_e, to.doppler_n, to.unseen_s = source.doppler_e, source.doppler_n, source.unseen_s
