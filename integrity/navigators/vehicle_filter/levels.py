"""Protection levels from the covariance of a filter, and S4's horizontal trust level.

Exact: ``PL_q = Qinv(P_HMI,q / 2) sigma_q + B_q``, with the standard deviation along or across the heading and a bound
``B_q = sum_j |t_q' influence_j| b_j`` of what constant errors b_j have done to the position through all gains. The
variance is that of the filter plus that of the slow errors of satellites through all gains,
``sum_s (t_q' influence_s)^2``. The filter takes the slow error of positions for a Markov process, and so believes that
a position by other satellites brings new errors; where two sets of satellites take turns in a street, they bring the
same two errors again and again, and the filter averages what does not average. The sum of both counts slow errors
twice, on the safe side.

Published: the horizontal trust level ``HTL = 6 sqrt(lambda_max(P_xy))`` on both axes, at whatever risk (S4 section
II-F). S4 takes it for the circle that holds all but 1e-7. Six sigma on the longer axis of a normal law in the plane
hold all but exp(-18) = 1.5e-8 if the covariance is right.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.frames import track_from_enu_matrix
from lanebound.integrity.monitoring.risk import RiskConfig, Variant, upper_quantile
from lanebound.integrity.monitoring.sbas import semi_major_m
from lanebound.integrity.navigators.navigator import PlCase

__all__ = ["HTL_SIGMAS", "covariance_levels", "horizontal_trust_level", "with_slow_errors"]

Array = NDArray[np.float64]
HTL_SIGMAS = 6.0  # S4 section II-F


def horizontal_trust_level(covariance_m2: Array) -> Array:
    """``6 sqrt(lambda_max)`` of covariances (..., 2, 2), (...,) [m]."""
    p = covariance_m2
    return np.asarray(HTL_SIGMAS * semi_major_m(p[..., 0, 0], p[..., 1, 1], p[..., 0, 1]))


def covariance_levels(
    cases: Sequence[PlCase],
    risk: RiskConfig,
    covariance_m2: Array,
    influence: Array,
    bounds: Array,
    heading_rad: Array,
    trust_m: Array,
) -> tuple[Array, Array]:
    """Levels (B, R, 2) along and across the heading, and the standard deviations (B, 2).

    covariance_m2 (B, 2, 2) E, N; influence (B, 2, J) of constant errors with bounds (J,); heading_rad (B,); trust_m
    (B,) for published cases.
    """
    r = track_from_enu_matrix(heading_rad)
    variance = np.diagonal(r @ covariance_m2 @ np.swapaxes(r, -1, -2), axis1=-2, axis2=-1)
    sigma = np.sqrt(np.maximum(variance, 0.0))
    bias = np.abs(r @ influence) @ bounds
    budgets = risk.axis_budgets([case.integrity_risk for case in cases], risk.unmonitored_risk)
    exact = upper_quantile(0.5 * budgets) * sigma[:, None, :] + bias[:, None, :]
    trust = np.broadcast_to(trust_m[:, None, None], exact.shape)
    published = np.array([case.variant is Variant.PUBLISHED for case in cases])
    return np.where(published[None, :, None], trust, exact), sigma


def with_slow_errors(covariance_m2: Array, slow_m: Array) -> Array:
    """Covariance (B, 2, 2) of the filter with that of slow errors, of which each moves the position by slow_m (B, 2, J)
    per sigma."""
    return covariance_m2 + slow_m @ np.swapaxes(slow_m, -1, -2)
