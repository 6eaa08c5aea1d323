"""Reflection and diffraction of a satellite signal: directions, extra path, and how much of the amplitude is left.

Letters: ``e`` unit vector from the antenna to the satellite, ``n`` outward unit normal of a face, ``d`` distance of the
antenna in front of the face [m], ``v`` velocity of the antenna [m/s], ``theta`` angle of incidence from the normal,
``eps`` complex relative permittivity of the material.
"""

from __future__ import annotations

import math

from lanebound.integrity.core.accel import jit

__all__ = [
    "antenna_amplitude",
    "arrival_direction",
    "diffraction_loss_db",
    "excess_path",
    "excess_rate",
    "fresnel_parameter",
    "permittivity",
    "reflection_coefficients",
]

EPS_0 = 8.8541878128e-12  # vacuum permittivity [F/m]
LEAST_LOSS_V = -0.78  # ITU-R P.526: below, diffraction takes nothing off


@jit
def arrival_direction(e, n):  # type: ignore[no-untyped-def]
    """Direction from which a reflection arrives, ``e' = e - 2 (e.n) n`` (unit vector, towards the face)."""
    twice = 2.0 * (e[0] * n[0] + e[1] * n[1] + e[2] * n[2])
    return e[0] - twice * n[0], e[1] - twice * n[1], e[2] - twice * n[2]


@jit
def excess_path(e, n, d):  # type: ignore[no-untyped-def]
    """Extra path of a reflection [m], ``L = 2 d (e.n)``; at a vertical face ``2 d cos(el) |cos(az - az_n)|`` (S3)."""
    return 2.0 * d * (e[0] * n[0] + e[1] * n[1] + e[2] * n[2])


@jit
def excess_rate(e, n, v):  # type: ignore[no-untyped-def]
    """Rate of the extra path of a moving antenna [m/s]: ``dL/dt = 2 (e.n)(n.v)``.

    The range rate ``-e'.v`` of the reflected signal is that of the direct one, ``-e.v``, plus this rate.
    """
    facing = e[0] * n[0] + e[1] * n[1] + e[2] * n[2]
    return 2.0 * facing * (n[0] * v[0] + n[1] * v[1] + n[2] * v[2])


@jit
def permittivity(relative, conductivity, frequency_hz):  # type: ignore[no-untyped-def]
    """Complex relative permittivity ``eps_r - j sigma / (2 pi f eps_0)`` (ITU-R P.2040, eq 9)."""
    return complex(relative, -conductivity / (2.0 * math.pi * frequency_hz * EPS_0))


@jit
def reflection_coefficients(cos_theta, eps):  # type: ignore[no-untyped-def]
    """Co- and cross-polar reflection coefficients of a circularly polarised wave at a smooth face.

    ``G_s = (cos t - r) / (cos t + r)``, ``G_p = (eps cos t - r) / (eps cos t + r)``, ``r = sqrt(eps - sin^2 t)``
    (ITU-R P.2040, eq 31); co ``(G_s + G_p) / 2``, cross ``(G_s - G_p) / 2``. At normal incidence the handedness is
    reversed altogether (co 0), at grazing incidence it stays (cross 0).
    """
    root = (eps - (1.0 - cos_theta * cos_theta)) ** 0.5
    perpendicular = (cos_theta - root) / (cos_theta + root)
    parallel = (eps * cos_theta - root) / (eps * cos_theta + root)
    return 0.5 * (perpendicular + parallel), 0.5 * (perpendicular - parallel)


@jit
def antenna_amplitude(cos_theta, eps, cross_polar, roughness_m, wavelength):  # type: ignore[no-untyped-def]
    """Complex amplitude of a reflection at a right-handed antenna, over that of the direct signal.

    ``(co + x cross) exp(-8 (pi s cos t / lambda)^2)`` with ``x`` = ``cross_polar``, the antenna's voltage response to
    left-handed signals over that to right-handed ones, and the Rayleigh roughness factor of a face of standard
    deviation ``s`` = ``roughness_m`` (Ament 1953; ITU-R P.1407).
    """
    co, cross = reflection_coefficients(cos_theta, eps)
    rough = math.pi * roughness_m * cos_theta / wavelength
    return (co + cross_polar * cross) * math.exp(-8.0 * rough * rough)


@jit
def fresnel_parameter(angle, distance, wavelength):  # type: ignore[no-untyped-def]
    """Fresnel-Kirchhoff parameter of an edge ``distance`` [m] away that reaches ``angle`` [rad] above the ray.

    ``v = angle sqrt(2 distance / lambda)``: the satellite is so far that the antenna's distance alone counts (ITU-R
    P.526, eq 26 with d2 -> inf and h = angle distance).
    """
    return angle * math.sqrt(2.0 * distance / wavelength)


@jit
def diffraction_loss_db(v):  # type: ignore[no-untyped-def]
    """Knife-edge loss ``J(v) = 6.9 + 20 log10(sqrt((v - 0.1)^2 + 1) + v - 0.1)`` [dB] (ITU-R P.526, eq 31)."""
    if v <= LEAST_LOSS_V:
        return 0.0
    x = v - 0.1
    return max(6.9 + 20.0 * math.log10(math.sqrt(x * x + 1.0) + x), 0.0)
