"""How position error grows between RTK positions: covariance and bias bound, one vehicle, one epoch at a time.

The state ``p`` (NP,) is flat. Covariance: position (E, N) and its correlations with the error processes that drive it: the
Doppler velocity (Gauss-Markov), the odometer's speed (Gauss-Markov), heading and gyro bias (of the heading filter). Bias:
signed accumulated vectors ``c_th += v dt b_theta [cos t, -sin t]`` and ``c_v += dt b_v [sin t, cos t]`` (S1 eq 18-19 made exact,
equations.md 6), bounds on E and N of the Doppler velocity's bias, and a bound of the horizontal shift at the last reset.
Doppler and odometer carry over into each other; only RTK resets (the sawtooth of S1 section 3.2).
"""

from __future__ import annotations

import math

from lanebound.integrity.accel import jit

(
    C_EE, C_EN, C_NN, D_EE, D_EN, D_NE, D_NN, O_E, O_N, H_E, H_N, G_E, G_N,
    TH_E, TH_N, V_E, V_N, DB_E, DB_N, B0,
) = range(20)  # fmt: skip
NP = 20


@jit
def reset(p, q_ee, q_en, q_nn, bias):  # type: ignore[no-untyped-def]
    """Start anew from an absolute position with covariance [m^2] and a bound of its horizontal bias [m]."""
    p[:] = 0.0
    p[C_EE], p[C_EN], p[C_NN] = q_ee, q_en, q_nn
    p[B0] = bias


@jit
def forget(p, dt, tau_doppler, tau_odometer):  # type: ignore[no-untyped-def]
    """Let the correlations with velocity errors fade over one epoch in which the position does not use them."""
    phi_d, phi_o = math.exp(-dt / tau_doppler), math.exp(-dt / tau_odometer)
    for k in range(D_EE, D_NN + 1):
        p[k] *= phi_d
    p[O_E] *= phi_o
    p[O_N] *= phi_o


@jit
def grow_doppler(p, dt, q_ee, q_en, q_nn, tau, bias):  # type: ignore[no-untyped-def]
    """One epoch of Doppler positioning by the trapezoid of S1 eq 20 with a Gauss-Markov velocity error.

    With ``phi = exp(-dt/tau)`` and velocity covariance V: ``C += dt (1 + phi)/2 (D + D') + dt^2 (1 + phi)/2 V``,
    ``D = phi D + dt (1 + phi)/2 V``; D is the covariance of position and velocity error. ``bias`` [m/s] bounds a constant
    velocity error on E and on N.
    """
    phi = math.exp(-dt / tau)
    a = 0.5 * dt * (1.0 + phi)
    p[C_EE] += 2.0 * a * p[D_EE] + dt * a * q_ee
    p[C_EN] += a * (p[D_EN] + p[D_NE]) + dt * a * q_en
    p[C_NN] += 2.0 * a * p[D_NN] + dt * a * q_nn
    p[D_EE] = phi * p[D_EE] + a * q_ee
    p[D_EN] = phi * p[D_EN] + a * q_en
    p[D_NE] = phi * p[D_NE] + a * q_en
    p[D_NN] = phi * p[D_NN] + a * q_nn
    p[DB_E] += dt * bias
    p[DB_N] += dt * bias


@jit
def grow_odometer(p, dt, speed, sin_t, cos_t, odo_variance, tau, p_hh, p_hb, bias_heading, bias_speed):  # type: ignore[no-untyped-def]
    """One epoch of dead reckoning at ``speed`` along the azimuth t: heading error acts across, speed error along.

    p_hh, p_hb are the heading variance and its covariance with the gyro bias; the biases bound heading [rad] and speed [m/s].
    """
    phi = math.exp(-dt / tau)
    a = 0.5 * dt * (1.0 + phi)
    ue, un = sin_t, cos_t
    ne, nn = speed * dt * cos_t, -speed * dt * sin_t
    p[C_EE] += 2.0 * a * ue * p[O_E] + dt * a * odo_variance * ue * ue + 2.0 * ne * p[H_E] + p_hh * ne * ne
    p[C_EN] += a * (ue * p[O_N] + un * p[O_E]) + dt * a * odo_variance * ue * un
    p[C_EN] += ne * p[H_N] + nn * p[H_E] + p_hh * ne * nn
    p[C_NN] += 2.0 * a * un * p[O_N] + dt * a * odo_variance * un * un + 2.0 * nn * p[H_N] + p_hh * nn * nn
    p[O_E] = phi * p[O_E] + a * odo_variance * ue
    p[O_N] = phi * p[O_N] + a * odo_variance * un
    p[H_E] += p_hh * ne
    p[H_N] += p_hh * nn
    p[G_E] += p_hb * ne
    p[G_N] += p_hb * nn
    p[TH_E] += bias_heading * ne
    p[TH_N] += bias_heading * nn
    p[V_E] += dt * bias_speed * ue
    p[V_N] += dt * bias_speed * un


@jit
def turn_heading_error(p, dt):  # type: ignore[no-untyped-def]
    """The heading error moves by minus the gyro bias error over one epoch: so does its covariance with the position."""
    p[H_E] -= dt * p[G_E]
    p[H_N] -= dt * p[G_N]


@jit
def correct_heading_error(p, gain_heading, gain_bias):  # type: ignore[no-untyped-def]
    """A heading calibration of these gains takes part of the heading error away, and its covariance with it."""
    p[G_E] -= gain_bias * p[H_E]
    p[G_N] -= gain_bias * p[H_N]
    p[H_E] *= 1.0 - gain_heading
    p[H_N] *= 1.0 - gain_heading


@jit
def track_sigmas(p, s, c):  # type: ignore[no-untyped-def]
    """Standard deviations along and across the azimuth with sine s and cosine c [m]."""
    at = s * s * p[C_EE] + 2.0 * s * c * p[C_EN] + c * c * p[C_NN]
    ct = c * c * p[C_EE] - 2.0 * s * c * p[C_EN] + s * s * p[C_NN]
    return math.sqrt(max(at, 0.0)), math.sqrt(max(ct, 0.0))


@jit
def track_biases(p, s, c):  # type: ignore[no-untyped-def]
    """Exact bias bounds AT, CT [m]: ``abs(R c_th) + abs(R c_v)`` and the projected bounds of the rest."""
    at = abs(s * p[TH_E] + c * p[TH_N]) + abs(s * p[V_E] + c * p[V_N])
    ct = abs(c * p[TH_E] - s * p[TH_N]) + abs(c * p[V_E] - s * p[V_N])
    at += p[B0] + abs(s) * p[DB_E] + abs(c) * p[DB_N]
    ct += p[B0] + abs(c) * p[DB_E] + abs(s) * p[DB_N]
    return at, ct


@jit
def track_biases_published(p, s, c):  # type: ignore[no-untyped-def]
    """Bias AT, CT as printed in S1 eq 18-19: ``sqrt((sin t B_E)^2 + (cos t B_N)^2)`` and sin and cos exchanged.

    The shift at the reset counts as equal components on E and N.
    """
    shift = p[B0] / math.sqrt(2.0)
    east = abs(p[TH_E] + p[V_E]) + p[DB_E] + shift
    north = abs(p[TH_N] + p[V_N]) + p[DB_N] + shift
    return math.sqrt((s * east) ** 2 + (c * north) ** 2), math.sqrt((c * east) ** 2 + (s * north) ** 2)
