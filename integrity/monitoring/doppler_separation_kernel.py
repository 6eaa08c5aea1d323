"""Solution separation of a position that is integrated from Doppler velocities, satellite by satellite.

A fault of satellite k that drifts below the threshold of each epoch's test adds up in the position. Beside the position
p runs, in thought, the position p_k of the velocities without satellite k, from the same last RTK fix on. Only their
difference is kept: ``D_k = p - p_k``, the integral of ``d_k = v - v_k``, which is *known*. If k is the faulty one, p_k
knows nothing of it, whatever the fault did and when, so that

    abs(p - true) <= abs(D_k) + abs(p_k - true),   PL_k,q = abs(D_k,q) + K_f sigma_k,q + B_q.

No test is needed, and no detection threshold accumulates: a persistent drift shows in ``D_k`` as soon as its integral
exceeds the noise of the integral, long before it would show in one epoch. Noise makes ``D_k`` larger, never the bound
too small, because ``sigma_k`` and ``K_f`` do not depend on the measurements.

Removing row k of the velocity (design row ``[-e, 1]``, z = e less the weighted mean, w weight, ``f = 1 - h_kk``):
``d_k = u_k n_k``, ``u_k = -Q z_k sqrt(w_k / f_k)``, with the w-statistic ``n_k = r_k sqrt(w_k / f_k)`` of variance 1.
The separation of one epoch does not correlate with v (least squares), so ``Q_k = Q + u_k u_k'`` and, with n_k
Gauss-Markov as the velocity error itself, ``sigma_k^2 = sigma_0^2 + Var(D_k)``.

``a`` (APART_ROWS, S) holds one column for each satellite:

===============  ====================================================================================================
D_E D_N          separation of the positions since the fix, ``int u n dt`` [m]
S_EE S_EN S_NN   its covariance [m^2]
C_E C_N          ``Cov(D, n)`` [m]
U_E U_N W        u [m/s] and n of the last epoch, 0 when it had no velocity or not this satellite
NEW_E NEW_N      u of this epoch
NEW_W            n of this epoch
STATE            since the fix, IDLE: not used; MONITORED; LOST: a velocity had no solution without this satellite
NOW              the same of this epoch alone
===============  ====================================================================================================
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.monitoring.protection_kernel import q_inverse

__all__ = ["APART_ROWS", "advance_separations", "exposure", "factors", "separate_velocity", "share_epoch", "worst"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

D_E, D_N, S_EE, S_EN, S_NN, C_E, C_N, U_E, U_N, W, NEW_E, NEW_N, NEW_W, STATE, NOW = range(15)
APART_ROWS = 15
IDLE, MONITORED, LOST = 0.0, 1.0, 2.0
UNSOLVABLE_BELOW = 1e-6  # of 1 - h_kk: without this satellite the velocity is worse a thousand times
FAULT_SHARE = 0.25  # of the budget, for all single faults together; the rest is the fault-free mode's
AFFORDABLE = 0.5  # of the budget, for the priors of satellites that cannot be left out


@jit
def separate_velocity(
    los: Array, used: Bools, variance: Array, y: Array, v: Array, q: Array, solved: bool, system: Ints, prior: Array,
    a: Array,
) -> float:  # fmt: skip
    """Fill rows NEW_E to NEW_W and NOW from this epoch's velocity v (3,) with covariance q (3, 3).

    Returns the summed prior (by system) of the satellites that cannot be left out, now or since the fix.
    """
    for k in range(y.size):
        a[NEW_E, k], a[NEW_N, k], a[NEW_W, k], a[NOW, k] = 0.0, 0.0, 0.0, IDLE
    lost = 0.0
    if solved:
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
            w, z0, z1, z2 = 1.0 / variance[k], los[k, 0] - m0, los[k, 1] - m1, los[k, 2] - m2
            qe = q[0, 0] * z0 + q[0, 1] * z1 + q[0, 2] * z2
            qn = q[1, 0] * z0 + q[1, 1] * z1 + q[1, 2] * z2
            qu = q[2, 0] * z0 + q[2, 1] * z1 + q[2, 2] * z2
            free = 1.0 - w * (1.0 / total + qe * z0 + qn * z1 + qu * z2)
            if not free > UNSOLVABLE_BELOW:
                a[NOW, k] = LOST
                continue
            scale = math.sqrt(w / free)
            a[NEW_E, k], a[NEW_N, k] = -qe * scale, -qn * scale
            a[NEW_W, k] = (y[k] - my + z0 * v[0] + z1 * v[1] + z2 * v[2]) * scale
            a[NOW, k] = MONITORED
    for k in range(y.size):
        if a[NOW, k] == LOST or a[STATE, k] == LOST:
            lost += prior[system[k]]
    return lost


@jit
def share_epoch(a: Array, other: Array) -> None:
    """What :func:`separate_velocity` has found, for separations since another fix too."""
    other[NEW_E : NEW_W + 1] = a[NEW_E : NEW_W + 1]
    other[NOW] = a[NOW]


@jit
def advance_separations(dt: float, integrates: bool, had: bool, measured: bool, phi: float, a: Array) -> None:
    """``D += dt/2 (d_{t-1} + d_t)`` where the position integrates Doppler, as S1 eq 20; then this epoch is the last.

    Parameters
    ----------
    integrates : the position moved by the Doppler velocity in this epoch.
    had : the trapezoid had a velocity at its beginning; without one ``D += dt d_t``.
    measured : this epoch's velocity begins the next trapezoid.
    phi : ``exp(-dt/tau)`` of the velocity error.
    """
    now = 0.5 * dt if had else dt
    before, fresh = dt - now, 1.0 - phi * phi
    for k in range(a.shape[1]):
        if integrates and (a[NOW, k] > IDLE or a[STATE, k] > IDLE):
            if a[NOW, k] > a[STATE, k]:
                a[STATE, k] = a[NOW, k]
            k_e, k_n = before * a[U_E, k] + now * phi * a[NEW_E, k], before * a[U_N, k] + now * phi * a[NEW_N, k]
            m_e, m_n = now * a[NEW_E, k], now * a[NEW_N, k]
            a[D_E, k] += before * a[U_E, k] * a[W, k] + m_e * a[NEW_W, k]
            a[D_N, k] += before * a[U_N, k] * a[W, k] + m_n * a[NEW_W, k]
            a[S_EE, k] += 2.0 * a[C_E, k] * k_e + k_e * k_e + fresh * m_e * m_e
            a[S_EN, k] += a[C_E, k] * k_n + a[C_N, k] * k_e + k_e * k_n + fresh * m_e * m_n
            a[S_NN, k] += 2.0 * a[C_N, k] * k_n + k_n * k_n + fresh * m_n * m_n
            a[C_E, k] = phi * (a[C_E, k] + k_e) + fresh * m_e
            a[C_N, k] = phi * (a[C_N, k] + k_n) + fresh * m_n
        elif a[STATE, k] > IDLE:
            a[C_E, k] *= phi
            a[C_N, k] *= phi
    for row in range(W - U_E + 1):  # NEW_E, NEW_N, NEW_W stand in the same order
        for k in range(a.shape[1]):
            a[U_E + row, k] = a[NEW_E + row, k] if measured else 0.0


@jit
def exposure(system: Ints, prior: Array, a: Array) -> tuple[float, float, float]:
    """Sum of priors and of their squares over all satellites used since the fix, and the sum of the LOST among them."""
    total, squares, lost = 0.0, 0.0, 0.0
    for k in range(a.shape[1]):
        if a[STATE, k] > IDLE:
            p = prior[system[k]]
            total += p
            squares += p * p
            if a[STATE, k] == LOST:
                lost += p
    return total, squares, lost


@jit
def factors(budget: float, share: float, pair: float, total: float, lost: float) -> tuple[float, float]:
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


@jit
def worst(sine: float, cosine: float, sigma: float, k_f: float, a: Array) -> float:
    """``max_k abs(D_k,q) + K_f sigma_k,q`` [m] on the axis ``q = [sine, cosine]`` with fault-free ``sigma`` [m]."""
    largest = 0.0
    for k in range(a.shape[1]):
        if a[STATE, k] == MONITORED:
            d = abs(sine * a[D_E, k] + cosine * a[D_N, k])
            more = sine * sine * a[S_EE, k] + 2.0 * sine * cosine * a[S_EN, k] + cosine * cosine * a[S_NN, k]
            largest = max(largest, d + k_f * math.sqrt(sigma * sigma + max(more, 0.0)))
    return largest
