"""What one faulty satellite, or system, has done to the heading that Doppler calibrates.

Let ``x = [d, b, c]`` be the errors of the heading filter and ``x_k`` those of the same filter, with the same gains,
whose courses come from the velocities without k. Their difference ``h = x - x_k`` is *known*: it follows the filter's
own equations, ``h' = (I - k H) F h + k c_k``, where ``c_k`` is the course of v less the course of v_k. If k is faulty,
x_k does not depend on the fault, so a position that dead reckoning moves along the heading is wrong by the error of x_k
and by

    D_k += V dt across h_mean,

which adds to the separation of the position (:mod:`.doppler_separation_kernel`): a drift too slow for the test of any
epoch shows in h as soon as the mean of its courses exceeds the noise of that mean.

Noise of ``c_k`` does not correlate with the course (least squares), so it adds to the variance of x. One covariance
serves all k: that of a filter whose courses have, in every epoch, the largest variance of any ``c_k``, times the factor
of a white error that bounds its correlation in time
(:func:`lanebound.integrity.positioning.correlation.bound_correlation`).

How much of the heading rests on courses with k fades as later courses arrive. Below FADED, k no longer counts.
"""

from __future__ import annotations

from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.monitoring.doppler_separation_kernel import IDLE, LOST, MONITORED

__all__ = ["COURSE", "SPREAD", "advance_course", "advance_spread", "largest_course", "move_by_course", "state_of"]

FADED = 1e-4  # share of the heading

COURSE = record(
    h="heading of the filter less that without the mode [rad]",
    b="gyro bias, the same difference [rad/s]",
    s="gyro scale, the same difference [-]",
    used="share of the heading that rests on courses with the mode [-]",
    lost="share of it that rests on courses that had no solution without the mode [-]",
    mean="mean of h over the last epoch [rad]",
)
"""Separation of the heading filter by a fault mode (:mod:`.doppler_separation_kernel`)."""

SPREAD = record(
    hh="variance of h [rad^2]",
    hb="covariance of h and b [rad^2/s]",
    hs="covariance of h and s [rad]",
    bb="variance of b [rad^2/s^2]",
    bs="covariance of b and s [rad/s]",
    ss="variance of s [-]",
)
"""Covariance of the separations of the heading filter, for the one of the largest variance."""


@jit
def advance_course(turn: Any, now: Any, c: Any) -> float:
    """Advance the separation of a mode by an epoch of the filter, ``turn`` of TURN; ``now`` is its INFLUENCE.

    ``c_k = right'd_k`` where a course calibrates. Returns the variance of ``c_k`` [rad^2].
    """
    r_e, r_n, k_h = turn.right[0], turn.right[1], turn.k_h
    dt, delta = (0.0, 0.0) if turn.rests else (turn.dt, turn.delta)
    seen, state, variance = 0.0, IDLE, 0.0
    if r_e != 0.0 or r_n != 0.0:
        seen, state = now.d_e * r_e + now.d_n * r_n, now.state
        first, second = now.l_ee * r_e + now.l_ne * r_n, now.l_nn * r_n
        variance = first * first + second * second
    turned = c.b * dt + c.s * delta
    c.mean = c.h - 0.5 * turned
    c.h -= turned
    if not turn.rests:
        c.used = (1.0 - k_h) * c.used + (k_h if state > IDLE else 0.0)
        c.lost = (1.0 - k_h) * c.lost + (k_h if state > MONITORED else 0.0)
    off = seen - (c.b if turn.rests else c.h)
    c.h += k_h * off
    c.b += turn.k_b * off
    c.s += turn.k_s * off
    # Later courses have replaced nearly all that the mode contributed: it no longer counts.
    if k_h > 0.0 and c.used < FADED and state == IDLE:
        c.h, c.b, c.s, c.used, c.lost = 0.0, 0.0, 0.0, 0.0, 0.0
    return variance


@jit
def state_of(c: Any) -> int:
    """IDLE, MONITORED or LOST: whether the heading rests on courses with the mode."""
    if c.lost > FADED:
        return LOST
    return MONITORED if c.used > FADED else IDLE


