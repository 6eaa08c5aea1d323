"""SBAS protection levels and the error budget behind them (RTCA DO-229D, appendices A and J).

SBAS has no fault modes of its own: the ground segment bounds every error by a normal law, and the level is a factor
times the standard deviation (S3, section on SBAS).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import require_in_range
from lanebound.integrity.positioning.code_solution import semi_major_m
from lanebound.integrity.positioning.least_squares import design_matrix, gain, weights

__all__ = [
    "GIVE_M2",
    "UDRE_M2",
    "Operation",
    "SbasLevels",
    "airborne_sigma_m",
    "ionospheric_obliquity",
    "sbas_levels",
    "semi_major_m",
    "tropospheric_sigma_m",
]

Array = NDArray[np.float64]

UDRE_M2 = np.array(
    [0.052, 0.0924, 0.1444, 0.283, 0.4678, 0.8315, 1.2992, 1.8709, 2.5465, 3.326, 5.1968, 20.787, 230.9661, 2078.695]
)
"""Variance of fast and long-term corrections for UDREI 0 to 13 (DO-229D table A-6); 14 is "not monitored", 15 "do not
use"."""
GIVE_M2 = np.array(
    [0.0084, 0.0333, 0.0749, 0.1331, 0.2079, 0.2994, 0.4075, 0.5322, 0.6735, 0.8315, 1.1974, 1.8709, 3.326, 20.787,
     187.0826]
)  # fmt: skip
"""Variance of the vertical ionospheric delay for GIVEI 0 to 14 (DO-229D table A-17); 15 is "not monitored"."""

EARTH_RADIUS_M = 6_378_136.3  # DO-229D A.4.4.10.1
IONOSPHERE_HEIGHT_M = 350_000.0  # the same
RECEIVER_NOISE_M = 0.36  # airborne accuracy designator A, DO-229D J.2.4


class Operation(Enum):
    """Phase of flight: the factors K_H and K_V (DO-229D J.1)."""

    EN_ROUTE = (6.18, 5.33)
    PRECISION_APPROACH = (6.0, 5.33)


@dataclass(frozen=True)
class SbasLevels:
    """HPL and VPL, and the deviations that they are made of, (...,) [m]; inf where there is no solution."""

    hpl_m: Array
    vpl_m: Array
    major_m: Array
    up_m: Array


def sbas_levels(
    los_enu: ArrayLike, variance_m2: ArrayLike, operation: Operation = Operation.PRECISION_APPROACH
) -> SbasLevels:
    """``HPL = K_H d_major``, ``VPL = K_V d_U`` of the weighted solution with one clock (DO-229D J.1).

    los_enu (..., m, 3) unit vectors receiver to satellite, variance_m2 (..., m) -> (...,).

    Raises
    ------
    InputError
        Vectors that are not of unit length, variances that are not positive.
    """
    variance = require_in_range("variance_m2", variance_m2, 0.0, np.inf, low_open=True)
    design = design_matrix(los_enu, np.zeros(variance.shape[-1], np.int64), 1)
    found = gain(design, weights(variance[..., None] * np.eye(variance.shape[-1])))
    q = np.where(found.solved[..., None, None], found.cofactor, np.inf)
    with np.errstate(invalid="ignore"):
        major = semi_major_m(q[..., 0, 0], q[..., 1, 1], q[..., 0, 1])
    major, up = np.where(found.solved, major, np.inf), np.sqrt(q[..., 2, 2])
    k_h, k_v = operation.value
    return SbasLevels(k_h * major, k_v * up, major, up)


def _sine(elevation_rad: ArrayLike) -> Array:
    return np.asarray(np.sin(require_in_range("elevation_rad", elevation_rad, 0.0, 0.5 * np.pi)))


def tropospheric_sigma_m(elevation_rad: ArrayLike) -> Array:
    """``0.12 m x 1.001 / sqrt(0.002001 + sin^2 E)`` (DO-229D A.4.2.5), for E of 4 deg and more.  (...,) [m]."""
    return np.asarray(0.12 * 1.001 / np.sqrt(0.002001 + _sine(elevation_rad) ** 2))


def ionospheric_obliquity(elevation_rad: ArrayLike, radius_m: float = EARTH_RADIUS_M) -> Array:
    """``(1 - (R cos E / (R + h))^2)^(-1/2)`` of the shell at 350 km (DO-229D A.4.4.10.4).  (...,) [-]."""
    ratio = radius_m / (radius_m + IONOSPHERE_HEIGHT_M)
    return np.asarray(1.0 / np.sqrt(1.0 - ratio**2 * (1.0 - _sine(elevation_rad) ** 2)))


def airborne_sigma_m(elevation_rad: ArrayLike) -> Array:
    """Receiver noise 0.36 m and multipath ``0.13 + 0.53 exp(-E/10 deg)`` m of designator A (DO-229D J.2.4).  (...,)."""
    elevation = require_in_range("elevation_rad", elevation_rad, 0.0, 0.5 * np.pi)
    return np.asarray(np.hypot(RECEIVER_NOISE_M, 0.13 + 0.53 * np.exp(-np.rad2deg(elevation) / 10.0)))
