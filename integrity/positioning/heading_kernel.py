"""Heading from the gyro, calibrated by Doppler and by standstill (S1 section 2, S2 section 2.2).

A Kalman filter for one vehicle with three errors ``x = [d, b, c]``: heading, gyro bias, and gyro scale. The gyro
measures an increment ``D`` of the true turn ``(D - b dt - noise) / (1 + s)``. With ``c = s / (1 + s)`` the turn is
linear in the states, ``D - b dt - c D``, and the errors (estimate less truth) follow ``x' = F x + [n, 0, 0]``, ``F =
[[1, -dt, -D], [0, 1, 0], [0, 0, 1]]``: the error by the scale grows with the angle turned, and a turn back cancels it.
The declared scale must be an upper bound of the 1-sigma of the true one, which is constant and normal.

The random walk of the bias stands for every wander of the gyro. A walk of variance ``q`` per second, with an initial
variance of at least twice that of the wander, overbounds a Gauss-Markov bias of ``sigma`` and any correlation time of
at least ``tau`` for ``q = 2 sigma^2 / tau`` (Langel, Crespillo, Joerger, "Bounding sequential estimation errors due to
Gauss-Markov noise with uncertain parameters", 2019, with an upper limit of the time at infinity): the difference of the
two covariance functions is positive semidefinite, so the bound holds for every linear filter
(:func:`lanebound.integrity.positioning.correlation.overbounding_walk`).

Doppler headings carry errors correlated over a time that is known only within a range. In the filter a white error
bounds them, of the power that the largest correlation time has at low frequency
(:func:`lanebound.integrity.positioning.correlation.bound_correlation`), so that repeating them does not feign
precision. The same errors move a position that integrates the Doppler velocity. ``n`` and ``w`` are the correlated and
the white part of a unit error in E and N; their covariances with x show how far heading and position are wrong in the
same sense.

``a``, the part of ``x`` that an error of the declared axle distance causes, follows the same equations without noise:
in a turn at rate ``w`` and speed ``V`` the side slip is wrong by ``w / V`` per metre, and so is every course that
calibrates.
"""

from __future__ import annotations

import math
from typing import Any

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.angles_kernel import wrap
from lanebound.integrity.core.records import record

__all__ = [
    "CALIBRATION",
    "HEADING",
    "TURN",
    "copy_heading",
    "correct",
    "correlate",
    "doppler_heading_usable",
    "doppler_heading_variance",
    "expect_turn",
    "observe",
    "predict_heading",
    "raise_uncertainty",
    "rest_heading",
]

HEADING = record(
    angle="azimuth of the heading [rad]",
    gyro_bias="bias of the yaw gyro [rad/s]",
    gyro_scale="c, share of a measured turn that is error of scale [-]",
    p_hh="variance of the heading error [rad^2]",
    p_hb="covariance of heading and bias [rad^2/s]",
    p_hs="covariance of heading and scale [rad]",
    p_bb="variance of the bias [rad^2/s^2]",
    p_bs="covariance of bias and scale [rad/s]",
    p_ss="variance of the scale [-]",
    axle_h="heading error by an error of the axle distance [rad/m]",
    axle_b="bias error by it [rad/s/m]",
    axle_s="scale error by it [1/m]",
    noise=("f8", (2, 3), "Cov(n, x) of the correlated Doppler error in E and N [rad], [rad/s], [-]"),
    white=("f8", (2, 3), "Cov(w, x) of the white Doppler error of the last epoch"),
)
"""State of the heading filter."""

TURN = record(
    dt="length of the epoch [s]",
    delta="D, measured turn [rad]",
    rests=("?", "at rest: the bias is observed, the heading does not turn"),
    mean_variance="variance of the error of the epoch's mean heading [rad^2]",
    joint_h="covariance of that error with the heading error at the end [rad^2]",
    joint_b="with the bias error [rad^2/s]",
    joint_s="with the scale error [rad]",
    k_h="gain of the heading by the correction of the epoch, 0: none [-] or [s]",
    k_b="gain of the bias [1/s] or [-]",
    k_s="gain of the scale [1/rad] or [s/rad]",
    axle="error of the mean heading by an error of the axle distance [rad/m]",
    right=("f8", (2,), "error of the course that calibrates, by a velocity error in E and N [rad s/m]"),
    course=("f8", (2,), "error of the course that calibrates, by a unit Doppler error in E and N [rad]"),
    mean_noise=("f8", (2,), "Cov(n of this epoch, error of the mean heading) [rad]"),
    before=("f8", (2, 3), "Cov(n + w of the last epoch, x at the end)"),
    now=("f8", (2, 3), "Cov(n + w of this epoch, x at the end)"),
)
"""What an epoch does to the errors of the filter: ``x' = (I - k H)(F x)``, H the heading, or the bias at rest."""

