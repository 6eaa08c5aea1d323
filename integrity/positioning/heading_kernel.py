"""Heading from the gyro, calibrated by Doppler and by standstill (S1 section 2, S2 section 2.2).

A two-state Kalman filter for one vehicle: heading error and gyro bias. Doppler headings carry errors correlated over a
time tau, much longer than one epoch: their variance is multiplied by ``2 tau / dt``, the white noise of equal power at
low frequency, so that repeating them does not feign precision.
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
    "correct",
    "doppler_heading_usable",
    "doppler_heading_variance",
    "predict_heading",
]

HEADING = record(
    angle="azimuth of the heading [rad]",
    gyro_bias="bias of the yaw gyro [rad/s]",
    p_hh="variance of the heading error [rad^2]",
    p_hb="covariance of heading and bias [rad^2/s]",
    p_bb="variance of the bias [rad^2/s^2]",
)
"""State of the heading filter."""

CALIBRATION = record(
    min_speed="least odometer speed [m/s]",
    speed_agreement="largest difference of Doppler and odometer speed [m/s]",
    max_hdop="largest HDOP [-]",
    max_jump="largest difference of the Doppler course and the heading [rad]",
)
"""When Doppler calibrates the heading (S1 table 1, third column)."""


@jit(borrows=True)
def predict_heading(delta_theta: float, dt: float, arw: float, bias_walk: float, h: Any) -> None:
    """Advance the heading filter by one gyro increment [rad] less its bias.

    arw is the angle random walk [rad/sqrt(s)], bias_walk the rate random walk of the bias [rad/s/sqrt(s)].
    """
    h.p_hh += -2.0 * dt * h.p_hb + dt * dt * h.p_bb + arw * arw * dt
    h.p_hb -= dt * h.p_bb
    h.p_bb += bias_walk * bias_walk * dt
    h.angle = wrap(h.angle + delta_theta - h.gyro_bias * dt)


@jit(borrows=True)
def correct(innovation: float, h_heading: float, h_bias: float, variance: float, h: Any) -> None:
    """Kalman update with ``innovation = h_heading d_heading + h_bias d_bias + noise`` of this variance."""
    ph = h_heading * h.p_hh + h_bias * h.p_hb
    pb = h_heading * h.p_hb + h_bias * h.p_bb
    s = h_heading * ph + h_bias * pb + variance
    kh, kb = ph / s, pb / s
    h.p_hh -= kh * ph
    h.p_hb -= kh * pb
    h.p_bb -= kb * pb
    h.angle, h.gyro_bias = wrap(h.angle + kh * innovation), h.gyro_bias + kb * innovation


@jit(borrows=True)
def doppler_heading_usable(v_gnss: float, v_ss: float, hdop: float, jump: float, limits: Any) -> bool:
    """S1 table 1, third column, and S2's jump limit, for the speeds of Doppler and odometer [m/s]."""
    return bool(
        abs(v_ss) > limits.min_speed
        and abs(v_gnss - abs(v_ss)) < limits.speed_agreement
        and hdop < limits.max_hdop
        and abs(jump) < limits.max_jump
    )


@jit(borrows=True)
def doppler_heading_variance(v_e: float, v_n: float, q_ee: float, q_en: float, q_nn: float) -> float:
    """Variance of atan2(vE, vN) [rad^2]: the cross-track velocity variance over the squared speed."""
    v2 = v_e * v_e + v_n * v_n
    s, c = v_e / math.sqrt(v2), v_n / math.sqrt(v2)
    return (c * c * q_ee - 2.0 * s * c * q_en + s * s * q_nn) / v2
