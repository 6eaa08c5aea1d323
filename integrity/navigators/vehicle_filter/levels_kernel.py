"""Protection levels from the covariance of a filter, and S4's horizontal trust level.

Exact: of one model ``PL_q = Qinv(P_HMI,q / 2) sigma_q + B_q``, with the standard deviation along or across the heading
and a bound ``B_q = sum_j |t_q' influence_j| b_j`` of what constant errors b_j have done to the position through all
gains. The law of several models is their mixture, whose tail can be larger than that of a normal law of the same
moments: the level solves ``sum_j mu_j Q((PL_q - |m_j,q - m_q| - B_j,q) / sigma_j,q) = P_HMI,q / 2`` by bisection.
Within it the probabilities mu_j count as right. The variance is that of the filter plus that of the slow errors of
satellites through all gains, ``sum_s (t_q' influence_s)^2``. The filter takes the slow error of positions for a Markov
process, and so believes that a position by other satellites brings new errors; where two sets of satellites take turns
in a street, they bring the same two errors again and again, and the filter averages what does not average. The sum of
both counts slow errors twice, on the safe side.

Published: the horizontal trust level ``HTL = 6 sqrt(lambda_max(P_xy))`` on both axes, at whatever risk (S4 section
II-F). S4 takes it for the circle that holds all but 1e-7. Six sigma on the longer axis of a normal law in the plane
hold all but exp(-18) = 1.5e-8 if the covariance is right.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import record
from lanebound.integrity.navigators.vehicle_filter.records_kernel import BIASES, FilterState

__all__ = ["CASE", "HTL_SIGMAS", "find_levels", "major_axis", "mixture_level", "track_variance"]

Array = NDArray[np.float64]
HTL_SIGMAS = 6.0  # S4 section II-F
BISECTIONS, CLOSE = 60, 1e-12

CASE = record(
    published=("?", "the trust level"),
    budget=("f8", (2,), "half of the risk along and across, that is on one side [-]"),
    factor=("f8", (2,), "its quantile, inf without a budget"),
)
"""A level to report."""


@jit
def major_axis(east: float, north: float, cross: float) -> float:
    """``sqrt(lambda_max)`` of a covariance in the plane."""
    return math.sqrt(0.5 * (east + north) + math.hypot(0.5 * (east - north), cross))


@jit
def track_variance(covariance: Array, e: float, n: float) -> float:
    """``t' P t`` of a covariance (2, 2) along the direction t = (e, n)."""
    variance = e * e * covariance[0, 0] + 2.0 * e * n * covariance[0, 1] + n * n * covariance[1, 1]
    return float(max(variance, 0.0))


@jit
def find_levels(
    cases: Any, bounds: Array, state: FilterState, v: int, mean: Array, heading: float, trust: float, levels: Array
) -> None:
    """Levels (R, 2) along and across the heading of vehicle v; mean (2,) its position, trust the trust level."""
    r = state.models.shape[1]
    far, sigma = np.zeros(r), np.zeros(r)
    for q in range(2):
        e, n = math.sin(heading), math.cos(heading)
        if q == 1:
            e, n = n, -e
        for j in range(r):
            x, influence = state.models[v, j].x, state.influence[v, j]
            variance = track_variance(state.models[v, j].p, e, n)
            for k in range(BIASES, influence.shape[1]):
                variance += (e * influence[0, k] + n * influence[1, k]) ** 2
            sigma[j] = max(math.sqrt(variance), 1e-12)
            far[j] = abs(e * (x[0] - mean[0]) + n * (x[1] - mean[1]))
            for k in range(BIASES):
                far[j] += abs(e * influence[0, k] + n * influence[1, k]) * bounds[k]
        for case in range(cases.shape[0]):
            if cases[case].published:
                levels[case, q] = trust
            else:
                levels[case, q] = mixture_level(
                    state.probability[v], far, sigma, cases[case].budget[q], cases[case].factor[q]
                )


@jit
def mixture_level(probability: Array, far: Array, sigma: Array, budget: float, factor: float) -> float:
    """Root L of ``sum_j mu_j Q((L - far_j) / sigma_j) = budget``, from above; inf without a budget.

    It lies between the smallest and the largest level of a model alone, ``far + factor sigma``.
    """
    if not (budget > 0.0 and factor < math.inf):
        return math.inf
    low, high = math.inf, 0.0
    for j in range(far.shape[0]):
        alone = far[j] + factor * sigma[j]
        low, high = min(low, alone), max(high, alone)
    for _ in range(BISECTIONS):
        if high - low <= CLOSE * high:
            break
        middle, beyond = 0.5 * (low + high), 0.0
        for j in range(far.shape[0]):
            beyond += probability[j] * 0.5 * math.erfc((middle - far[j]) / sigma[j] * math.sqrt(0.5))
        if beyond > budget:
            low = middle
        else:
            high = middle
    return high
