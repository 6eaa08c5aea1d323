"""The figures that a filter declares, computed from its configuration without the code of the product: bounds, priors,
factors of lasting errors, thresholds.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from lanebound.integrity.navigators.vehicle_filter.config import FilterConfig
from lanebound.integrity.positioning.filters.code_position import CodeSource
from lanebound.integrity.positioning.filters.vehicle_models import S

__all__ = ["bounds_of", "lasting", "position_factors", "priors_of", "threshold"]

DEG = math.pi / 180.0


def lasting(tau_s: float, step_s: float) -> float:
    """Variance of a long sum of a Gauss-Markov error over that of a white one: ``(1 + phi) / (1 - phi)``."""
    if tau_s == 0.0:
        return 1.0
    phi = math.exp(-step_s / tau_s)
    return (1.0 + phi) / (1.0 - phi)


def position_factors(c: FilterConfig) -> tuple[float, float]:
    """Of a position on the way and at rest."""
    codes = c.position.codes
    errors = codes.errors if codes.source is CodeSource.UNDIFFERENCED else codes.differential_errors
    at_rest = max(errors.rest_tau_s, c.position.fast_tau_s)
    return lasting(c.position.fast_tau_s, c.position.interval_s), lasting(at_rest, c.position.rest_interval_s)


def threshold(share: float, dimension: int) -> float:
    """The NIS that a right vector exceeds with this probability."""
    return float(chi2.isf(share, dimension))


def bounds_of(c: FilterConfig) -> NDArray[np.float64]:
    """Of constant errors: position East, North, course, speed, creep at rest."""
    dead = c.positioning.dead_reckoning
    course, creep = dead.heading_bias_deg * DEG, dead.standstill_speed_mps
    return np.array([c.position.bias_m, c.position.bias_m, course, dead.odometer_bias_mps, creep])


def priors_of(c: FilterConfig) -> dict[S, float]:
    """1-sigma of the states of a vehicle that has just been switched on; the others are 0."""
    heading, motion, scale = c.positioning.heading, c.motion, c.motion.wheel_scale
    found = {S.YAW_RATE: 0.2, S.SPEED: 3.0, S.SLIP: 2.0 * DEG, S.SLIDE: motion.slide_sigma_deg * DEG}
    if "curved" in (c.models if c.filter == "imm" else c.models[:1]):
        found[S.SLIP_RATE] = 0.05
    if c.sensor_errors:
        found[S.GYRO_BIAS], found[S.GYRO_SCALE] = heading.bias_initial_radps, heading.gyro_scale
        found[S.WHEEL_SCALE] = c.positioning.dead_reckoning.odometer_scale / 4.5 if scale is None else scale
        found[S.ACCEL_BIAS], found[S.COMPASS] = motion.accelerometer_bias_mps2, motion.compass_deviation_deg * DEG
    return found
