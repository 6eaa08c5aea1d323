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

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record
from lanebound.integrity.core.simd_kernel import WIDTH, absolute, largest, load, maximum, spread, store, where_less
from lanebound.integrity.monitoring.doppler_separation_kernel import (
    IDLE,
    LOST,
    MONITORED,
    Influences,
    Separations,
)

__all__ = [
    "SPREAD",
    "Courses",
    "advance_courses",
    "advance_spread",
    "courses_of",
    "largest_course",
    "move_by_courses",
    "raise_states",
]

Array = NDArray[np.float64]

FADED = 1e-4  # share of the heading


class Courses(NamedTuple):
    """Separation of the heading filter by each fault mode (:mod:`.doppler_separation_kernel`).

    (W,) each, or (B, W): h, b, s heading [rad], gyro bias [rad/s] and gyro scale [-] of the filter less those without
    the mode; used, lost share of the heading [-] that rests on courses with it, and on courses that had no solution
    without it; mean the mean of h over the last epoch [rad].
    """

    h: Array
    b: Array
    s: Array
    used: Array
    lost: Array
    mean: Array


@jit(inline=True)
def courses_of(a: Courses, v: int) -> Courses:
    """Row v, (W,) each, of courses (B, W)."""
    return Courses(a.h[v], a.b[v], a.s[v], a.used[v], a.lost[v], a.mean[v])


SPREAD = record(
    hh="variance of h [rad^2]",
    hb="covariance of h and b [rad^2/s]",
    hs="covariance of h and s [rad]",
    bb="variance of b [rad^2/s^2]",
    bs="covariance of b and s [rad/s]",
    ss="variance of s [-]",
)
"""Covariance of the separations of the heading filter, for the one of the largest variance."""


@jit(borrows=True)
def advance_courses(turn: Any, now: Influences, c: Courses) -> float:
    """Advance the separations by an epoch of the filter, ``turn`` of TURN.

    ``c_k = right'd_k`` where a course calibrates. Returns the largest variance of any ``c_k`` [rad^2].
    """
    r_e, r_n, k_h, keep = turn.right[0], turn.right[1], turn.k_h, 1.0 - turn.k_h
    calibrates = r_e != 0.0 or r_n != 0.0
    dt, delta = (0.0, 0.0) if turn.rests else (turn.dt, turn.delta)
    most = spread(0.0)
    for k in range(0, c.h.size, WIDTH):
        h, b, s, used, lost = load(c.h, k), load(c.b, k), load(c.s, k), load(c.used, k), load(c.lost, k)
        seen, state = spread(0.0), spread(IDLE)
        if calibrates:
            seen, state = load(now.d_e, k) * r_e + load(now.d_n, k) * r_n, load(now.state, k)
            first, second = load(now.l_ee, k) * r_e + load(now.l_ne, k) * r_n, load(now.l_nn, k) * r_n
            most = maximum(most, first * first + second * second)
        turned = b * dt + s * delta
        store(h - 0.5 * turned, c.mean, k)
        h -= turned
        if not turn.rests:
            used = keep * used + where_less(IDLE, state, k_h, 0.0)
            lost = keep * lost + where_less(MONITORED, state, k_h, 0.0)
        off = seen - (b if turn.rests else h)
        h, b, s = h + k_h * off, b + turn.k_b * off, s + turn.k_s * off
        if k_h > 0.0:
            stays = where_less(used, FADED, where_less(IDLE, state, 1.0, 0.0), 1.0)
            h, b, s, used, lost = h * stays, b * stays, s * stays, used * stays, lost * stays
        store(h, c.h, k)
        store(b, c.b, k)
        store(s, c.s, k)
        store(used, c.used, k)
        store(lost, c.lost, k)
    return float(largest(most))


@jit(borrows=True, forceinline=True)
def _state_of(c: Courses, k: int) -> Any:
    """IDLE, MONITORED or LOST of the modes k to k + WIDTH - 1."""
    return where_less(FADED, load(c.lost, k), LOST, where_less(FADED, load(c.used, k), MONITORED, IDLE))


@jit(borrows=True)
def move_by_courses(across_e: float, across_n: float, c: Courses, s: Separations) -> None:
    """Add to separations what the last epoch moved along the heading: ``D_k += across h_mean`` [m]."""
    for k in range(0, c.h.size, WIDTH):
        mean = load(c.mean, k)
        store(load(s.d_e, k) + across_e * mean, s.d_e, k)
        store(load(s.d_n, k) + across_n * mean, s.d_n, k)
        store(maximum(load(s.state, k), _state_of(c, k)), s.state, k)


@jit(borrows=True)
def raise_states(now: Influences, s: Separations, c: Courses, state: Array) -> None:
    """The state (W,) of each mode: in the velocity now, in the position since the fix, or in the heading."""
    for k in range(0, state.size, WIDTH):
        store(maximum(maximum(load(now.state, k), load(s.state, k)), _state_of(c, k)), state, k)


@jit(borrows=True)
def largest_course(c: Courses) -> float:
    """Largest separation of the heading by any mode [rad]."""
    most = spread(0.0)
    for k in range(0, c.h.size, WIDTH):
        most = maximum(most, absolute(load(c.h, k)))
    return float(largest(most))


@jit(borrows=True)
def advance_spread(turn: Any, variance: float, across_e: float, across_n: float, p: Any, growth: Any) -> None:
    """Advance the covariance of h, and of h with the part of every position that it has moved.

    Parameters
    ----------
    turn : TURN of the heading filter
    variance : of ``c_k`` as a white error, the largest of all k [rad^2]
    across_e, across_n : ``V dt`` across the course, 0 where the position does not move along the heading [m]
    p, growth : SPREAD, and GROWTH of every dead reckoning
    """
    dt, delta = (0.0, 0.0) if turn.rests else (turn.dt, turn.delta)
    h = p.hh - 0.5 * (dt * p.hb + delta * p.hs)
    b = p.hb - 0.5 * (dt * p.bb + delta * p.bs)
    s = p.hs - 0.5 * (dt * p.bs + delta * p.ss)
    mean = h - 0.5 * (dt * b + delta * s)
    h -= dt * b + delta * s
    for k in range(growth.shape[0]):
        g = growth[k]
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
