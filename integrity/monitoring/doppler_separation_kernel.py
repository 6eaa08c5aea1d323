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

Fault modes stand in one order everywhere: satellites first, then systems; arrays have W entries, a multiple of WIDTH,
and zeros behind the last mode.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records, record
from lanebound.integrity.core.simd_kernel import (
    WIDTH,
    absolute,
    largest,
    load,
    maximum,
    padded,
    root_of,
    spread,
    store,
    total,
    where_less,
)
from lanebound.integrity.core.small_matrix_kernel import MAX_GROUPS, cholesky_2, invert_upper
from lanebound.integrity.monitoring.protection_kernel import q_inverse
from lanebound.integrity.positioning.rows_kernel import Rows

__all__ = [
    "AFFORDABLE",
    "IDLE",
    "LOST",
    "MONITORED",
    "Influences",
    "Separations",
    "Trapezoid",
    "advance_separations",
    "centre_rows",
    "centred_scratch",
    "clear_modes",
    "copy_modes",
    "exposure",
    "fade_separations",
    "find_satellite_influences",
    "find_system_influences",
    "influences_of",
    "risk_factors",
    "separations_of",
    "trapezoid",
    "worst_separation",
]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

IDLE, MONITORED, LOST = 0.0, 1.0, 2.0  # not used; monitored; a velocity had no solution without this mode

POOR = 16.0  # variance without a system over that with it, from which on its prior is spent if it is small
UNSOLVABLE_BELOW = 1e-6  # of f: without this satellite the velocity is a thousand times worse
FAULT_SHARE = 0.25  # of the budget, for all single faults together; the rest is the fault-free mode's
AFFORDABLE = 0.5  # of the budget, for the priors of modes that cannot be left out


class Influences(NamedTuple):
    """What each fault mode does to the velocity of one epoch; zeros where there is no velocity or it is not used.

    (W,) each, or (B, W): d_e, d_n velocity less that without the mode [m/s]; l_ee, l_ne, l_nn Cholesky factor of the
    covariance of d [m/s]; state IDLE, MONITORED or LOST.
    """

    d_e: Array
    d_n: Array
    l_ee: Array
    l_ne: Array
    l_nn: Array
    state: Array


class Separations(NamedTuple):
    """The separation that each fault mode has caused since an RTK fix.

    (W,) each, or (B, W): d_e, d_n separation D [m]; s_ee, s_en, s_nn its covariance [m^2]; ne_e, ne_n, nn_e, nn_n the
    covariances Cov(D_E, n_E), Cov(D_E, n_N), Cov(D_N, n_E), Cov(D_N, n_N) with the unit error of d [m]; state IDLE,
    MONITORED or LOST.
    """

    d_e: Array
    d_n: Array
    s_ee: Array
    s_en: Array
    s_nn: Array
    ne_e: Array
    ne_n: Array
    nn_e: Array
    nn_n: Array
    state: Array


@jit(inline=True)
def influences_of(a: Influences, v: int) -> Influences:
    """Row v, (W,) each, of influences (B, W)."""
    return Influences(a.d_e[v], a.d_n[v], a.l_ee[v], a.l_ne[v], a.l_nn[v], a.state[v])


@jit(inline=True)
def separations_of(a: Separations, v: int) -> Separations:
    """Row v, (W,) each, of separations (B, W)."""
    return Separations(
        a.d_e[v], a.d_n[v], a.s_ee[v], a.s_en[v], a.s_nn[v], a.ne_e[v], a.ne_n[v], a.nn_e[v], a.nn_n[v], a.state[v]
    )


@jit(borrows=True)
def clear_modes(arrays: tuple[Array, ...]) -> None:
    """No velocity, or no separation since the fix: zeros in all arrays (W,) of influences or separations."""
    for array in arrays:
        array[:] = 0.0


@jit(borrows=True)
def copy_modes(source: tuple[Array, ...], arrays: tuple[Array, ...]) -> None:
    """Copy influences to influences, or separations to separations, (W,) each."""
    for array, values in zip(arrays, source):  # noqa: B905 (kernels know no strict)
        for k in range(array.size):
            array[k] = values[k]


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


