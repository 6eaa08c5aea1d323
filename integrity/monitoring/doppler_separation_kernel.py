"""Solution separation of a position that is integrated from Doppler velocities, satellite by satellite.

A fault of satellite k that drifts below the threshold of each epoch's test adds up in the position. Let p be the
position and p_k the position from the velocities without satellite k, both since the same RTK fix. Only their
difference is stored: ``D_k = p - p_k``, the integral of ``d_k = v - v_k``, which is *known*. If k is the faulty
satellite, p_k does not depend on the fault, whatever it did and when, so that

    abs(p - true) <= abs(D_k) + abs(p_k - true),   PL_k,q = abs(D_k,q) + K_f sigma_k,q + B_q.

No test is needed, and no detection threshold accumulates: a persistent drift shows in ``D_k`` as soon as its integral
exceeds the noise of the integral, long before it would show in one epoch. Noise makes ``D_k`` larger, never the bound
too small, because ``sigma_k`` and ``K_f`` do not depend on the measurements.

Removing row k of the velocity (design row ``[-e, 1]``, z = e less the weighted mean, w weight, ``f = 1 - h_kk``):
``d_k = u_k n_k``, ``u_k = -Q z_k sqrt(w_k / f_k)``, with the w-statistic ``n_k = r_k sqrt(w_k / f_k)`` of variance 1.
The separation of one epoch does not correlate with v (least squares), so ``Q_k = Q + u_k u_k'`` and, with n_k
Gauss-Markov with a white part as the velocity error itself, ``sigma_k^2 = sigma_0^2 + Var(D_k)``.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.monitoring.protection_kernel import q_inverse

__all__ = [
    "AFFORDABLE",
    "INFLUENCE",
    "SEPARATION",
    "advance_separation",
    "exposure",
    "find_influences",
    "risk_factors",
    "worst_separation",
]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

IDLE, MONITORED, LOST = 0, 1, 2  # not used; monitored; a velocity had no solution without this satellite

INFLUENCE = record(
    u_e="u of the satellite, East [m/s]",
    u_n="u of the satellite, North [m/s]",
    statistic="n, its w-statistic [-]",
    state=("i8", "IDLE, MONITORED or LOST"),
)
"""What one satellite does to the velocity of one epoch; zeros where there was no velocity or it was not used."""

SEPARATION = record(
    d_e="D, separation of the positions since the fix, East [m]",
    d_n="D, North [m]",
    s_ee="variance of D, East [m^2]",
    s_en="covariance of D, East and North [m^2]",
    s_nn="variance of D, North [m^2]",
    c_e="Cov(D_E, n) [m]",
    c_n="Cov(D_N, n) [m]",
    last_s="weight with which the last velocity stands in the position [s]",
    state=("i8", "since the fix: IDLE, MONITORED or LOST"),
)
"""The separation that one satellite has caused since an RTK fix."""

UNSOLVABLE_BELOW = 1e-6  # of 1 - h_kk: without this satellite the velocity is a thousand times worse
FAULT_SHARE = 0.25  # of the budget, for all single faults together; the rest is the fault-free mode's
AFFORDABLE = 0.5  # of the budget, for the priors of satellites that cannot be left out


@jit(borrows=True)
def find_influences(
    los: Array, used: Bools, variance: Array, y: Array, v: Array, q: Array, solved: bool, influences: Records
) -> None:
    """Fill influences (S,) from this epoch's velocity v (3,) with covariance q (3, 3), of the range rates y (S,)."""
    for k in range(y.size):
        influence = influences[k]
        influence.u_e, influence.u_n, influence.statistic, influence.state = 0.0, 0.0, 0.0, IDLE
    if not solved:
        return
    total, m0, m1, m2, my = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(y.size):
        if used[k]:
            w = 1.0 / variance[k]
            total += w
            m0 += w * los[k, 0]
            m1 += w * los[k, 1]
            m2 += w * los[k, 2]
            my += w * y[k]
    m0, m1, m2, my = m0 / total, m1 / total, m2 / total, my / total
    for k in range(y.size):
        if not used[k]:
            continue
        influence = influences[k]
        w, z0, z1, z2 = 1.0 / variance[k], los[k, 0] - m0, los[k, 1] - m1, los[k, 2] - m2
        qe = q[0, 0] * z0 + q[0, 1] * z1 + q[0, 2] * z2
        qn = q[1, 0] * z0 + q[1, 1] * z1 + q[1, 2] * z2
        qu = q[2, 0] * z0 + q[2, 1] * z1 + q[2, 2] * z2
        free = 1.0 - w * (1.0 / total + qe * z0 + qn * z1 + qu * z2)
        if not free > UNSOLVABLE_BELOW:
            influence.state = LOST
            continue
        scale = math.sqrt(w / free)
        influence.u_e, influence.u_n = -qe * scale, -qn * scale
        influence.statistic = (y[k] - my + z0 * v[0] + z1 * v[1] + z2 * v[2]) * scale
        influence.state = MONITORED


