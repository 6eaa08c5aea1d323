"""Error growth of one vehicle between RTK fixes: covariance and signed bias, one epoch at a time (S1 eq 18-21).

Between fixes the position is integrated from the Doppler velocity or from odometer and heading. Their errors are
correlated in time, so the position error is correlated with them; these correlations are part of the state and survive
a change of source.

Letters: ``p`` position error in E and N; ``L n`` error of the Doppler velocity and ``sigma m`` of the odometer's speed,
n and m Gauss-Markov processes of variance 1; ``d`` heading error. Only RTK resets the growth (:func:`reset`).
"""

from __future__ import annotations

import math
from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record

__all__ = ["GROWTH", "STEP", "reset", "sigma_and_bias", "step_doppler", "step_odometer", "step_still"]

GROWTH = record(
    p_ee="variance of the position error, East [m^2]",
    p_en="its covariance of East and North [m^2]",
    p_nn="its variance, North [m^2]",
    ne_e="Cov(p_E, n_E) with the Doppler error [m]",
    ne_n="Cov(p_E, n_N) [m]",
    nn_e="Cov(p_N, n_E) [m]",
    nn_n="Cov(p_N, n_N) [m]",
    od_e="Cov(p_E, m) with the odometer error [m]",
    od_n="Cov(p_N, m) [m]",
    th_e="Cov(p_E, d) with the heading error [m rad]",
    th_n="Cov(p_N, d) [m rad]",
    var_th="variance of the heading error [rad^2]",
    l_ee="Cholesky factor of the covariance of the last Doppler velocity, East East [m/s]",
    l_ne="the same, North East [m/s]",
    l_nn="the same, North North [m/s]",
    have_l=("?", "the last epoch had a Doppler velocity"),
    cth_e="accumulated bias by heading, East, signed for a bias of one sign [m]",
    cth_n="the same, North [m]",
    cv_e="accumulated bias by odometer speed, East, signed [m]",
    cv_n="the same, North [m]",
    box_e="accumulated bias of either sign, East: Doppler, and that of the last RTK fix [m]",
    box_n="the same, North [m]",
)
"""Error growth of one position since an RTK fix."""

STEP = record(
    dt_s="length of the epoch [s]",
    phi_doppler="exp(-dt/tau) of the Doppler error, 0 for white noise",
    phi_odometer="exp(-dt/tau) of the odometer error",
    heading_variance="variance of the heading error after this epoch [rad^2]",
    carry="share of the previous heading error that is still in it, 1 without calibration",
)
"""What an epoch does to all error processes."""


@jit(borrows=True)
def reset(
    cov_ee: float, cov_en: float, cov_nn: float, bias_e: float, bias_n: float, heading_variance: float, g: Any
) -> None:
    """An RTK fix: its covariance [m^2] and bias bounds [m] replace all that had accumulated."""
    g.p_ee, g.p_en, g.p_nn = cov_ee, cov_en, cov_nn
    g.ne_e, g.ne_n, g.nn_e, g.nn_n, g.od_e, g.od_n, g.th_e, g.th_n = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    g.var_th = heading_variance
    g.l_ee, g.l_ne, g.l_nn, g.have_l = 0.0, 0.0, 0.0, False
    g.cth_e, g.cth_n, g.cv_e, g.cv_n, g.box_e, g.box_n = 0.0, 0.0, 0.0, 0.0, bias_e, bias_n


@jit(borrows=True)
def remember_velocity(q_ee: float, q_en: float, q_nn: float, g: Any) -> None:
    """Store this epoch's Doppler covariance [m^2/s^2] for the next trapezoid; all zero when there was no velocity."""
    g.have_l = q_ee > 0.0
    g.l_ee = math.sqrt(max(q_ee, 0.0))
    g.l_ne = q_en / g.l_ee if q_ee > 0.0 else 0.0
    g.l_nn = math.sqrt(max(q_nn - g.l_ne * g.l_ne, 0.0))


@jit(borrows=True)
def _heading_noise(step: Any, g: Any) -> float:
    """Variance that is new in the heading error, which keeps the share ``carry`` of the old one."""
    return float(max(step.heading_variance - step.carry * step.carry * g.var_th, 0.0))


@jit(borrows=True)
def _decay(step: Any, g: Any) -> None:
    """One epoch of the error processes that do not move the position."""
    g.ne_e *= step.phi_doppler
    g.ne_n *= step.phi_doppler
    g.nn_e *= step.phi_doppler
    g.nn_n *= step.phi_doppler
    g.od_e *= step.phi_odometer
    g.od_n *= step.phi_odometer
    g.th_e *= step.carry
    g.th_n *= step.carry
    g.var_th = step.carry * step.carry * g.var_th + _heading_noise(step, g)


@jit(borrows=True)
def step_still(step: Any, g: Any) -> None:
    """An epoch at rest: the position error does not grow, its correlations fade."""
    g.have_l = False
    _decay(step, g)


