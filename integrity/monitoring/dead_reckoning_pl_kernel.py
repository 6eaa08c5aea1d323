"""Error growth of one vehicle between RTK fixes: covariance and signed bias, one epoch at a time (S1 eq 18-21).

Between fixes the position is integrated from the Doppler velocity or from odometer and heading. Their errors are
correlated in time, so the position error is correlated with them; these correlations are part of the state and survive
a change of source.

Letters: ``p`` position error in E and N; ``L n`` error of the Doppler velocity and ``sigma m`` of the odometer's speed,
n and m Gauss-Markov processes of variance 1, n with a white part w beside it; ``x = [d, b, c]`` errors of the heading
filter (:mod:`lanebound.integrity.positioning.heading_kernel`), whose own covariance the filter holds. The covariance of
p and x is carried along: an error of the gyro's scale adds up over a circle, and a turn there and back cancels it. It
assumes Gauss-Markov errors, the covariance of the filter a white bound of them: simulations show that both together
bound the position; a proof is missing. Only RTK resets the growth (:func:`reset`).

A heading that is wrong by ``e`` also shortens the path, by ``V dt (1 - cos e)``: of second order, and of one sign. Of
``e`` within ``K sigma + B`` it is at most ``(K sigma + B)^2 / 2`` of the path, and at most twice the path
(:func:`shortened`). In the first metres after a cold start it exceeds all else along.

An error of the axle distance turns the course by a known angle per metre in every epoch. Its effect on the position
adds up with its sign and is bounded by the declared bound of that distance.
"""

from __future__ import annotations

import math
from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record
from lanebound.integrity.core.small_matrix_kernel import cholesky_2
from lanebound.integrity.positioning.heading_kernel import TURN

__all__ = ["GROWTH", "STEP", "reset", "shortened", "sigma_and_bias", "step_doppler", "step_odometer", "step_still"]

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
    gb_e="Cov(p_E, b) with the error of the gyro bias [m rad/s]",
    gb_n="Cov(p_N, b) [m rad/s]",
    gs_e="Cov(p_E, c) with the error of the gyro scale [m]",
    gs_n="Cov(p_N, c) [m]",
    l_ee="Cholesky factor of the covariance of the last Doppler velocity, East East [m/s]",
    l_ne="the same, North East [m/s]",
    l_nn="the same, North North [m/s]",
    l_s="weight with which that velocity stands in the position [s]",
    have_l=("?", "the last epoch had a Doppler velocity"),
    apart_s="weight with which the last Doppler velocity stands in the separations [s]",
    cth_e="accumulated bias by heading, East, signed for a bias of one sign [m]",
    cth_n="the same, North [m]",
    cv_e="accumulated bias by odometer speed, East, signed [m]",
    cv_n="the same, North [m]",
    f_ee="variance of the part of the separations that the heading caused, East [m^2]",
    f_en="covariance of it, East and North [m^2]",
    f_nn="variance of it, North [m^2]",
    fh_e="Cov(that part, h), East [m rad]",
    fh_n="the same, North [m rad]",
    fb_e="Cov(that part, b), East [m rad/s]",
    fb_n="the same, North [m rad/s]",
    fs_e="Cov(that part, s), East [m]",
    fs_n="the same, North [m]",
    axle_e="bound of the accumulated bias by the axle distance, East, signed [m]",
    axle_n="the same, North [m]",
    run_e="path by odometer and heading, of either sign, East [m]",
    run_n="the same, North [m]",
    bow_ss_e="that path times half of sigma^2 of the heading, East [m rad^2]",
    bow_ss_n="the same, North [m rad^2]",
    bow_sb_e="times sigma B, with the bound B of the heading, East [m rad^2]",
    bow_sb_n="the same, North [m rad^2]",
    bow_bb_e="times half of B^2, East [m rad^2]",
    bow_bb_n="the same, North [m rad^2]",
    doppler_e="path by Doppler's history of the heading less that taken, East [m]",
    doppler_n="the same, North [m]",
    gyro_e="path by the gyro's history less that taken, East [m]",
    gyro_n="the same, North [m]",
    box_e="accumulated bias of either sign, East: Doppler, and that of the last RTK fix [m]",
    box_n="the same, North [m]",
)
"""Error growth of one position since an RTK fix."""

STEP = record(
    dt_s="length of the epoch [s]",
    phi_doppler="exp(-dt/tau) of the Doppler error, 0 for white noise",
    white_doppler="variance of the white part w of the Doppler error",
    phi_odometer="exp(-dt/tau) of the odometer error",
    axle_bias="error of the mean heading by the bound of the axle distance, signed [rad]",
    turn=(TURN, "the errors of the heading filter"),
)
"""What an epoch does to all error processes."""