@jit
def move_by_course(across_e: float, across_n: float, c: Any, s: Any) -> None:
    """Add to a separation what the last epoch moved along the heading: ``D_k += across h_mean`` [m]."""
    s.d_e += across_e * c.mean
    s.d_n += across_n * c.mean
    s.state = max(s.state, state_of(c))


@jit
def largest_course(faults: Records) -> float:
    """Largest separation of the heading by any mode [rad]; faults (M,) with a field ``course`` of COURSE."""
    most = 0.0
    for k in range(faults.shape[0]):
        most = max(most, abs(faults[k].course.h))
    return most


@jit
def advance_spread(
    turn: Any, variance: float, right_e: float, right_n: float, runs: tuple[float, ...], p: Any, growth: Any
) -> None:  # fmt: skip
    """Advance the covariance of h, and of h with the part of every position that it has moved.

    Parameters
    ----------
    turn : TURN of the heading filter
    variance : of ``c_k`` as a white error, the largest of all k [rad^2]
    right_e, right_n : direction to the right of the course [-]
    runs : ``V dt`` of every dead reckoning, 0 where it does not move along the heading [m]
    p, growth : SPREAD, and GROWTH of every dead reckoning
    """
    dt, delta = (0.0, 0.0) if turn.rests else (turn.dt, turn.delta)
    h = p.hh - 0.5 * (dt * p.hb + delta * p.hs)
    b = p.hb - 0.5 * (dt * p.bb + delta * p.bs)
    s = p.hs - 0.5 * (dt * p.bs + delta * p.ss)
    mean = h - 0.5 * (dt * b + delta * s)
    h -= dt * b + delta * s
    for k in range(growth.shape[0]):
        g, across_e, across_n = growth[k], runs[k] * right_e, runs[k] * right_n
        e, n = g.fh_e - 0.5 * (dt * g.fb_e + delta * g.fs_e), g.fh_n - 0.5 * (dt * g.fb_n + delta * g.fs_n)
        g.f_ee += across_e * (2.0 * e + across_e * mean)
        g.f_en += across_e * n + across_n * e + across_e * across_n * mean
        g.f_nn += across_n * (2.0 * n + across_n * mean)
        g.fh_e += across_e * h - dt * g.fb_e - delta * g.fs_e
        g.fh_n += across_n * h - dt * g.fb_n - delta * g.fs_n
        g.fb_e += across_e * b
        g.fb_n += across_n * b
        g.fs_e += across_e * s
        g.fs_n += across_n * s
        seen_e, seen_n = (g.fb_e, g.fb_n) if turn.rests else (g.fh_e, g.fh_n)
        g.fh_e -= turn.k_h * seen_e
        g.fh_n -= turn.k_h * seen_n
        g.fb_e -= turn.k_b * seen_e
        g.fb_n -= turn.k_b * seen_n
        g.fs_e -= turn.k_s * seen_e
        g.fs_n -= turn.k_s * seen_n
    hb, hs = p.hb - dt * p.bb - delta * p.bs, p.hs - dt * p.bs - delta * p.ss
    p.hh += -dt * (p.hb + hb) - delta * (p.hs + hs)
    p.hb, p.hs = hb, hs
    kh, kb, ks = turn.k_h, turn.k_b, turn.k_s
    if kh == 0.0 and kb == 0.0 and ks == 0.0:
        return
    ch, cb, cs, own = (p.hb, p.bb, p.bs, p.bb) if turn.rests else (p.hh, p.hb, p.hs, p.hh)
    own += variance
    p.hh += kh * (kh * own - 2.0 * ch)
    p.hb += kh * kb * own - kh * cb - ch * kb
    p.hs += kh * ks * own - kh * cs - ch * ks
    p.bb += kb * (kb * own - 2.0 * cb)
    p.bs += kb * ks * own - kb * cs - cb * ks
    p.ss += ks * (ks * own - 2.0 * cs)
