"""Error growth of one vehicle between RTK fixes: covariance and signed bias, one epoch at a time (S1 eq 18-21).

Between fixes the position is integrated from the Doppler velocity or from odometer and heading. Their errors are
correlated in time, so the position error is correlated with them; these correlations are part of the state and survive
a change of source. Everything is one flat vector ``g`` (GROWTH_SIZE,):

=====================  ==========================================================================================
P_EE P_EN P_NN         covariance of the position error p in E, N [m^2]
NE_E NE_N NN_E NN_N    ``Cov(p, n)``, the Doppler velocity's error = L n, n Gauss-Markov of variance 1 [m]
OD_E OD_N              ``Cov(p, m)``, the odometer's speed error = sigma m, m Gauss-Markov of variance 1 [m]
TH_E TH_N VAR_TH       ``Cov(p, d)`` [m rad] and variance [rad^2] of the heading error d
L_EE L_NE L_NN HAVE_L  Cholesky factor of the last epoch's Doppler velocity covariance [m/s], and whether there was one
CTH_E CTH_N            accumulated bias by heading, signed for a bias of one sign [m]
CV_E CV_N              accumulated bias by odometer speed, signed [m]
BOX_E BOX_N            accumulated bias of either sign in E and in N: Doppler, and what the last RTK fix had [m]
=====================  ==========================================================================================

Only RTK resets it (:func:`reset`); the heading's own variance is set by whoever estimates the heading.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit

__all__ = ["GROWTH_SIZE", "levels", "reset", "sigma_and_bias", "step_doppler", "step_odometer", "step_still"]

Array = NDArray[np.float64]

P_EE, P_EN, P_NN, NE_E, NE_N, NN_E, NN_N, OD_E, OD_N, TH_E, TH_N, VAR_TH = range(12)
L_EE, L_NE, L_NN, HAVE_L, CTH_E, CTH_N, CV_E, CV_N, BOX_E, BOX_N = range(12, 22)
GROWTH_SIZE = 22


@jit
def reset(
    cov_ee: float, cov_en: float, cov_nn: float, bias_e: float, bias_n: float, heading_variance: float, g: Array
) -> None:
    """An RTK fix: its covariance [m^2] and bias bounds [m] replace all that had accumulated."""
    for i in range(GROWTH_SIZE):
        g[i] = 0.0
    g[P_EE], g[P_EN], g[P_NN] = cov_ee, cov_en, cov_nn
    g[BOX_E], g[BOX_N], g[VAR_TH] = bias_e, bias_n, heading_variance


@jit
def remember_velocity(q_ee: float, q_en: float, q_nn: float, g: Array) -> None:
    """Keep this epoch's Doppler covariance [m^2/s^2] for the next trapezoid; all zero when there was no velocity."""
    g[HAVE_L] = 1.0 if q_ee > 0.0 else 0.0
    g[L_EE] = math.sqrt(max(q_ee, 0.0))
    g[L_NE] = q_en / g[L_EE] if q_ee > 0.0 else 0.0
    g[L_NN] = math.sqrt(max(q_nn - g[L_NE] * g[L_NE], 0.0))


@jit
def _heading_noise(variance: float, carry: float, g: Array) -> float:
    """Variance that is new in the heading error, which keeps the share ``carry`` of the old one."""
    return max(variance - carry * carry * float(g[VAR_TH]), 0.0)


@jit
def _decay(phi_doppler: float, phi_odometer: float, heading_variance: float, carry: float, g: Array) -> None:
    """One epoch of the error processes that do not move the position."""
    for i in range(NE_E, NN_N + 1):
        g[i] *= phi_doppler
    g[OD_E] *= phi_odometer
    g[OD_N] *= phi_odometer
    g[TH_E] *= carry
    g[TH_N] *= carry
    g[VAR_TH] = carry * carry * g[VAR_TH] + _heading_noise(heading_variance, carry, g)


@jit
def step_still(phi_doppler: float, phi_odometer: float, heading_variance: float, carry: float, g: Array) -> None:
    """An epoch at rest: the position error does not grow, its correlations fade."""
    g[HAVE_L] = 0.0
    _decay(phi_doppler, phi_odometer, heading_variance, carry, g)