class Centred(NamedTuple):
    """The rows of one velocity: z (3, V), weight w (V,), 0 where not used, residual r (V,); sums of SUMS.

    sums (MAX_GROUPS + 1,) of each system and, last, of all.
    """

    row: Array
    weight: Array
    residual: Array
    sums: Records


@jit(forceinline=True)
def centred_scratch(satellites: int) -> Centred:
    """Allocate for velocities of so many satellites; weights behind the last stay 0."""
    w = padded(satellites)
    return Centred(np.zeros((3, w)), np.zeros(w), np.zeros(w), np.zeros(MAX_GROUPS + 1, SUMS))


@jit(borrows=True)
def centre_rows(rows: Rows, velocity: Array, c: Centred) -> None:
    """Fill z, w and the residuals of the velocity (3,) found from these rows."""
    row, weight, residual, n = c.row, c.weight, c.residual, rows.y.size
    for k in range(n):
        row[0, k], row[1, k], row[2, k] = rows.los[k, 0], rows.los[k, 1], rows.los[k, 2]
        weight[k], residual[k] = (1.0 / rows.variance[k], rows.y[k]) if rows.used[k] else (0.0, 0.0)
    w, e, north, up, y = spread(0.0), spread(0.0), spread(0.0), spread(0.0), spread(0.0)
    for k in range(0, n, WIDTH):
        here = load(weight, k)
        w, y = w + here, y + here * load(residual, k)
        e, north, up = e + here * load(row, 0, k), north + here * load(row, 1, k), up + here * load(row, 2, k)
    inverse = 1.0 / total(w)
    m_e, m_n, m_u, m_y = total(e) * inverse, total(north) * inverse, total(up) * inverse, total(y) * inverse
    for k in range(0, n, WIDTH):
        z_e, z_n, z_u = load(row, 0, k) - m_e, load(row, 1, k) - m_n, load(row, 2, k) - m_u
        store(z_e, row, 0, k)
        store(z_n, row, 1, k)
        store(z_u, row, 2, k)
        store(load(residual, k) - m_y + z_e * velocity[0] + z_n * velocity[1] + z_u * velocity[2], residual, k)
    c.sums[MAX_GROUPS].w = total(w)


@jit(borrows=True)
def find_satellite_influences(q: Array, c: Centred, out: Influences) -> None:
    """Fill the influences of the satellites on a velocity of covariance q (3, 3), of centred rows."""
    one = 1.0 / c.sums[MAX_GROUPS].w
    for k in range(0, c.weight.size, WIDTH):
        w, z_e, z_n, z_u = load(c.weight, k), load(c.row, 0, k), load(c.row, 1, k), load(c.row, 2, k)
        q_e = z_e * q[0, 0] + z_n * q[0, 1] + z_u * q[0, 2]
        q_n = z_e * q[1, 0] + z_n * q[1, 1] + z_u * q[1, 2]
        q_u = z_e * q[2, 0] + z_n * q[2, 1] + z_u * q[2, 2]
        free = 1.0 - w * (q_e * z_e + q_n * z_n + q_u * z_u + one)
        solvable = where_less(UNSOLVABLE_BELOW, free, 1.0, 0.0)
        scale = solvable * root_of(w / where_less(UNSOLVABLE_BELOW, free, free, 1.0))
        u_e, u_n, statistic = 0.0 - q_e * scale, 0.0 - q_n * scale, load(c.residual, k) * scale
        store(u_e * statistic, out.d_e, k)
        store(u_n * statistic, out.d_n, k)
        store(u_e, out.l_ee, k)
        store(u_n, out.l_ne, k)
        store(spread(0.0), out.l_nn, k)
        store(where_less(0.0, w, LOST - solvable * (LOST - MONITORED), IDLE), out.state, k)