@jit
def reset(cov_ee: float, cov_en: float, cov_nn: float, bias_e: float, bias_n: float, g: Any) -> None:
    """An RTK fix: its covariance [m^2] and bias bounds [m] replace all that had accumulated."""
    g.p_ee, g.p_en, g.p_nn = cov_ee, cov_en, cov_nn
    g.ne_e, g.ne_n, g.nn_e, g.nn_n, g.od_e, g.od_n, g.th_e, g.th_n = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    g.gb_e, g.gb_n, g.gs_e, g.gs_n, g.axle_e, g.axle_n = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    g.f_ee, g.f_en, g.f_nn = 0.0, 0.0, 0.0
    g.fh_e, g.fh_n, g.fb_e, g.fb_n, g.fs_e, g.fs_n = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    g.l_ee, g.l_ne, g.l_nn, g.l_s, g.have_l, g.apart_s = 0.0, 0.0, 0.0, 0.0, False, 0.0
    g.cth_e, g.cth_n, g.cv_e, g.cv_n, g.box_e, g.box_n = 0.0, 0.0, 0.0, 0.0, bias_e, bias_n
    g.run_e, g.run_n, g.bow_ss_e, g.bow_ss_n = 0.0, 0.0, 0.0, 0.0
    g.bow_sb_e, g.bow_sb_n, g.bow_bb_e, g.bow_bb_n = 0.0, 0.0, 0.0, 0.0
    g.doppler_e, g.doppler_n, g.gyro_e, g.gyro_n = 0.0, 0.0, 0.0, 0.0


@jit
def remember_velocity(q_ee: float, q_en: float, q_nn: float, g: Any) -> None:
    """Store this epoch's Doppler covariance [m^2/s^2] for the next trapezoid; all zero when there was no velocity."""
    g.have_l, g.l_s = q_ee > 0.0, 0.0
    g.l_ee, g.l_ne, g.l_nn = cholesky_2(q_ee, q_en, q_nn)


@jit
def _decay(step: Any, g: Any) -> None:
    """One epoch of the error processes that do not move the position; a course calibrates with ``a (n + w)``."""
    turn = step.turn
    a_e, a_n = step.phi_doppler * turn.course[0], step.phi_doppler * turn.course[1]
    by_e, by_n = a_e * g.ne_e + a_n * g.ne_n, a_e * g.nn_e + a_n * g.nn_n  # Cov(p, error of the course)
    g.ne_e *= step.phi_doppler
    g.ne_n *= step.phi_doppler
    g.nn_e *= step.phi_doppler
    g.nn_n *= step.phi_doppler
    g.od_e *= step.phi_odometer
    g.od_n *= step.phi_odometer
    if not turn.rests:
        g.th_e -= turn.dt * g.gb_e + turn.delta * g.gs_e
        g.th_n -= turn.dt * g.gb_n + turn.delta * g.gs_n
    seen_e, seen_n = (g.gb_e, g.gb_n) if turn.rests else (g.th_e, g.th_n)
    g.th_e += turn.k_h * (by_e - seen_e)
    g.th_n += turn.k_h * (by_n - seen_n)
    g.gb_e += turn.k_b * (by_e - seen_e)
    g.gb_n += turn.k_b * (by_n - seen_n)
    g.gs_e += turn.k_s * (by_e - seen_e)
    g.gs_n += turn.k_s * (by_n - seen_n)


@jit
def step_still(step: Any, g: Any) -> None:
    """An epoch at rest: the position error does not grow, its correlations fade."""
    g.have_l = False
    _decay(step, g)


@jit
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
    had, l_ee, l_ne, l_nn, weight, white = g.have_l, g.l_ee, g.l_ne, g.l_nn, g.l_s, step.white_doppler
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
    inner, outer = white * (2.0 * weight + before) * before, white * now * now
    g.p_ee += inner * l_ee * l_ee + outer * g.l_ee * g.l_ee
    g.p_en += inner * l_ee * l_ne + outer * g.l_ee * g.l_ne
    g.p_nn += inner * (l_ne * l_ne + l_nn * l_nn) + outer * (g.l_ne * g.l_ne + g.l_nn * g.l_nn)
    g.l_s = now
    _decay(step, g)
    x0, x1 = step.turn.before, step.turn.now
    g.th_e += before * l_ee * x0[0, 0] + now * g.l_ee * x1[0, 0]
    g.gb_e += before * l_ee * x0[0, 1] + now * g.l_ee * x1[0, 1]
    g.gs_e += before * l_ee * x0[0, 2] + now * g.l_ee * x1[0, 2]
    g.th_n += before * (l_ne * x0[0, 0] + l_nn * x0[1, 0]) + now * (g.l_ne * x1[0, 0] + g.l_nn * x1[1, 0])
    g.gb_n += before * (l_ne * x0[0, 1] + l_nn * x0[1, 1]) + now * (g.l_ne * x1[0, 1] + g.l_nn * x1[1, 1])
    g.gs_n += before * (l_ne * x0[0, 2] + l_nn * x0[1, 2]) + now * (g.l_ne * x1[0, 2] + g.l_nn * x1[1, 2])
    g.ne_e += phi * k_ee + fresh * m_ee
    g.nn_e += phi * k_ne + fresh * m_ne
    g.nn_n += phi * k_nn + fresh * m_nn