CALIBRATION = record(
    min_speed="least odometer speed [m/s]",
    speed_agreement="largest difference of Doppler and odometer speed [m/s]",
    max_hdop="largest HDOP [-]",
    max_jump="largest difference of the Doppler course and the heading [rad]",
)
"""When Doppler calibrates the heading (S1 table 1, third column)."""


@jit
def copy_heading(source: Any, to: Any) -> None:
    """Copy what a heading filter knows of its errors; it then has none in common with Doppler errors of the past."""
    to.angle, to.gyro_bias, to.gyro_scale = source.angle, source.gyro_bias, source.gyro_scale
    to.p_hh, to.p_hb, to.p_hs = source.p_hh, source.p_hb, source.p_hs
    to.p_bb, to.p_bs, to.p_ss = source.p_bb, source.p_bs, source.p_ss
    to.axle_h, to.axle_b, to.axle_s = source.axle_h, source.axle_b, source.axle_s
    to.noise[:, :], to.white[:, :] = 0.0, 0.0


@jit
def predict_heading(delta_theta: float, dt: float, arw: float, bias_walk: float, h: Any) -> None:
    """Advance the heading filter by one gyro increment [rad] less its bias and scale error: ``P' = F P F' + Q``.

    arw is the angle random walk [rad/sqrt(s)], bias_walk the rate random walk of the bias [rad/s/sqrt(s)].
    """
    hb = h.p_hb - dt * h.p_bb - delta_theta * h.p_bs
    hs = h.p_hs - dt * h.p_bs - delta_theta * h.p_ss
    h.p_hh += -dt * (h.p_hb + hb) - delta_theta * (h.p_hs + hs) + arw * arw * dt
    h.p_hb, h.p_hs = hb, hs
    h.p_bb += bias_walk * bias_walk * dt
    h.angle = wrap(h.angle + delta_theta * (1.0 - h.gyro_scale) - h.gyro_bias * dt)
    h.axle_h -= dt * h.axle_b + delta_theta * h.axle_s


@jit
def rest_heading(delta_theta: float, dt: float, arw: float, bias_walk: float, h: Any) -> Any:
    """Learn the gyro bias at rest (ZUPT, S1 figure 1), where it walks as well. Returns the gains of the update."""
    h.p_bb += bias_walk * bias_walk * dt
    return correct(delta_theta / dt - h.gyro_bias, 0.0, 1.0, arw * arw / dt, h)


@jit
def expect_turn(delta_theta: float, dt: float, arw: float, slip_rate: float, h: Any, turn: Any) -> None:
    """Fill ``turn`` (TURN) before :func:`predict_heading`, with gains 0.

    The mean heading of the epoch has the error ``J x + n / 2``, ``J = [1, -dt/2, -D/2]``; its variance is
    ``J P J' + arw^2 dt / 4``, its covariance with the errors at the end ``F P J' + [arw^2 dt / 2, 0, 0]``. slip_rate is
    the error of the side slip by an error of the axle distance [rad/m].
    """
    half_t, half_d, q = 0.5 * dt, 0.5 * delta_theta, arw * arw * dt
    h_j = h.p_hh - half_t * h.p_hb - half_d * h.p_hs
    b_j = h.p_hb - half_t * h.p_bb - half_d * h.p_bs
    s_j = h.p_hs - half_t * h.p_bs - half_d * h.p_ss
    turn.dt, turn.delta, turn.rests = dt, delta_theta, False
    turn.mean_variance = h_j - half_t * b_j - half_d * s_j + 0.25 * q
    turn.joint_h, turn.joint_b, turn.joint_s = h_j - dt * b_j - delta_theta * s_j + 0.5 * q, b_j, s_j
    turn.k_h, turn.k_b, turn.k_s = 0.0, 0.0, 0.0
    turn.axle = slip_rate + h.axle_h - half_t * h.axle_b - half_d * h.axle_s
    for i in range(2):
        turn.course[i], turn.right[i] = 0.0, 0.0
        turn.mean_noise[i] = h.noise[i, 0] - half_t * h.noise[i, 1] - half_d * h.noise[i, 2]