@jit(borrows=True)
def find_system_influences(q: Array, system: Ints, prior: Array, spendable: float, c: Centred, out: Influences) -> None:
    """Fill the influences of the systems, after those of the satellites, whose ``system`` (S,) is given.

    prior (W,) of a fault of each mode. A system of a prior of at most ``spendable`` is LOST where the velocity without
    it is POOR.
    """
    _sum_systems(system, c)
    everything, first = c.sums[MAX_GROUPS], system.size
    for g in range(min(MAX_GROUPS, prior.size - first)):
        s, at = c.sums[g], first + g
        out.d_e[at], out.d_n[at], out.l_ee[at], out.l_ne[at], out.l_nn[at] = 0.0, 0.0, 0.0, 0.0, 0.0
        out.state[at] = IDLE if s.count == 0.0 else LOST
        if s.count == 0.0 or everything.count - s.count < 4.0:
            continue
        rest = 1.0 / (everything.w - s.w)
        a = everything
        ok, ee, en, eu, nn, nu, _ = invert_upper(
            a.ee - s.ee - rest * s.e * s.e, a.en - s.en - rest * s.e * s.n, a.eu - s.eu - rest * s.e * s.u,
            a.nn - s.nn - rest * s.n * s.n, a.nu - s.nu - rest * s.n * s.u, a.uu - s.uu - rest * s.u * s.u,
        )  # fmt: skip
        if not ok or (prior[at] <= spendable and ee + nn > POOR * (q[0, 0] + q[1, 1])):
            continue
        r_e, r_n, r_u = s.er + rest * s.e * s.r, s.nr + rest * s.n * s.r, s.ur + rest * s.u * s.r
        out.d_e[at], out.d_n[at] = -(ee * r_e + en * r_n + eu * r_u), -(en * r_e + nn * r_n + nu * r_u)
        out.l_ee[at], out.l_ne[at], out.l_nn[at] = cholesky_2(ee - q[0, 0], en - q[0, 1], nn - q[1, 1])
        out.state[at] = MONITORED


@jit(borrows=True)
def _sum_systems(system: Ints, c: Centred) -> None:
    """Fill the sums of each system and of all satellites."""
    for g in range(MAX_GROUPS + 1):
        s = c.sums[g]
        s.count, s.w, s.r, s.e, s.n, s.u = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        s.ee, s.en, s.eu, s.nn, s.nu, s.uu, s.er, s.nr, s.ur = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(system.size):
        w = c.weight[k]
        if w > 0.0:
            e, n, u, r = c.row[0, k], c.row[1, k], c.row[2, k], c.residual[k]
            s, w_e, w_n, w_u = c.sums[system[k]], w * e, w * n, w * u
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
    everything = c.sums[MAX_GROUPS]
    for g in range(MAX_GROUPS):
        s = c.sums[g]
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


@jit(borrows=True, forceinline=True)
def trapezoid(dt: float, had: bool, phi: float, white: float) -> Trapezoid:
    """``p += dt/2 (v_{t-1} + v_t)``, or ``p += dt v_t`` where there ``had`` been no velocity before."""
    now = 0.5 * dt if had else dt
    return Trapezoid(dt - now, now, phi, white)


