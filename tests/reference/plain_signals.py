"""Error models of satellite signals at the antenna: the reference of the models in ``sensors/gnss_kernel.py``.

Urban code errors
-----------------
Given the C/N0 ``c`` and ``d = c - 35 dB-Hz``, the code error is ``X = mu + sigma u1 + W``: a Gaussian core, and with
probability ``p(c)`` an excess delay ``W >= 0``, Weibull with scale ``L(c)`` and shape ``k(c)``::

    p = 1 / (1 + exp((c - c0) / w)),  L = exp(l0 - l1 d + l2 min(d, 0)^2),  k = exp(k0 - k1 d)

In time, ``u1`` and ``u2`` are AR(1) normal processes, and ``W = F_c^-1(Phi(u2))`` with the distribution ``F_c`` of W,
including its atom at 0 (Gaussian copula). The marginal distribution given c is exact at every epoch; the excess is
correlated in time and one-sided.

Source and fit: 15,780 pseudoranges of a single-frequency u-blox at Potsdamer Platz, Berlin (smartLoc data as packed in
TUC-ProAut/libRSF, CC BY-SA 4.0), errors against ground truth in six bins of C/N0. The constants, which are in the
kernel file, minimise the soft-L1 distance of median, robust sigma (1.4826 MAD), p5, p95, p99 and share above 15 m in
all bins, each scaled by its tolerance (25 % or 1 m; 1 %), with C/N0 uniform within a bin, 45-54 dB-Hz in the highest.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from lanebound.integrity.sensors import gnss_kernel as gk

__all__ = [
    "ar1",
    "atmosphere_sigma_m",
    "elevation_scale",
    "urban_error_m",
    "urban_excess_m",
    "urban_share",
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


def urban_share(cn0_dbhz: ArrayLike) -> Array:
    """Probability p(c) of an excess delay in the code.  (...,) [dB-Hz] -> (...,)."""
    return np.asarray(1.0 / (1.0 + np.exp((np.asarray(cn0_dbhz) - gk.URBAN_P_CENTRE) / gk.URBAN_P_SCALE)))


def urban_excess_m(cn0_dbhz: ArrayLike, u2: ArrayLike) -> Array:
    """Excess delay of the urban model, ``W = F_c^-1(Phi(u2))``, 0 for none.  (...,) each -> (...,) [m]."""
    d = np.asarray(cn0_dbhz, dtype=np.float64) - 35.0
    upper = ndtr(-np.asarray(u2, dtype=np.float64)) / urban_share(cn0_dbhz)
    scale = np.exp(gk.URBAN_SIZE - gk.URBAN_SIZE_SLOPE * d + gk.URBAN_SIZE_CURVE * np.minimum(d, 0.0) ** 2)
    shape = np.exp(gk.URBAN_SHAPE - gk.URBAN_SHAPE_SLOPE * d)
    return np.asarray(scale * (-np.log(np.clip(upper, 1e-12, 1.0))) ** (1.0 / shape))


def urban_error_m(cn0_dbhz: ArrayLike, u1: ArrayLike, u2: ArrayLike) -> Array:
    """Code error of a consumer receiver in a city: core plus excess.  (...,) each -> (...,) [m]."""
    return np.asarray(gk.URBAN_OFFSET_M + gk.URBAN_CORE_M * np.asarray(u1) + urban_excess_m(cn0_dbhz, u2))


def atmosphere_sigma_m(ppm: float, baseline_km: float, elevation_rad: ArrayLike) -> Array:
    """1-sigma of a delay proportional to the baseline: ``ppm mm/km x baseline / sin el``.  (...,) -> (...,) [m]."""
    return np.asarray(1e-3 * ppm * baseline_km / np.sin(elevation_rad))