@jit(borrows=True)
def advance_separation(
    dt: float, integrates: bool, had: bool, phi: float, white: float, last: Any, now: Any, s: Any
) -> None:
    """``D += dt/2 (d_{t-1} + d_t)`` where the position integrates Doppler, as S1 eq 20.

    Parameters
    ----------
    integrates : the position moved by the Doppler velocity in this epoch.
    had : the trapezoid had a velocity at its beginning; without one ``D += dt d_t``.
    phi, white : decay of the correlated part of the velocity error and variance of its white part.
    last, now : INFLUENCE of the velocities at the beginning and at the end of the epoch.
    s : SEPARATION of this satellite.
    """
    part = 0.5 * dt if had else dt
    before, fresh = dt - part, 1.0 - phi * phi
    if integrates and (now.state > IDLE or s.state > IDLE):
        s.state = max(s.state, now.state)
        k_e, k_n = before * last.u_e + part * phi * now.u_e, before * last.u_n + part * phi * now.u_n
        m_e, m_n = part * now.u_e, part * now.u_n
        s.d_e += before * last.u_e * last.statistic + m_e * now.statistic
        s.d_n += before * last.u_n * last.statistic + m_n * now.statistic
        s.s_ee += 2.0 * s.c_e * k_e + k_e * k_e + fresh * m_e * m_e
        s.s_en += s.c_e * k_n + s.c_n * k_e + k_e * k_n + fresh * m_e * m_n
        s.s_nn += 2.0 * s.c_n * k_n + k_n * k_n + fresh * m_n * m_n
        inner, outer = white * (2.0 * s.last_s + before) * before, white * part * part
        s.s_ee += inner * last.u_e * last.u_e + outer * now.u_e * now.u_e
        s.s_en += inner * last.u_e * last.u_n + outer * now.u_e * now.u_n
        s.s_nn += inner * last.u_n * last.u_n + outer * now.u_n * now.u_n
        s.last_s = part
        s.c_e = phi * (s.c_e + k_e) + fresh * m_e
        s.c_n = phi * (s.c_n + k_n) + fresh * m_n
    elif s.state > IDLE:
        s.c_e *= phi
        s.c_n *= phi
        s.last_s = 0.0


@jit(borrows=True)
def exposure(satellites: Records, constellation: Array, separations: Records) -> tuple[float, float, float]:
    """Sum of the priors and of their squares over all satellites used since the fix, and the sum of the LOST.

    The fault of a whole constellation is not separated: where one of its satellites was used, its prior (G,) counts as
    LOST, so that the levels spend it. satellites (S,) of SATELLITE or another record with ``prior`` and ``system``.
    """
    total, squares, lost, seen = 0.0, 0.0, 0.0, 0
    for k in range(separations.shape[0]):
        state = separations[k].state
        if state > IDLE:
            p = satellites[k].prior
            total += p
            squares += p * p
            seen |= 1 << satellites[k].system
            if state == LOST:
                lost += p
    for g in range(constellation.shape[0]):
        if seen >> g & 1:
            p = constellation[g]
            total += p
            squares += p * p
            lost += p
    return total, squares, lost


@jit(borrows=True)
def risk_factors(budget: float, share: float, pair: float, total: float, lost: float) -> tuple[float, float]:
    """``K_0`` of the fault-free mode and ``K_f`` of every single fault; (inf, inf) when no risk is left.

    ``2 Q(K_0) + sum_k P_k 2 Q(K_f) = budget``: the faults get FAULT_SHARE, each in proportion to its prior, so that one
    factor serves all. Where their whole prior is smaller than that, it is spent and no fault is monitored: K_f = -inf.

    Parameters
    ----------
    budget : risk of this axis [-], ``share`` of the total; ``pair``: risk of two faults at once, of the total.
    total, lost : prior of all satellites used since the fix, and of the LOST; both of the total risk.
    """
    left = budget - share * pair
    if left <= 0.0 or share * lost > AFFORDABLE * left:
        return np.inf, np.inf
    if share * total <= FAULT_SHARE * left:
        return q_inverse(0.5 * (left - share * total)), -np.inf
    left -= share * lost
    faults = FAULT_SHARE * left
    return q_inverse(0.5 * (left - faults)), q_inverse(min(0.5 * faults / (total - lost), 0.5)) if total > lost else 0.0


@jit(borrows=True)
def worst_separation(sine: float, cosine: float, sigma: float, k_f: float, separations: Records) -> float:
    """``max_k abs(D_k,q) + K_f sigma_k,q`` [m] on the axis ``q = [sine, cosine]`` with fault-free ``sigma`` [m]."""
    largest = 0.0
    for k in range(separations.shape[0]):
        s = separations[k]
        if s.state == MONITORED:
            d = abs(sine * s.d_e + cosine * s.d_n)
            more = sine * sine * s.s_ee + 2.0 * sine * cosine * s.s_en + cosine * cosine * s.s_nn
            largest = max(largest, d + k_f * math.sqrt(sigma * sigma + max(more, 0.0)))
    return largest