@jit
def correct(innovation: float, h_heading: float, h_bias: float, variance: float, h: Any) -> tuple[float, float, float]:
    """Kalman update with ``innovation = h_heading d_heading + h_bias d_bias + noise`` of this variance; the gains."""
    ph = h_heading * h.p_hh + h_bias * h.p_hb
    pb = h_heading * h.p_hb + h_bias * h.p_bb
    ps = h_heading * h.p_hs + h_bias * h.p_bs
    s = h_heading * ph + h_bias * pb + variance
    kh, kb, ks = ph / s, pb / s, ps / s
    h.p_hh -= kh * ph
    h.p_hb -= kh * pb
    h.p_hs -= kh * ps
    h.p_bb -= kb * pb
    h.p_bs -= kb * ps
    h.p_ss -= ks * ps
    h.angle, h.gyro_bias = wrap(h.angle + kh * innovation), h.gyro_bias + kb * innovation
    h.gyro_scale += ks * innovation
    return kh, kb, ks


@jit
def observe(gains: tuple[float, float, float], rests: bool, axle: float, h: Any, turn: Any) -> None:
    """Apply a correction to what ``turn`` says of the errors, and to the part of them that the axle distance causes.

    ``axle`` is the error of the measurement by an error of the axle distance [rad/m].
    """
    turn.rests, turn.k_h, turn.k_b, turn.k_s = rests, gains[0], gains[1], gains[2]
    seen = turn.joint_b if rests else turn.joint_h
    turn.joint_h -= gains[0] * seen
    turn.joint_b -= gains[1] * seen
    turn.joint_s -= gains[2] * seen
    off = axle - (h.axle_b if rests else h.axle_h)
    h.axle_h += gains[0] * off
    h.axle_b += gains[1] * off
    h.axle_s += gains[2] * off


@jit
def correlate(decay: float, white: float, h: Any, turn: Any) -> None:
    """Advance the covariances of the Doppler errors with x by an epoch, after its correction.

    ``Cov(n', x') = decay Cov(n, x) T' + a k'`` with ``T = (I - k H) F`` and a the part of a unit error in the course
    that calibrates; ``Cov(w', x') = white a k'``.
    """
    for i in range(2):
        a = turn.course[i]
        turn.mean_noise[i] *= decay
        turn.joint_h += turn.k_h * a * turn.mean_noise[i]
        turn.joint_b += turn.k_b * a * turn.mean_noise[i]
        turn.joint_s += turn.k_s * a * turn.mean_noise[i]
        seen = 0.0
        for part in (h.noise[i], h.white[i]):
            if not turn.rests:
                part[0] -= turn.dt * part[1] + turn.delta * part[2]
            seen = part[1] if turn.rests else part[0]
            part[0] -= turn.k_h * seen
            part[1] -= turn.k_b * seen
            part[2] -= turn.k_s * seen
        for j, k in enumerate((turn.k_h, turn.k_b, turn.k_s)):
            turn.before[i, j] = h.noise[i, j] + h.white[i, j] + decay * a * k
            h.noise[i, j] = decay * h.noise[i, j] + a * k
            h.white[i, j] = white * a * k
            turn.now[i, j] = h.noise[i, j] + h.white[i, j]


@jit
def raise_uncertainty(heading: float, bias: float, scale: float, h: Any) -> None:
    """Add independent errors of these standard deviations to the three states; covariances stay valid."""
    h.p_hh += heading * heading
    h.p_bb += bias * bias
    h.p_ss += scale * scale


@jit
def doppler_heading_usable(v_gnss: float, v_ss: float, hdop: float, jump: float, limits: Any) -> bool:
    """S1 table 1, third column, and S2's jump limit, for the speeds of Doppler and odometer [m/s]."""
    return bool(
        abs(v_ss) > limits.min_speed
        and abs(v_gnss - abs(v_ss)) < limits.speed_agreement
        and hdop < limits.max_hdop
        and abs(jump) < limits.max_jump
    )


@jit
def doppler_heading_variance(v_e: float, v_n: float, q_ee: float, q_en: float, q_nn: float) -> float:
    """Variance of atan2(vE, vN) [rad^2]: the cross-track velocity variance over the squared speed."""
    v2 = v_e * v_e + v_n * v_n
    s, c = v_e / math.sqrt(v2), v_n / math.sqrt(v2)
    return (c * c * q_ee - 2.0 * s * c * q_en + s * s * q_nn) / v2
