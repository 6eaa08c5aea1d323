"""Error models of satellite signals at the antenna: the reference of the models in ``sensors/gnss_kernel.py``."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "ar1",
    "atmosphere_sigma_m",
    "elevation_scale",
]

Array = NDArray[np.float64]


def ar1(previous: ArrayLike, dt_s: float, tau_s: float, z: ArrayLike) -> Array:
    """Step of a stationary process of unit variance: ``x' = a x + sqrt(1 - a^2) z``, ``a = exp(-dt/tau)``.  (...,)."""
    a = math.exp(-dt_s / tau_s)
    return np.asarray(a * np.asarray(previous) + math.sqrt(1.0 - a * a) * np.asarray(z))


def elevation_scale(elevation_rad: ArrayLike, cn0_dbhz: ArrayLike) -> Array:
    """Ratio of the noise to that of a strong signal at the zenith: RTKLIB's elevation model with a C/N0 term.

    ``sqrt((1 + 1/sin^2 el) / 2 (1 + 10^((35 - c)/10)))``.  (...,) and (...,) -> (...,) [-].
    """
    s = np.sin(elevation_rad)
    power = 1.0 + 10.0 ** ((35.0 - np.asarray(cn0_dbhz)) / 10.0)
    return np.asarray(np.sqrt(0.5 * (1.0 + 1.0 / (s * s)) * power))


def atmosphere_sigma_m(ppm: float, baseline_km: float, elevation_rad: ArrayLike) -> Array:
    """1-sigma of a delay proportional to the baseline: ``ppm mm/km x baseline / sin el``.  (...,) -> (...,) [m]."""
    return np.asarray(1e-3 * ppm * baseline_km / np.sin(elevation_rad))
