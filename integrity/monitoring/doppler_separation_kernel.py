"""Solution separation of a position that is integrated from Doppler velocities, one fault mode at a time.

A fault mode k is a satellite or a whole system: its range rates may be wrong together. A fault that drifts below the
threshold of each epoch's test adds up in the position. Let p be the position and p_k the position from the velocities
without k, both since the same RTK fix. Only their difference is stored: ``D_k = p - p_k``, the integral of ``d_k = v -
v_k``, which is *known*. If k is faulty, p_k does not depend on the fault, whatever it did and when, so that

    abs(p - true) <= abs(D_k) + abs(p_k - true),   PL_k,q = abs(D_k,q) + K_f sigma_k,q + B_q.

No test is needed, and no detection threshold accumulates: a persistent drift shows in ``D_k`` as soon as its integral
exceeds the noise of the integral, long before it would show in one epoch. Noise makes ``D_k`` larger, never the bound
too small, because ``sigma_k`` and ``K_f`` do not depend on the measurements.

The separation of one epoch has the covariance ``Q_k - Q = L L'`` in E and N and does not correlate with v (least
squares). Its error is Gauss-Markov with a white part, as the velocity error itself, so ``sigma_k^2 = sigma_0^2 +
Var(D_k)``. With the residuals r of v (design row ``[-e, 1]``, z = e less the weighted mean, w weight, W their sum) no
solution is computed a second time:

- a satellite: ``L = u = -Q z sqrt(w / f)``, ``f = 1 - w (1 / W + z'Q z)``, and ``d = u r sqrt(w / f)``;
- a system with the sums ``W_g, s = sum w z, c = sum w r`` of its satellites: ``Q_g^-1 = Q^-1 - sum w z z' - s s' / (W -
  W_g)`` and ``d = -Q_g (sum w z r + s c / (W - W_g))``.

Fault modes stand in one order everywhere: satellites first, then systems.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS, cholesky_2, invert_upper
from lanebound.integrity.monitoring.protection_kernel import q_inverse

__all__ = [
    "AFFORDABLE",
    "CENTRED",
    "IDLE",
    "INFLUENCE",
    "LOST",
    "MONITORED",
    "SEPARATION",
    "SUMS",
    "Trapezoid",
    "advance_separation",
    "centre_rows",
    "exposure",
    "fade_separation",
    "find_satellite_influences",
    "find_system_influences",
    "forget_influence",
    "forget_separation",
    "risk_factors",
    "trapezoid",
    "worst_separation",
]

Array = NDArray[np.float64]

IDLE, MONITORED, LOST = 0, 1, 2  # not used; monitored; a velocity had no solution without this mode

POOR = 16.0  # variance without a system over that with it, from which on its prior is spent if it is small
UNSOLVABLE_BELOW = 1e-6  # of f: without this satellite the velocity is a thousand times worse
FAULT_SHARE = 0.25  # of the budget, for all single faults together; the rest is the fault-free mode's
AFFORDABLE = 0.5  # of the budget, for the priors of modes that cannot be left out

INFLUENCE = record(
    state=("i8", "IDLE, MONITORED or LOST"),
    d_e="velocity less that without the mode, East [m/s]",
    d_n="the same, North [m/s]",
    l_ee="Cholesky factor of the covariance of d, East East [m/s]",
    l_ne="the same, North East [m/s]",
    l_nn="the same, North North [m/s]",
)
"""What a fault mode does to the velocity of one epoch; zeros where there is no velocity or the mode is not used."""

SEPARATION = record(
    state=("i8", "IDLE, MONITORED or LOST"),
    d_e="separation D, East [m]",
    d_n="the same, North [m]",
    s_ee="its covariance, East East [m^2]",
    s_en="the same, East North [m^2]",
    s_nn="the same, North North [m^2]",
    ne_e="Cov(D_E, n_E) with the unit error of d [m]",
    ne_n="Cov(D_E, n_N) [m]",
    nn_e="Cov(D_N, n_E) [m]",
    nn_n="Cov(D_N, n_N) [m]",
)
"""The separation that a fault mode has caused since an RTK fix."""


@jit
def forget_influence(i: Any) -> None:
    """The mode does nothing to the velocity: there is none, or it is not used."""
    i.state, i.d_e, i.d_n, i.l_ee, i.l_ne, i.l_nn = IDLE, 0.0, 0.0, 0.0, 0.0, 0.0


@jit
def forget_separation(s: Any) -> None:
    """An RTK fix: the mode has caused no separation since."""
    s.state, s.d_e, s.d_n, s.s_ee, s.s_en, s.s_nn = IDLE, 0.0, 0.0, 0.0, 0.0, 0.0
    s.ne_e, s.ne_n, s.nn_e, s.nn_n = 0.0, 0.0, 0.0, 0.0


# The velocity of one epoch without each mode

SUMS = record(
    count="satellites",
    w="sum of w",
    r="sum of w r",
    e="sum of w z, East",
    n="the same, North",
    u="the same, Up",
    ee="sum of w z z', East East",
    en="the same, East North",
    eu="the same, East Up",
    nn="the same, North North",
    nu="the same, North Up",
    uu="the same, Up Up",
    er="sum of w z r, East",
    nr="the same, North",
    ur="the same, Up",
)
"""Sums over the satellites of a system, or over all."""


CENTRED = record(
    z=("f8", (3,), "line of sight less the weighted mean"),
    weight="0 where not used [s^2/m^2]",
    residual="[m/s]",
)
"""The row of a satellite in a velocity."""


@jit(borrows=True)
def centre_rows(rows: Records, velocity: Array, centred: Records, sums: Records) -> None:
    """Fill ``centred`` (S,) of CENTRED and the total weight in ``sums``, of the velocity (3,) found from ``rows`` (S,).

    sums (MAX_GROUPS + 1,) of SUMS: of each system and, last, of all.
    """
    w, e, north, up, y = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(rows.shape[0]):
        row, c = rows[k], centred[k]
        c.weight = 1.0 / row.variance if row.used else 0.0
        w += c.weight
        e += c.weight * row.e[0]
        north += c.weight * row.e[1]
        up += c.weight * row.e[2]
        y += c.weight * row.y if row.used else 0.0
    inverse = 1.0 / w
    m_e, m_n, m_u, m_y = e * inverse, north * inverse, up * inverse, y * inverse
    for k in range(rows.shape[0]):
        row, c = rows[k], centred[k]
        if row.used:
            c.z[0], c.z[1], c.z[2] = row.e[0] - m_e, row.e[1] - m_n, row.e[2] - m_u
            c.residual = row.y - m_y + c.z[0] * velocity[0] + c.z[1] * velocity[1] + c.z[2] * velocity[2]
    sums[MAX_GROUPS].w = w


@jit(borrows=True)
def find_satellite_influences(q: Array, centred: Records, sums: Records, faults: Records) -> None:
    """Fill ``faults[k].now`` of the satellites for a velocity of covariance q (3, 3), of centred rows."""
    one = 1.0 / sums[MAX_GROUPS].w
    for k in range(centred.shape[0]):
        c, out = centred[k], faults[k].now
        if not c.weight > 0.0:
            forget_influence(out)
            continue
        w, z_e, z_n, z_u = c.weight, c.z[0], c.z[1], c.z[2]
        q_e = z_e * q[0, 0] + z_n * q[0, 1] + z_u * q[0, 2]
        q_n = z_e * q[1, 0] + z_n * q[1, 1] + z_u * q[1, 2]
        q_u = z_e * q[2, 0] + z_n * q[2, 1] + z_u * q[2, 2]
        free = 1.0 - w * (q_e * z_e + q_n * z_n + q_u * z_u + one)
        if not free > UNSOLVABLE_BELOW:  # no velocity without this satellite: its prior is spent
            forget_influence(out)
            out.state = LOST
            continue
        scale = math.sqrt(w / free)
        u_e, u_n, statistic = -q_e * scale, -q_n * scale, c.residual * scale
        out.state, out.d_e, out.d_n = MONITORED, u_e * statistic, u_n * statistic
        out.l_ee, out.l_ne, out.l_nn = u_e, u_n, 0.0


@jit(borrows=True)
def find_system_influences(
    q: Array, satellites: Records, prior: Array, spendable: float, centred: Records, sums: Records, faults: Records
) -> None:
    """Fill ``faults[S + g].now`` of the systems g, after those of the ``satellites`` (S,).

    prior (M,) of a fault of each mode. A system of a prior of at most ``spendable`` is LOST where the velocity without
    it is POOR.
    """
    _sum_systems(satellites, centred, sums)
    a, first = sums[MAX_GROUPS], satellites.shape[0]
    for g in range(min(MAX_GROUPS, prior.size - first)):
        s, out = sums[g], faults[first + g].now
        forget_influence(out)
        out.state = IDLE if s.count == 0.0 else LOST
        if s.count == 0.0 or a.count - s.count < 4.0:
            continue
        rest = 1.0 / (a.w - s.w)
        ok, ee, en, eu, nn, nu, _ = invert_upper(
            a.ee - s.ee - rest * s.e * s.e, a.en - s.en - rest * s.e * s.n, a.eu - s.eu - rest * s.e * s.u,
            a.nn - s.nn - rest * s.n * s.n, a.nu - s.nu - rest * s.n * s.u, a.uu - s.uu - rest * s.u * s.u,
        )  # fmt: skip
        # A system that is unlikely to fail and needed for a velocity worth having: its prior is spent instead.
        if not ok or (prior[first + g] <= spendable and ee + nn > POOR * (q[0, 0] + q[1, 1])):
            continue
        r_e, r_n, r_u = s.er + rest * s.e * s.r, s.nr + rest * s.n * s.r, s.ur + rest * s.u * s.r
        out.d_e, out.d_n = -(ee * r_e + en * r_n + eu * r_u), -(en * r_e + nn * r_n + nu * r_u)
        out.l_ee, out.l_ne, out.l_nn = cholesky_2(ee - q[0, 0], en - q[0, 1], nn - q[1, 1])
        out.state = MONITORED


@jit(borrows=True)
def _sum_systems(satellites: Records, centred: Records, sums: Records) -> None:
    """Fill the sums of each system and of all satellites."""
    for g in range(MAX_GROUPS + 1):
        s = sums[g]
        s.count, s.w, s.r, s.e, s.n, s.u = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        s.ee, s.en, s.eu, s.nn, s.nu, s.uu, s.er, s.nr, s.ur = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(satellites.shape[0]):
        c = centred[k]
        w = c.weight
        if w > 0.0:
            e, n, u, r = c.z[0], c.z[1], c.z[2], c.residual
            s, w_e, w_n, w_u = sums[satellites[k].system], w * e, w * n, w * u
            s.count += 1.0
            s.w += w
            s.r += w * r
            s.e += w_e
            s.n += w_n
            s.u += w_u
            s.ee += w_e * e
            s.en += w_e * n
            s.eu += w_e * u
            s.nn += w_n * n
            s.nu += w_n * u
            s.uu += w_u * u
            s.er += w_e * r
            s.nr += w_n * r
            s.ur += w_u * r
    everything = sums[MAX_GROUPS]
    for g in range(MAX_GROUPS):
        s = sums[g]
        everything.count += s.count
        everything.w += s.w
        everything.ee += s.ee
        everything.en += s.en
        everything.eu += s.eu
        everything.nn += s.nn
        everything.nu += s.nu
        everything.uu += s.uu


# The separation of the position


class Trapezoid(NamedTuple):
    """How an epoch integrates velocities: ``p += before v_{t-1} + now v_t`` [s] (S1 eq 20), and their error.

    ``phi`` is the decay of the correlated part of a unit error over the epoch, ``white`` the variance of the white
    part.
    """

    before: float
    now: float
    phi: float
    white: float


@jit
def trapezoid(dt: float, had: bool, phi: float, white: float) -> Trapezoid:
    """``p += dt/2 (v_{t-1} + v_t)``, or ``p += dt v_t`` where there ``had`` been no velocity before."""
    now = 0.5 * dt if had else dt
    return Trapezoid(dt - now, now, phi, white)


@jit
def advance_separation(t: Trapezoid, weight: float, last: Any, now: Any, s: Any) -> None:
    """Advance a separation where Doppler moves the position: ``D += before d_{t-1} + now d_t`` and its covariance.

    ``D' = D + K n + M r`` with ``K = before L_{t-1} + now phi L_t`` and ``M = now L_t``, as the position itself
    (:func:`~.dead_reckoning_pl_kernel.step_doppler`). ``weight`` [s] is that of the last velocity in the position.
    """
    fresh = 1.0 - t.phi * t.phi
    inner, outer = t.white * (2.0 * weight + t.before) * t.before, t.white + fresh
    a_ee, a_ne, a_nn = last.l_ee, last.l_ne, last.l_nn
    m_ee, m_ne, m_nn = now.l_ee * t.now, now.l_ne * t.now, now.l_nn * t.now
    k_ee, k_ne, k_nn = a_ee * t.before + m_ee * t.phi, a_ne * t.before + m_ne * t.phi, a_nn * t.before + m_nn * t.phi
    a, b, c, d = s.ne_e, s.ne_n, s.nn_e, s.nn_n
    s.d_e = s.d_e + last.d_e * t.before + now.d_e * t.now
    s.d_n = s.d_n + last.d_n * t.before + now.d_n * t.now
    ee = 2.0 * a * k_ee + k_ee * k_ee + outer * m_ee * m_ee + inner * a_ee * a_ee
    en = a * k_ne + b * k_nn + c * k_ee + k_ee * k_ne + outer * m_ee * m_ne + inner * a_ee * a_ne
    nn = 2.0 * (c * k_ne + d * k_nn) + k_ne * k_ne + k_nn * k_nn
    nn += outer * (m_ne * m_ne + m_nn * m_nn) + inner * (a_ne * a_ne + a_nn * a_nn)
    s.s_ee += ee
    s.s_en += en
    s.s_nn += nn
    s.ne_e, s.ne_n = t.phi * (a + k_ee) + fresh * m_ee, t.phi * b
    s.nn_e, s.nn_n = t.phi * (c + k_ne) + fresh * m_ne, t.phi * (d + k_nn) + fresh * m_nn
    s.state = max(s.state, last.state, now.state)


@jit
def fade_separation(phi: float, s: Any) -> None:
    """An epoch in which Doppler does not move the position: the correlation with the errors of d fades."""
    s.ne_e *= phi
    s.ne_n *= phi
    s.nn_e *= phi
    s.nn_n *= phi


# The bound


@jit(borrows=True)
def exposure(prior: Array, separations: Records) -> tuple[float, float, float]:
    """Sum of the priors (M,) and of their squares over the modes used since the fix, and the sum of the LOST."""
    used, squares, lost = 0.0, 0.0, 0.0
    for k in range(separations.shape[0]):
        state, p = separations[k].state, prior[k]
        if state > IDLE:
            used += p
            squares += p * p
        if state > MONITORED:
            lost += p
    return used, squares, lost


@jit
def risk_factors(budget: float, share: float, pair: float, everything: float, lost: float) -> tuple[float, float]:
    """``K_0`` of the fault-free mode and ``K_f`` of every single fault; (inf, inf) when no risk is left.

    ``2 Q(K_0) + sum_k P_k 2 Q(K_f) = budget``: the faults get FAULT_SHARE, each in proportion to its prior, so that one
    factor serves all. Where their whole prior is smaller than that, it is spent and no fault is monitored: K_f = -inf.

    Parameters
    ----------
    budget : risk of this axis [-], ``share`` of the total; ``pair``: risk of two faults at once, of the total.
    everything, lost : prior of all modes used since the fix, and of the LOST; both of the total risk.
    """
    left = budget - share * pair
    if left <= 0.0 or share * lost > AFFORDABLE * left:
        return np.inf, np.inf
    if share * everything <= FAULT_SHARE * left:
        return q_inverse(0.5 * (left - share * everything)), -np.inf
    left -= share * lost
    faults, monitored = FAULT_SHARE * left, everything - lost
    return q_inverse(0.5 * (left - faults)), q_inverse(min(0.5 * faults / monitored, 0.5)) if monitored > 0.0 else 0.0


@jit(borrows=True)
def worst_separation(
    sine: float, cosine: float, sigma: float, by_heading: float, k_f: float, separations: Records
) -> float:
    """``max_k abs(D_k,q) + K_f sigma_k,q`` [m] of the monitored modes on the axis ``q = [sine, cosine]``; 0 for none.

    ``sigma_k^2 = sigma^2 + (sigma_D + sigma_h)^2``: fault-free, of the separation by velocities, and ``by_heading`` of
    that by the heading, which may correlate [m].
    """
    worst = 0.0
    for k in range(separations.shape[0]):
        s = separations[k]
        if s.state != MONITORED:
            continue
        more = s.s_ee * (sine * sine) + s.s_en * (2.0 * sine * cosine)
        more += s.s_nn * (cosine * cosine)
        apart = math.sqrt(max(more, 0.0)) + by_heading
        level = abs(s.d_e * sine + s.d_n * cosine) + k_f * math.sqrt(apart * apart + sigma * sigma)
        worst = max(worst, level)
    return worst
