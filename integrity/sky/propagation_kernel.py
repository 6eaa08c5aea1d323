"""Reflection and diffraction of a satellite signal: directions, extra path, and how much of the amplitude is left.

Letters: ``e`` unit vector from the antenna to the satellite, ``n`` outward unit normal of a face, ``d`` distance of the
antenna in front of the face [m], ``x`` antenna [m] and ``v`` its velocity [m/s], ``theta`` angle of incidence from the
normal, ``eps`` complex relative permittivity of the material.
"""

from __future__ import annotations

import math

from lanebound.integrity.core.accel import jit

__all__ = [
    "antenna_amplitude",
    "arrival_direction",
    "diffraction_loss_db",
    "edge_detour",
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
def edge_detour(e, t, p, x, v):  # type: ignore[no-untyped-def]
    """The ray over a straight edge, line ``p + s t``: (angle by which the direct ray lies below it, L, dL/dt).

    The ray leaves the edge on Keller's cone about it, at the angle at which it came: ``cos b = e.t``. By Fermat's
    principle the point of diffraction moves along the edge with the antenna. With w from the edge square to the antenna
    and r its length: ``L = r sin b + e.w``, which is ``r sin b (1 - cos angle)``, and ``dL/dt = (sin b w / r + e).v``
    without what v has along the edge. The angle [rad] is that between the direct ray and the edge, seen along the edge,
    negative where the direct ray passes above. For an edge parallel to the way L is constant.
    """
    along = (x[0] - p[0]) * t[0] + (x[1] - p[1]) * t[1] + (x[2] - p[2]) * t[2]
    w = x[0] - p[0] - along * t[0], x[1] - p[1] - along * t[1], x[2] - p[2] - along * t[2]
    cone = e[0] * t[0] + e[1] * t[1] + e[2] * t[2]
    f = e[0] - cone * t[0], e[1] - cone * t[1], e[2] - cone * t[2]
    r = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    sine = math.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])
    scalar = f[0] * w[0] + f[1] * w[1] + f[2] * w[2]
    up = t[0] * w[1] - t[1] * w[0]  # t x w, square to both, its height
    side = (t[1] * w[2] - t[2] * w[1]) * f[0] + (t[2] * w[0] - t[0] * w[2]) * f[1] + up * f[2]
    rate, slope = 0.0, sine / max(r, 1e-9)
    for k in range(3):
        rate += (slope * w[k] + f[k]) * v[k]
    return math.atan2(side if up < 0.0 else -side, -scalar), max(r * sine + scalar, 0.0), rate


@jit
def fresnel_parameter(excess, wavelength):  # type: ignore[no-untyped-def]
    """Fresnel-Kirchhoff parameter of a detour over an edge [m], ``2 sqrt(L / lambda)`` (ITU-R P.526, eq 26 to 29)."""
    return 2.0 * math.sqrt(excess / wavelength)


@jit
def diffraction_loss_db(v):  # type: ignore[no-untyped-def]
    """Knife-edge loss ``J(v) = 6.9 + 20 log10(sqrt((v - 0.1)^2 + 1) + v - 0.1)`` [dB] (ITU-R P.526, eq 31)."""
    if v <= LEAST_LOSS_V:
        return 0.0
    x = v - 0.1
    return max(6.9 + 20.0 * math.log10(math.sqrt(x * x + 1.0) + x), 0.0)