@jit
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
    dt, turn = step.dt_s, step.turn
    g.have_l = False
    along_e, along_n = dt * sin_h, dt * cos_h
    across_e, across_n = speed * dt * cos_h, -speed * dt * sin_h
    g.cth_e += across_e * heading_bias
    g.cth_n += across_n * heading_bias
    g.cv_e += along_e * bias
    g.cv_n += along_n * bias
    g.axle_e += across_e * step.axle_bias
    g.axle_n += across_n * step.axle_bias
    mean = turn.mean_variance
    _bow(abs(speed * along_e), abs(speed * along_n), mean, heading_bias + abs(step.axle_bias), g)
    t_e = g.th_e - 0.5 * (turn.dt * g.gb_e + turn.delta * g.gs_e)
    t_n = g.th_n - 0.5 * (turn.dt * g.gb_n + turn.delta * g.gs_n)
    o_e, o_n = step.phi_odometer * sigma * g.od_e, step.phi_odometer * sigma * g.od_n
    g.p_ee += 2.0 * (across_e * t_e + along_e * o_e)
    g.p_en += across_e * t_n + across_n * t_e + along_e * o_n + along_n * o_e
    g.p_nn += 2.0 * (across_n * t_n + along_n * o_n)
    g.p_ee += across_e * across_e * mean + along_e * along_e * sigma * sigma
    g.p_en += across_e * across_n * mean + along_e * along_n * sigma * sigma
    g.p_nn += across_n * across_n * mean + along_n * along_n * sigma * sigma
    _decay(step, g)
    g.th_e += across_e * turn.joint_h
    g.th_n += across_n * turn.joint_h
    g.gb_e += across_e * turn.joint_b
    g.gb_n += across_n * turn.joint_b
    g.gs_e += across_e * turn.joint_s
    g.gs_n += across_n * turn.joint_s
    g.ne_e += across_e * turn.mean_noise[0]
    g.ne_n += across_e * turn.mean_noise[1]
    g.nn_e += across_n * turn.mean_noise[0]
    g.nn_n += across_n * turn.mean_noise[1]
    g.od_e += along_e * sigma
    g.od_n += along_n * sigma


@jit
def _bow(run_e: float, run_n: float, variance: float, bound: float, g: Any) -> None:
    """Add a path (run_e, run_n) [m] along a heading of an error with this variance [rad^2] and bound [rad]."""
    product = math.sqrt(variance) * bound
    g.run_e += run_e
    g.run_n += run_n
    g.bow_ss_e += 0.5 * run_e * variance
    g.bow_ss_n += 0.5 * run_n * variance
    g.bow_sb_e += run_e * product
    g.bow_sb_n += run_n * product
    g.bow_bb_e += 0.5 * run_e * bound * bound
    g.bow_bb_n += 0.5 * run_n * bound * bound


@jit
def shortened(sine: float, cosine: float, k: float, g: Any) -> float:
    """Bound on the axis (sine, cosine) of how much wrong headings have shortened the path [m].

    ``k`` is the factor K: the sum of ``V dt (K sigma + B)^2 / 2``, at most twice the path; all parts with one sign.
    """
    if not 0.0 <= k < math.inf:
        return float(2.0 * (abs(sine) * g.run_e + abs(cosine) * g.run_n))
    east = min(k * k * g.bow_ss_e + k * g.bow_sb_e + g.bow_bb_e, 2.0 * g.run_e)
    north = min(k * k * g.bow_ss_n + k * g.bow_sb_n + g.bow_bb_n, 2.0 * g.run_n)
    return float(abs(sine) * east + abs(cosine) * north)


@jit
def sigma_and_bias(sin_h: float, cos_h: float, published: bool, g: Any) -> tuple[float, float, float, float]:
    """``sigma_AT, sigma_CT, B_AT, B_CT`` [m] along the heading (S1 eq 16, 18-19).

    Exact bias ``abs(R c_th) + abs(R c_v) + abs(R c_axle) + abs(R) box``; published ``sqrt((sin t c_E)^2 + (cos t
    c_N)^2)`` of the signed sum c, which depends on the heading.
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
        b_at += abs(s * g.axle_e + c * g.axle_n) + abs(s) * g.box_e + abs(c) * g.box_n
        b_ct += abs(c * g.axle_e - s * g.axle_n) + abs(c) * g.box_e + abs(s) * g.box_n
    return math.sqrt(max(var_at, 0.0)), math.sqrt(max(var_ct, 0.0)), b_at, b_ct