@jit
def step_doppler(
    dt: float,
    q_ee: float,
    q_en: float,
    q_nn: float,
    bias: float,
    phi_doppler: float,
    phi_odometer: float,
    heading_variance: float,
    carry: float,
    published: bool,
    g: Array,
) -> None:
    """``p += dt/2 (v_{t-1} + v_t)`` (S1 eq 20), or ``p += dt v_t`` when the previous epoch had no velocity.

    Parameters
    ----------
    q_ee, q_en, q_nn : covariance of this epoch's velocity [m^2/s^2].
    bias : bound of a constant velocity bias in E and in N [m/s].
    phi_doppler, phi_odometer : ``exp(-dt/tau)`` of either error, 0 for white noise.
    heading_variance, carry : the heading error's variance after this epoch [rad^2] and the share of the previous error
        that it still holds (1 without calibration).
    published : grow by S1 eq 21, ``dt^2/4 (Q_{t-1} + Q_t)``, as if trapezoids were independent.
    """
    had, l_ee, l_ne, l_nn = g[HAVE_L], g[L_EE], g[L_NE], g[L_NN]
    remember_velocity(q_ee, q_en, q_nn, g)
    now = 0.5 * dt if had > 0.0 else dt
    before = dt - now
    g[BOX_E] += dt * bias
    g[BOX_N] += dt * bias
    if published:
        g[P_EE] += now * now * q_ee + before * before * l_ee * l_ee
        g[P_EN] += now * now * q_en + before * before * l_ee * l_ne
        g[P_NN] += now * now * q_nn + before * before * (l_ne * l_ne + l_nn * l_nn)
        _decay(phi_doppler, phi_odometer, heading_variance, carry, g)
        return
    # p' = p + K n + M w with n' = phi n + r w, r^2 = 1 - phi^2, M = now r L_t, K = before L_{t-1} + now phi L_t
    phi = phi_doppler
    k_ee = before * l_ee + now * phi * g[L_EE]
    k_ne = before * l_ne + now * phi * g[L_NE]
    k_nn = before * l_nn + now * phi * g[L_NN]
    fresh = 1.0 - phi * phi
    m_ee, m_ne, m_nn = now * g[L_EE], now * g[L_NE], now * g[L_NN]
    a, b, c, d = g[NE_E], g[NE_N], g[NN_E], g[NN_N]
    g[P_EE] += 2.0 * a * k_ee + k_ee * k_ee + fresh * m_ee * m_ee
    g[P_EN] += a * k_ne + b * k_nn + c * k_ee + k_ee * k_ne + fresh * m_ee * m_ne
    g[P_NN] += 2.0 * (c * k_ne + d * k_nn) + k_ne * k_ne + k_nn * k_nn + fresh * (m_ne * m_ne + m_nn * m_nn)
    _decay(phi, phi_odometer, heading_variance, carry, g)
    g[NE_E] += phi * k_ee + fresh * m_ee
    g[NN_E] += phi * k_ne + fresh * m_ne
    g[NN_N] += phi * k_nn + fresh * m_nn


