"""Solution separation of a position that is integrated from Doppler velocities, satellite by satellite.

A fault of satellite k that drifts below the threshold of each epoch's test adds up in the position. Let p be the
position and p_k the position from the velocities without satellite k, both since the same RTK fix. Only their
difference is stored: ``D_k = p - p_k``, the integral of ``d_k = v - v_k``, which is *known*. If k is the faulty
satellite, p_k does not depend on the fault, whatever it did and when, so that

    abs(p - true) <= abs(D_k) + abs(p_k - true),   PL_k,q = abs(D_k,q) + K_f sigma_k,q + B_q.

No test is needed, and no detection threshold accumulates: a persistent drift shows in ``D_k`` as soon as its integral
exceeds the noise of the integral, long before it would show in one epoch. Noise makes ``D_k`` larger, never the bound
too small, because ``sigma_k`` and ``K_f`` do not depend on the measurements.

A whole system g is left out in the same way. Its separation ``d_g = v - v_g`` has the covariance ``Q_g - Q = L L'`` of
rank 2 in E and N.

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
from lanebound.integrity.core.small_matrix_kernel import cholesky_2, invert_upper
from lanebound.integrity.monitoring.protection_kernel import q_inverse

__all__ = [
    "AFFORDABLE",
    "INFLUENCE",
    "SEPARATION",
    "SYSTEM_INFLUENCE",
    "SYSTEM_SEPARATION",
    "advance_separation",
    "advance_system",
    "exposure",
    "find_influences",
    "find_system_influences",
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

SYSTEM_INFLUENCE = record(
    d_e="d, velocity less that without the system, East [m/s]",
    d_n="d, North [m/s]",
    l_ee="Cholesky factor of its covariance, East East [m/s]",
    l_ne="the same, North East [m/s]",
    l_nn="the same, North North [m/s]",
    state=("i8", "IDLE, MONITORED or LOST"),
)
"""What one system does to the velocity of one epoch; zeros where there was no velocity or it was not used."""

SYSTEM_SEPARATION = record(
    d_e="D, separation of the positions since the fix, East [m]",
    d_n="D, North [m]",
    s_ee="variance of D, East [m^2]",
    s_en="covariance of D, East and North [m^2]",
    s_nn="variance of D, North [m^2]",
    ne_e="Cov(D_E, n_E) with the unit error of d [m]",
    ne_n="Cov(D_E, n_N) [m]",
    nn_e="Cov(D_N, n_E) [m]",
    nn_n="Cov(D_N, n_N) [m]",
    last_s="weight with which the last velocity stands in the position [s]",
    state=("i8", "since the fix: IDLE, MONITORED or LOST"),
)
"""The separation that one system has caused since an RTK fix."""

POOR = 16.0  # variance without a system over that with it, from which on its prior is spent if it is small
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
def find_system_influences(
    los: Array, used: Bools, variance: Array, y: Array, v: Array, q: Array, solved: bool, system: Array, prior: Array,
    spendable: float, sums: Array, influences: Records,
) -> None:  # fmt: skip
    """Fill influences (G,) from the same velocity, of the systems (S,) of its satellites.

    ``prior`` (G,) of a fault of each; one of at most ``spendable`` is LOST where the velocity without it is POOR. sums
    (>= G + 1, 15) is scratch.
    """
    systems = influences.shape[0]
    for g in range(systems):
        i = influences[g]
        i.d_e, i.d_n, i.l_ee, i.l_ne, i.l_nn, i.state = 0.0, 0.0, 0.0, 0.0, 0.0, IDLE
    if not solved:
        return
    sums[: systems + 1] = 0.0
    for k in range(y.size):
        if used[k]:
            s, w, a, b, c = sums[system[k]], 1.0 / variance[k], los[k, 0], los[k, 1], los[k, 2]
            wa, wb, wc, wy = w * a, w * b, w * c, w * y[k]
            s[0] += w
            s[1] += wa
            s[2] += wb
            s[3] += wc
            s[4] += wy
            s[5] += wa * a
            s[6] += wa * b
            s[7] += wa * c
            s[8] += wb * b
            s[9] += wb * c
            s[10] += wc * c
            s[11] += wy * a
            s[12] += wy * b
            s[13] += wy * c
            s[14] += 1.0
    total = sums[systems]
    for g in range(systems):
        for j in range(15):
            total[j] += sums[g, j]
    for g in range(systems):
        s, i = sums[g], influences[g]
        if not s[0] > 0.0:
            continue
        i.state = LOST
        if total[14] - s[14] < 4.0:
            continue
        w = total[0] - s[0]
        a, b, c, m = (total[1] - s[1]) / w, (total[2] - s[2]) / w, (total[3] - s[3]) / w, (total[4] - s[4]) / w
        ok, q00, q01, q02, q11, q12, _ = invert_upper(
            total[5] - s[5] - w * a * a, total[6] - s[6] - w * a * b, total[7] - s[7] - w * a * c,
            total[8] - s[8] - w * b * b, total[9] - s[9] - w * b * c, total[10] - s[10] - w * c * c,
        )  # fmt: skip
        if not ok or (prior[g] <= spendable and q00 + q11 > POOR * (q[0, 0] + q[1, 1])):
            continue
        r0, r1, r2 = total[11] - s[11] - w * a * m, total[12] - s[12] - w * b * m, total[13] - s[13] - w * c * m
        i.d_e = v[0] + q00 * r0 + q01 * r1 + q02 * r2
        i.d_n = v[1] + q01 * r0 + q11 * r1 + q12 * r2
        i.l_ee, i.l_ne, i.l_nn = cholesky_2(q00 - q[0, 0], q01 - q[0, 1], q11 - q[1, 1])
        i.state = MONITORED


@jit(borrows=True)
def advance_system(
    dt: float, integrates: bool, had: bool, phi: float, white: float, last: Any, now: Any, s: Any
) -> None:
    """:func:`advance_separation` of a system: last, now of SYSTEM_INFLUENCE, s of SYSTEM_SEPARATION."""
    part = 0.5 * dt if had else dt
    before, fresh = dt - part, 1.0 - phi * phi
    if integrates and (now.state > IDLE or s.state > IDLE):
        s.state = max(s.state, now.state)
        k_ee = before * last.l_ee + part * phi * now.l_ee
        k_ne = before * last.l_ne + part * phi * now.l_ne
        k_nn = before * last.l_nn + part * phi * now.l_nn
        m_ee, m_ne, m_nn = part * now.l_ee, part * now.l_ne, part * now.l_nn
        s.d_e += before * last.d_e + part * now.d_e
        s.d_n += before * last.d_n + part * now.d_n
        inner, outer = white * (2.0 * s.last_s + before) * before, white + fresh
        s.s_ee += 2.0 * s.ne_e * k_ee + k_ee * k_ee + outer * m_ee * m_ee + inner * last.l_ee * last.l_ee
        s.s_en += s.ne_e * k_ne + s.ne_n * k_nn + s.nn_e * k_ee + k_ee * k_ne + outer * m_ee * m_ne
        s.s_en += inner * last.l_ee * last.l_ne
        s.s_nn += 2.0 * (s.nn_e * k_ne + s.nn_n * k_nn) + k_ne * k_ne + k_nn * k_nn
        s.s_nn += outer * (m_ne * m_ne + m_nn * m_nn) + inner * (last.l_ne * last.l_ne + last.l_nn * last.l_nn)
        s.last_s = part
        s.ne_e = phi * (s.ne_e + k_ee) + fresh * m_ee
        s.ne_n *= phi
        s.nn_e = phi * (s.nn_e + k_ne) + fresh * m_ne
        s.nn_n = phi * (s.nn_n + k_nn) + fresh * m_nn
    elif s.state > IDLE:
        s.ne_e *= phi
        s.ne_n *= phi
        s.nn_e *= phi
        s.nn_n *= phi
        s.last_s = 0.0


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
def exposure(satellites: Records, prior: Array, separations: Records, systems: Records) -> tuple[float, float, float]:
    """Sum of the priors and of their squares over all that was used since the fix, and the sum of the LOST.

    satellites (S,) of SATELLITE or another record with ``prior``, with separations (S,); systems (G,) of
    SYSTEM_SEPARATION, with the ``prior`` (>= G,) of a fault of each.
    """
    total, squares, lost = 0.0, 0.0, 0.0
    for k in range(separations.shape[0]):
        state = separations[k].state
        if state > IDLE:
            p = satellites[k].prior
            total += p
            squares += p * p
            if state == LOST:
                lost += p
    for g in range(systems.shape[0]):
        if systems[g].state > IDLE:
            p = prior[g]
            total += p
            squares += p * p
            if systems[g].state == LOST:
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
def worst_separation(
    sine: float, cosine: float, sigma: float, by_heading: float, k_f: float, separations: Records, largest: float
) -> float:
    """``max_k abs(D_k,q) + K_f sigma_k,q`` [m] on the axis ``q = [sine, cosine]``, at least ``largest``.

    ``sigma_k^2 = sigma^2 + (sigma_D + sigma_h)^2``: fault-free, of the separation by velocities, and ``by_heading`` of
    that by the heading, which may correlate [m].
    """
    for k in range(separations.shape[0]):
        s = separations[k]
        if s.state == MONITORED:
            d = abs(sine * s.d_e + cosine * s.d_n)
            more = sine * sine * s.s_ee + 2.0 * sine * cosine * s.s_en + cosine * cosine * s.s_nn
            apart = math.sqrt(max(more, 0.0)) + by_heading
            largest = max(largest, d + k_f * math.sqrt(sigma * sigma + apart * apart))
    return largest