@jit(borrows=True)
def step_doppler(step: Any, q_ee: float, q_en: float, q_nn: float, bias: float, g: Any) -> None:
    """``p += dt/2 (v_{t-1} + v_t)`` (S1 eq 20), or ``p += dt v_t`` when the previous epoch had no velocity.

    Parameters
    ----------
    step : of STEP.
    q_ee, q_en, q_nn : covariance of this epoch's velocity [m^2/s^2].
    bias : bound of a constant velocity bias in E and in N [m/s].
    g : of GROWTH.
    """
    dt, phi = step.dt_s, step.phi_doppler
    had, l_ee, l_ne, l_nn = g.have_l, g.l_ee, g.l_ne, g.l_nn
    remember_velocity(q_ee, q_en, q_nn, g)
    now = 0.5 * dt if had else dt
    before = dt - now
    g.box_e += dt * bias
    g.box_n += dt * bias
    # p' = p + K n + M w with n' = phi n + r w, r^2 = 1 - phi^2, M = now r L_t, K = before L_{t-1} + now phi L_t
    k_ee = before * l_ee + now * phi * g.l_ee
    k_ne = before * l_ne + now * phi * g.l_ne
    k_nn = before * l_nn + now * phi * g.l_nn
    fresh = 1.0 - phi * phi
    m_ee, m_ne, m_nn = now * g.l_ee, now * g.l_ne, now * g.l_nn
    a, b, c, d = g.ne_e, g.ne_n, g.nn_e, g.nn_n
    g.p_ee += 2.0 * a * k_ee + k_ee * k_ee + fresh * m_ee * m_ee
    g.p_en += a * k_ne + b * k_nn + c * k_ee + k_ee * k_ne + fresh * m_ee * m_ne
    g.p_nn += 2.0 * (c * k_ne + d * k_nn) + k_ne * k_ne + k_nn * k_nn + fresh * (m_ne * m_ne + m_nn * m_nn)
    _decay(step, g)
    g.ne_e += phi * k_ee + fresh * m_ee
    g.nn_e += phi * k_ne + fresh * m_ne
    g.nn_n += phi * k_nn + fresh * m_nn


@jit(borrows=True)
def step_odometer(
    step: Any, speed: float, sin_h: float, cos_h: float, sigma: float, bias: float, heading_bias: float, g: Any
) -> None:
    """``p += V dt [sin t, cos t]`` with the interval's mean heading and speed (equations.md 3).

    Parameters
    ----------
    step : of STEP.
    speed : mean odometer speed V [m/s], signed.
    sin_h, cos_h : of the mean heading.
    sigma, bias : standard deviation and bound of the bias of the speed [m/s].
    heading_bias : bound ``b_theta0 + db (t - t_cal)`` of the heading's bias [rad].
    g : of GROWTH.
    """
    dt, carry = step.dt_s, step.carry
    g.have_l = False
    along_e, along_n = dt * sin_h, dt * cos_h
    across_e, across_n = speed * dt * cos_h, -speed * dt * sin_h
    g.cth_e += across_e * heading_bias
    g.cth_n += across_n * heading_bias
    g.cv_e += along_e * bias
    g.cv_n += along_n * bias
    old = g.var_th
    new = carry * carry * old + _heading_noise(step, g)
    mean = 0.25 * (old + 2.0 * carry * old + new)  # variance of the interval's mean heading error
    half = 0.5 * (1.0 + carry)
    t_e, t_n = half * g.th_e, half * g.th_n
    o_e, o_n = step.phi_odometer * sigma * g.od_e, step.phi_odometer * sigma * g.od_n
    g.p_ee += 2.0 * (across_e * t_e + along_e * o_e)
    g.p_en += across_e * t_n + across_n * t_e + along_e * o_n + along_n * o_e
    g.p_nn += 2.0 * (across_n * t_n + along_n * o_n)
    g.p_ee += across_e * across_e * mean + along_e * along_e * sigma * sigma
    g.p_en += across_e * across_n * mean + along_e * along_n * sigma * sigma
    g.p_nn += across_n * across_n * mean + along_n * along_n * sigma * sigma
    _decay(step, g)
    joint = 0.5 * (carry * old + new)
    g.th_e += across_e * joint
    g.th_n += across_n * joint
    g.od_e += along_e * sigma
    g.od_n += along_n * sigma


@jit(borrows=True)
def sigma_and_bias(sin_h: float, cos_h: float, published: bool, g: Any) -> tuple[float, float, float, float]:
    """``sigma_AT, sigma_CT, B_AT, B_CT`` [m] along the heading (S1 eq 16, 18-19).

    Exact bias ``abs(R c_th) + abs(R c_v) + abs(R) box``; published ``sqrt((sin t c_E)^2 + (cos t c_N)^2)`` of the
    signed sum c, which depends on the heading.
    """
    s, c = sin_h, cos_h
    var_at = s * s * g.p_ee + 2.0 * s * c * g.p_en + c * c * g.p_nn
    var_ct = c * c * g.p_ee - 2.0 * s * c * g.p_en + s * s * g.p_nn
    if published:
        e, n = g.cth_e + g.cv_e + g.box_e, g.cth_n + g.cv_n + g.box_n
        b_at, b_ct = math.hypot(s * e, c * n), math.hypot(c * e, s * n)
    else:
        b_at = abs(s * g.cth_e + c * g.cth_n) + abs(s * g.cv_e + c * g.cv_n)
        b_ct = abs(c * g.cth_e - s * g.cth_n) + abs(c * g.cv_e - s * g.cv_n)
        b_at += abs(s) * g.box_e + abs(c) * g.box_n
        b_ct += abs(c) * g.box_e + abs(s) * g.box_n
    return math.sqrt(max(var_at, 0.0)), math.sqrt(max(var_ct, 0.0)), b_at, b_ct