@jit
def step_odometer(
    dt: float,
    speed: float,
    sin_h: float,
    cos_h: float,
    sigma: float,
    bias: float,
    heading_bias: float,
    phi_doppler: float,
    phi_odometer: float,
    heading_variance: float,
    carry: float,
    published: bool,
    g: Array,
) -> None:
    """``p += V dt [sin t, cos t]`` with the interval's mean heading and speed (equations.md 3).

    Parameters
    ----------
    speed : mean odometer speed V [m/s], signed.
    sin_h, cos_h : of the mean heading.
    sigma, bias : standard deviation and bound of the bias of the speed [m/s].
    heading_bias : bound ``b_theta0 + db (t - t_cal)`` of the heading's bias [rad].
    published : grow by ``S Q S'`` each epoch, as if errors were independent from epoch to epoch.

    Other parameters as :func:`step_doppler`.
    """
    g[HAVE_L] = 0.0
    along_e, along_n = dt * sin_h, dt * cos_h
    across_e, across_n = speed * dt * cos_h, -speed * dt * sin_h
    g[CTH_E] += across_e * heading_bias
    g[CTH_N] += across_n * heading_bias
    g[CV_E] += along_e * bias
    g[CV_N] += along_n * bias
    old = g[VAR_TH]
    new = carry * carry * old + _heading_noise(heading_variance, carry, g)
    mean = 0.25 * (old + 2.0 * carry * old + new)  # variance of the interval's mean heading error
    if published:
        g[P_EE] += across_e * across_e * new + along_e * along_e * sigma * sigma
        g[P_EN] += across_e * across_n * new + along_e * along_n * sigma * sigma
        g[P_NN] += across_n * across_n * new + along_n * along_n * sigma * sigma
        _decay(phi_doppler, phi_odometer, heading_variance, carry, g)
        return
    half = 0.5 * (1.0 + carry)
    t_e, t_n = half * g[TH_E], half * g[TH_N]
    o_e, o_n = phi_odometer * sigma * g[OD_E], phi_odometer * sigma * g[OD_N]
    g[P_EE] += 2.0 * (across_e * t_e + along_e * o_e)
    g[P_EN] += across_e * t_n + across_n * t_e + along_e * o_n + along_n * o_e
    g[P_NN] += 2.0 * (across_n * t_n + along_n * o_n)
    g[P_EE] += across_e * across_e * mean + along_e * along_e * sigma * sigma
    g[P_EN] += across_e * across_n * mean + along_e * along_n * sigma * sigma
    g[P_NN] += across_n * across_n * mean + along_n * along_n * sigma * sigma
    _decay(phi_doppler, phi_odometer, heading_variance, carry, g)
    joint = 0.5 * (carry * old + new)
    g[TH_E] += across_e * joint
    g[TH_N] += across_n * joint
    g[OD_E] += along_e * sigma
    g[OD_N] += along_n * sigma


@jit
def sigma_and_bias(sin_h: float, cos_h: float, published: bool, g: Array) -> tuple[float, float, float, float]:
    """``sigma_AT, sigma_CT, B_AT, B_CT`` [m] along the heading (S1 eq 16, 18-19).

    Exact bias ``abs(R c_th) + abs(R c_v) + abs(R) box``; published ``sqrt((sin t c_E)^2 + (cos t c_N)^2)`` of the
    signed sum c, which depends on the heading.
    """
    s, c = sin_h, cos_h
    var_at = s * s * g[P_EE] + 2.0 * s * c * g[P_EN] + c * c * g[P_NN]
    var_ct = c * c * g[P_EE] - 2.0 * s * c * g[P_EN] + s * s * g[P_NN]
    if published:
        e, n = g[CTH_E] + g[CV_E] + g[BOX_E], g[CTH_N] + g[CV_N] + g[BOX_N]
        b_at, b_ct = math.hypot(s * e, c * n), math.hypot(c * e, s * n)
    else:
        b_at = abs(s * g[CTH_E] + c * g[CTH_N]) + abs(s * g[CV_E] + c * g[CV_N])
        b_ct = abs(c * g[CTH_E] - s * g[CTH_N]) + abs(c * g[CV_E] - s * g[CV_N])
        b_at += abs(s) * g[BOX_E] + abs(c) * g[BOX_N]
        b_ct += abs(c) * g[BOX_E] + abs(s) * g[BOX_N]
    return math.sqrt(max(var_at, 0.0)), math.sqrt(max(var_ct, 0.0)), b_at, b_ct


@jit
def levels(sin_h: float, cos_h: float, k_md: Array, published: bool, g: Array, out: Array) -> None:
    """``PL_q = K_md sigma_q + B_q`` (S1 eq 18-19).  k_md (R, 2) for AT and CT -> out (R, 2) [m]."""
    sigma_at, sigma_ct, b_at, b_ct = sigma_and_bias(sin_h, cos_h, published, g)
    for r in range(k_md.shape[0]):
        out[r, 0] = k_md[r, 0] * sigma_at + b_at
        out[r, 1] = k_md[r, 1] * sigma_ct + b_ct
