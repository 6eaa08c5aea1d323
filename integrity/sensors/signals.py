"""What a satellite's signal looks like at the antenna: C/N0, noise, multipath, atmosphere. NumPy reference forms.

The urban law
-------------
Given the C/N0 ``c``, the code error is ``X = mu + sigma u1 + W``: a Gaussian core, and with probability ``p(c)`` an excess delay
``W >= 0`` that is Weibull with scale ``L(c)`` and shape ``k(c)``::

    p = 1 / (1 + exp((c - c0) / w)),   L = L35 exp(-(c - 35) / l),   k = k35 exp(-(c - 35) g)

In time, ``u1`` and a second ``u2`` are AR(1) normal processes, and ``W = F_c^-1(Phi(u2))`` with ``F_c`` the law of W (its atom
at 0 included): a Gaussian copula. The marginal given c is exact at every epoch, an excess lasts and is one-sided.

Source and fit: 15,780 observations of a single-frequency u-blox at Potsdamer Platz, Berlin (smartLoc data as packed in
TUC-ProAut/libRSF, CC BY-SA 4.0), errors against ground truth in six bins of C/N0. The eight constants minimise the
soft-L1 distance of median, robust sigma (1.4826 MAD), p5, p95, p99 and share above 15 m in all bins, each scaled by its
tolerance (25 % or 1 m, 1 %), with C/N0 uniform within a bin, 45-54 dB-Hz in the highest and 15-25 in the lowest.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from scipy.special import ndtr

from lanebound.integrity.config import Config
from lanebound.integrity.sky.visibility import Path

__all__ = [
    "ErrorLaw",
    "SignalLevels",
    "ar1",
    "atmosphere_sigma_m",
    "cn0_mean_dbhz",
    "elevation_sigma",
    "multipath_envelope_m",
    "urban_error_m",
    "urban_excess_m",
]

Array = NDArray[np.float64]


class SignalLevels(Config):
    """Carrier-to-noise density by elevation and path."""

    zenith_dbhz: float = Field(48.0, ge=30, le=60, description="C/N0 at the zenith; patch antenna, 44-50 in the open")
    horizon_drop_db: float = Field(9.0, ge=0, description="drop to the horizon, times 1 - sin(el); antenna pattern [dB]")
    foliage_loss_db: float = Field(7.0, ge=0, description="mean loss of a tree; roadside L-band fades of 6-10 dB [dB]")
    reflection_loss_db: float = Field(
        12.4, ge=0, description="mean loss of a reflected signal; Berlin, LOS 43.8 against NLOS 31.4 dB-Hz [dB]"
    )
    los_sigma_db: float = Field(2.0, ge=0, description="1-sigma of fading in line of sight [dB]")
    nlos_sigma_db: float = Field(4.5, ge=0, description="1-sigma of fading under reflection or foliage [dB]")
    fading_tau_s: float = Field(2.0, gt=0, description="correlation time of fading [s]; metres of driving")


class ErrorLaw(Config):
    """Code errors: the urban law, and multipath in line of sight. ``grade`` scales all of it."""

    grade: float = Field(
        1.0, ge=0, description="receiver's factor on core and statistical excess; single-frequency u-blox = 1 [-]"
    )
    source: Literal["geometry", "statistics"] = Field(
        "geometry", description="excess delays from the city's geometry, or from the urban law alone"
    )
    core_m: float = Field(3.25, ge=0, description="sigma of the core; fit to the Berlin table [m]")
    core_mean_m: float = Field(-0.11, description="mu of the core; fit [m]")
    middle_dbhz: float = Field(40.06, description="c0, where half the signals have an excess; fit")
    width_db: float = Field(2.66, gt=0, description="w; fit [dB]")
    scale_35_m: float = Field(40.0, gt=0, description="L35; fit [m]")
    scale_decay_per_db: float = Field(0.0567, description="1/l; fit [1/dB]")
    shape_35: float = Field(1.332, gt=0, description="k35; fit [-]")
    shape_decay_per_db: float = Field(0.0433, description="g; fit [1/dB]")
    tau_s: float = Field(3.0, gt=0, description="correlation time at rest [s]; reflections change with the satellites")
    tau_distance_m: float = Field(
        10.0, gt=0, description="correlation length of driving [m]: the rate adds v over it; a facade's width"
    )
    mitigation: float = Field(
        1.0, ge=0, description="share of a geometric NLOS delay that stays in the code; 1 = all of it [-]"
    )
    multipath_ratio: float = Field(0.3, ge=0, le=1, description="reflected over direct amplitude in line of sight [-]")
    multipath_limit_m: float = Field(
        9.0, ge=0, description="largest multipath error: ratio x half the correlator spacing; 0.2 chip = 59 m [m]"
    )


def ar1(previous: ArrayLike, decay: ArrayLike, z: ArrayLike) -> Array:
    """``x' = a x + sqrt(1 - a^2) z``: stationary, unit variance.  (...,) each -> (...,)."""
    a = np.asarray(decay, dtype=np.float64)
    return np.asarray(a * np.asarray(previous) + np.sqrt(1.0 - a * a) * np.asarray(z))