@jit(borrows=True)
def advance_separations(t: Trapezoid, weight: float, last: Influences, now: Influences, s: Separations) -> None:
    """Advance the separations where Doppler moves the position: ``D += before d_{t-1} + now d_t`` and its covariance.

    ``D' = D + K n + M r`` with ``K = before L_{t-1} + now phi L_t`` and ``M = now L_t``, as the position itself
    (:func:`~.dead_reckoning_pl_kernel.step_doppler`). ``weight`` [s] is that of the last velocity in the position.
    """
    fresh = 1.0 - t.phi * t.phi
    inner, outer = t.white * (2.0 * weight + t.before) * t.before, t.white + fresh
    for k in range(0, s.state.size, WIDTH):
        a_ee, a_ne, a_nn = load(last.l_ee, k), load(last.l_ne, k), load(last.l_nn, k)
        m_ee, m_ne, m_nn = load(now.l_ee, k) * t.now, load(now.l_ne, k) * t.now, load(now.l_nn, k) * t.now
        k_ee, k_ne, k_nn = (
            a_ee * t.before + m_ee * t.phi,
            a_ne * t.before + m_ne * t.phi,
            a_nn * t.before + m_nn * t.phi,
        )
        a, b, c, d = load(s.ne_e, k), load(s.ne_n, k), load(s.nn_e, k), load(s.nn_n, k)
        store(load(s.d_e, k) + load(last.d_e, k) * t.before + load(now.d_e, k) * t.now, s.d_e, k)
        store(load(s.d_n, k) + load(last.d_n, k) * t.before + load(now.d_n, k) * t.now, s.d_n, k)
        ee = 2.0 * a * k_ee + k_ee * k_ee + outer * m_ee * m_ee + inner * a_ee * a_ee
        en = a * k_ne + b * k_nn + c * k_ee + k_ee * k_ne + outer * m_ee * m_ne + inner * a_ee * a_ne
        nn = 2.0 * (c * k_ne + d * k_nn) + k_ne * k_ne + k_nn * k_nn
        nn += outer * (m_ne * m_ne + m_nn * m_nn) + inner * (a_ne * a_ne + a_nn * a_nn)
        store(load(s.s_ee, k) + ee, s.s_ee, k)
        store(load(s.s_en, k) + en, s.s_en, k)
        store(load(s.s_nn, k) + nn, s.s_nn, k)
        store(t.phi * (a + k_ee) + fresh * m_ee, s.ne_e, k)
        store(t.phi * b, s.ne_n, k)
        store(t.phi * (c + k_ne) + fresh * m_ne, s.nn_e, k)
        store(t.phi * (d + k_nn) + fresh * m_nn, s.nn_n, k)
        store(maximum(load(s.state, k), maximum(load(last.state, k), load(now.state, k))), s.state, k)


@jit(borrows=True)
def fade_separations(phi: float, s: Separations) -> None:
    """An epoch in which Doppler does not move the position: the correlation with the errors of d fades."""
    for k in range(0, s.state.size, WIDTH):
        store(phi * load(s.ne_e, k), s.ne_e, k)
        store(phi * load(s.ne_n, k), s.ne_n, k)
        store(phi * load(s.nn_e, k), s.nn_e, k)
        store(phi * load(s.nn_n, k), s.nn_n, k)


# The bound


@jit(borrows=True)
def exposure(prior: Array, state: Array) -> tuple[float, float, float]:
    """Sum of the priors (W,) and of their squares over the modes used since the fix, and the sum of the LOST."""
    used, squares, lost = spread(0.0), spread(0.0), spread(0.0)
    for k in range(0, state.size, WIDTH):
        here, p = load(state, k), load(prior, k)
        p = where_less(IDLE, here, p, 0.0)
        used, squares = used + p, squares + p * p
        lost += where_less(MONITORED, here, p, 0.0)
    return total(used), total(squares), total(lost)


@jit(borrows=True)
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
def worst_separation(sine: float, cosine: float, sigma: float, by_heading: float, k_f: float, s: Separations) -> float:
    """``max_k abs(D_k,q) + K_f sigma_k,q`` [m] of the monitored modes on the axis ``q = [sine, cosine]``; 0 for none.

    ``sigma_k^2 = sigma^2 + (sigma_D + sigma_h)^2``: fault-free, of the separation by velocities, and ``by_heading`` of
    that by the heading, which may correlate [m].
    """
    worst = spread(0.0)
    for k in range(0, s.state.size, WIDTH):
        state, d = load(s.state, k), absolute(load(s.d_e, k) * sine + load(s.d_n, k) * cosine)
        more = load(s.s_ee, k) * (sine * sine) + load(s.s_en, k) * (2.0 * sine * cosine)
        more += load(s.s_nn, k) * (cosine * cosine)
        apart = root_of(maximum(more, 0.0)) + by_heading
        level = d + k_f * root_of(apart * apart + sigma * sigma)
        monitored = where_less(IDLE, state, where_less(MONITORED, state, 0.0, level), 0.0)
        worst = maximum(worst, monitored)
    return float(largest(worst))
