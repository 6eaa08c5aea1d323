"""Heading from the gyro, calibrated by Doppler and by standstill (S1 section 2, S2 section 2.2).

A two-state Kalman filter for one vehicle: heading error and gyro bias, with covariance ``p`` = [p_hh, p_hb, p_bb].
Doppler headings carry errors correlated over a time tau, much longer than one epoch: their variance is multiplied by
``2 tau / dt``, the white noise of equal power at low frequency, so that repeating them does not feign precision.
"""

from __future__ import annotations

import math

from lanebound.integrity.core.accel import jit

HH, HB, BB = 0, 1, 2


@jit
def wrap(angle):  # type: ignore[no-untyped-def]
    """Wrap to [-pi, pi); rounding can give pi itself."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@jit
def predict_heading(heading, bias, p, delta_theta, dt, arw, bias_walk):  # type: ignore[no-untyped-def]
    """Advance heading [rad] by one gyro increment less its bias; grow ``p`` in place. Returns the new heading.

    arw is the angle random walk [rad/sqrt(s)], bias_walk the rate random walk of the bias [rad/s/sqrt(s)].
    """
    p[HH] += -2.0 * dt * p[HB] + dt * dt * p[BB] + arw * arw * dt
    p[HB] -= dt * p[BB]
    p[BB] += bias_walk * bias_walk * dt
    return wrap(heading + delta_theta - bias * dt)


@jit
def correct(heading, bias, p, innovation, h_heading, h_bias, variance):  # type: ignore[no-untyped-def]
    """Kalman update with ``innovation = h_heading d_heading + h_bias d_bias + noise``; returns heading and bias."""
    ph = h_heading * p[HH] + h_bias * p[HB]
    pb = h_heading * p[HB] + h_bias * p[BB]
    s = h_heading * ph + h_bias * pb + variance
    kh, kb = ph / s, pb / s
    p[HH] -= kh * ph
    p[HB] -= kh * pb
    p[BB] -= kb * pb
    return wrap(heading + kh * innovation), bias + kb * innovation


@jit
def doppler_heading_usable(v_gnss, v_ss, hdop, jump, limits):  # type: ignore[no-untyped-def]
    """S1 table 1, third column, and S2's jump limit.

    limits: minimum odometer speed [m/s], speed agreement [m/s], HDOP, heading jump [rad].
    """
    return abs(v_ss) > limits[0] and abs(v_gnss - abs(v_ss)) < limits[1] and hdop < limits[2] and abs(jump) < limits[3]


@jit
def doppler_heading_variance(v_e, v_n, q_ee, q_en, q_nn):  # type: ignore[no-untyped-def]
    """Variance of atan2(vE, vN) [rad^2]: the cross-track velocity variance over the squared speed."""
    v2 = v_e * v_e + v_n * v_n
    s, c = v_e / math.sqrt(v2), v_n / math.sqrt(v2)
    return (c * c * q_ee - 2.0 * s * c * q_en + s * s * q_nn) / v2