def cn0_mean_dbhz(levels: SignalLevels, elevation_rad: ArrayLike, path: ArrayLike) -> Array:
    """``c = zenith - drop (1 - sin el) - loss[path]``.  (...,) and (...,) -> (...,) [dB-Hz]; 0 where blocked."""
    loss = np.array([0.0, levels.foliage_loss_db, levels.reflection_loss_db, 0.0])
    which = np.asarray(path, dtype=np.int64)
    c = levels.zenith_dbhz - levels.horizon_drop_db * (1.0 - np.sin(elevation_rad)) - loss[which]
    return np.where(which == Path.BLOCKED, 0.0, c)


def elevation_sigma(a: float, elevation_rad: ArrayLike) -> Array:
    """``sqrt(a^2 + (a / sin el)^2)``, RTKLIB's form, undifferenced.  (...,) -> (...,) in the unit of a."""
    s = np.maximum(np.sin(elevation_rad), 0.05)
    return np.asarray(a * np.sqrt(1.0 + 1.0 / (s * s)))


def multipath_envelope_m(law: ErrorLaw, excess_m: ArrayLike) -> Array:
    """Largest code error that a reflection late by ``excess_m`` makes in line of sight: ``min(alpha d, limit)`` [m]."""
    return np.minimum(law.multipath_ratio * np.asarray(excess_m, dtype=np.float64), law.multipath_limit_m)


def urban_excess_m(law: ErrorLaw, cn0_dbhz: ArrayLike, u2: ArrayLike, certain: bool = False) -> Array:
    """``W = F_c^-1(Phi(u2))`` of the urban law.

    Parameters
    ----------
    cn0_dbhz, u2 : (...,) C/N0 and standard normal
    certain : bool
        The signal is known to be NLOS: an excess for sure, p = 1.

    Returns
    -------
    (...,) excess delay [m], 0 where there is none.
    """
    c = np.asarray(cn0_dbhz, dtype=np.float64)
    p = np.ones_like(c) if certain else 1.0 / (1.0 + np.exp((c - law.middle_dbhz) / law.width_db))
    upper = ndtr(-np.asarray(u2)) / p
    scale = law.scale_35_m * np.exp(-law.scale_decay_per_db * (c - 35.0))
    shape = law.shape_35 * np.exp(-law.shape_decay_per_db * (c - 35.0))
    return np.where(upper < 1.0, scale * (-np.log(np.minimum(upper, 1.0))) ** (1.0 / shape), 0.0)


def urban_error_m(law: ErrorLaw, cn0_dbhz: ArrayLike, u1: ArrayLike, u2: ArrayLike) -> Array:
    """Code error of the urban law given C/N0: core plus excess, times the grade.  (...,) each -> (...,) [m]."""
    return np.asarray(law.grade * (law.core_mean_m + law.core_m * np.asarray(u1) + urban_excess_m(law, cn0_dbhz, u2)))


def atmosphere_sigma_m(ppm: float, baseline_km: float, elevation_rad: ArrayLike) -> Array:
    """1-sigma of a differential delay: ``ppm mm/km x baseline / sin el``.  (...,) -> (...,) [m]."""
    return np.asarray(1e-3 * ppm * baseline_km / np.maximum(np.sin(elevation_rad), 0.1))
