"""Levels of vehicle filters in NumPy: the reference of ``levels_kernel``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from lanebound.integrity.core.frames import track_from_enu_matrix
from lanebound.integrity.monitoring.risk import RiskConfig, Variant, upper_quantile
from lanebound.integrity.navigators.navigator import PlCase
from lanebound.integrity.positioning.code_solution import semi_major_m

__all__ = [
    "HTL_SIGMAS",
    "ModelPositions",
    "covariance_levels",
    "horizontal_trust_level",
    "mixture_levels",
    "track_sigma",
    "with_slow_errors",
]

Array = NDArray[np.float64]
HTL_SIGMAS = 6.0  # S4 section II-F
BISECTIONS = 50


def horizontal_trust_level(covariance_m2: Array) -> Array:
    """``6 sqrt(lambda_max)`` of covariances (..., 2, 2), (...,) [m]."""
    p = covariance_m2
    return np.asarray(HTL_SIGMAS * semi_major_m(p[..., 0, 0], p[..., 1, 1], p[..., 0, 1]))


@dataclass(frozen=True)
class ModelPositions:
    """Positions of B vehicles by r models: probability (B, r); away_m (B, r, 2) E, N from the combined position;
    covariance_m2 (B, r, 2, 2); influence (B, r, 2, J) of constant errors with bounds."""

    probability: Array
    away_m: Array
    covariance_m2: Array
    influence: Array


def covariance_levels(
    cases: Sequence[PlCase], risk: RiskConfig, models: ModelPositions, bounds: Array, heading_rad: Array, trust_m: Array
) -> Array:
    """Levels (B, R, 2) along and across the heading.

    bounds (J,) of constant errors; heading_rad (B,); trust_m (B,) for published cases.
    """
    r = track_from_enu_matrix(heading_rad)[:, None]
    sigma = track_sigma(models.covariance_m2, r)
    far = np.abs((r @ models.away_m[..., None])[..., 0]) + np.abs(r @ models.influence) @ bounds
    budgets = risk.axis_budgets([case.integrity_risk for case in cases], risk.unmonitored_risk)
    exact = mixture_levels(models.probability, far, sigma, budgets)
    trust = np.broadcast_to(trust_m[:, None, None], exact.shape)
    published = np.array([case.variant is Variant.PUBLISHED for case in cases])
    return np.where(published[None, :, None], trust, exact)


def track_sigma(covariance_m2: Array, rotation: Array) -> Array:
    """Standard deviations along and across the heading, of covariances (..., 2, 2), (..., 2)."""
    variance = np.diagonal(rotation @ covariance_m2 @ np.swapaxes(rotation, -1, -2), axis1=-2, axis2=-1)
    return np.sqrt(np.maximum(variance, 0.0))


def mixture_levels(probability: Array, far_m: Array, sigma_m: Array, budgets: Array) -> Array:
    """Root L of ``sum_j mu_j Q((L - far_j) / sigma_j) = budget / 2``, from above, (B, R, 2); inf without a budget.

    probability (B, r); far_m, sigma_m (B, r, 2); budgets (R, 2). It lies between the smallest and the largest level of
    a model alone.
    """
    mu, far, sigma = probability[:, None, :, None], far_m[:, None], np.maximum(sigma_m, 1e-12)[:, None]
    alone = far + upper_quantile(0.5 * budgets)[None, :, None] * sigma
    low, high = alone.min(2), alone.max(2)
    if probability.shape[-1] == 1:
        return np.asarray(high)
    there = np.isfinite(high)
    low, high = np.where(there, low, 0.0), np.where(there, high, 0.0)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        beyond = (mu * ndtr((far - middle[:, :, None]) / sigma)).sum(2) > 0.5 * budgets
        low, high = np.where(beyond, middle, low), np.where(beyond, high, middle)
    return np.where(there, high, np.inf)


def with_slow_errors(covariance_m2: Array, slow_m: Array) -> Array:
    """Covariances (..., 2, 2) of the filter with those of slow errors, of which each moves the position by slow_m
    (..., 2, J) per sigma."""
    return covariance_m2 + slow_m @ np.swapaxes(slow_m, -1, -2)
