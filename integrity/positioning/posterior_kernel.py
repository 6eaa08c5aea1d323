"""Probability that the best integers are wrong, given the float ambiguities.

With normal errors of the declared covariance and no preference for any integers beforehand, the float solution ``a``
gives a vector ``z`` the probability ``exp(-q_z / 2) / sum_u exp(-q_u / 2)``, ``q_z = (a - z)' Q^-1 (a - z)``. Accepting
the best vector only where that of all others together is at most ``L`` is wrong with a probability of at most ``L``:
``P(wrong and accepted) = E[P(wrong | a); accepted] <= L``. Float solutions differ from the true integers by an error
whose law does not depend on them, so that the mean over integers is also the probability for the true ones. Of all
rules with that failure rate this one accepts most (Teunissen 2005, Artificial Satellites 40, 219-227).

The bootstrapped failure rate is known before the measurements; this probability belongs to them. Errors that are
smaller than their usual size show themselves by the distance between the best vector and the others. The largest
distance is that of float ambiguities that are integers: where half of ``min z' Q^-1 z`` is below ``-ln L``, nothing is
accepted.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.positioning.lambda_kernel import SearchScratch

__all__ = ["others_probability"]

Array = NDArray[np.float64]

SKIPPED = 1e-4  # of the limit: branches of less are bounded, not searched
SAME = 1e-9  # a weight within it of the best one is the best vector itself


@jit
def row_sum(variance: float) -> float:
    """``sum_k exp(-k^2 / (2 variance))`` over all integers: the largest sum over a row of them.

    Poisson's formula gives ``sqrt(2 pi variance) (1 + 2 sum_m exp(-2 pi^2 variance m^2))`` for large variances.
    """
    if variance > 1.0:
        return math.sqrt(2.0 * math.pi * variance) * (1.0 + 2.0 * math.exp(-2.0 * math.pi**2 * variance))
    total = 1.0
    for k in range(1, 9):
        total += 2.0 * math.exp(-0.5 * k * k / variance)
    return total


@jit
def others_probability(n: int, limit: float, scale: float, node_limit: int, scratch: SearchScratch) -> float:
    """Bound of the probability that not the best vector but another is right; inf where it is above ``limit``.

    The covariance is that of the last :func:`~.lambda_kernel.integer_least_squares`, multiplied by ``scale``;
    ``scratch`` still holds its decorrelated ambiguities, of which all vectors are summed depth first. Of a branch whose
    first j ambiguities are open, with norm q so far, the sum is at most ``exp(-q / 2) prod_i<j row_sum(D_i)``: branches
    below SKIPPED of the limit enter by that bound. ``node_limit`` nodes at most, otherwise inf.
    """
    U, D, S, z_float = scratch.U, scratch.D, scratch.S, scratch.z_float
    distance, mean, z, step, best = scratch.distance, scratch.mean, scratch.z, scratch.step, scratch.norms[0]
    open_sum, along = np.ones(n + 1), np.empty(n)
    for i in range(n):
        along[i] = row_sum(scale * D[i])
        open_sum[i + 1] = open_sum[i] * along[i]
        S[n - 1, i] = z_float[i]
    k, total, met = n - 1, 0.0, False
    distance[k], mean[k] = 0.0, z_float[k]
    z[k] = np.floor(mean[k] + 0.5)
    step[k] = 1.0 if mean[k] > z[k] else -1.0
    for _ in range(node_limit):
        y = mean[k] - z[k]
        norm = distance[k] + y * y / D[k]
        weight = math.exp(-0.5 * (norm - best) / scale)
        rest = weight * open_sum[k] * (1.0 + along[k])  # of this branch and of those further off on either side
        if rest < SKIPPED * limit:
            total += rest
            if k == n - 1:
                return total if total <= limit else math.inf
            k += 1
        elif k > 0:
            k -= 1
            distance[k] = norm
            for q in range(k + 1):
                S[k, q] = S[k + 1, q] - y * U[q, k + 1]
            mean[k] = S[k, k]
            z[k] = np.floor(mean[k] + 0.5)
            step[k] = 1.0 if mean[k] > z[k] else -1.0
            continue
        elif not met and weight > 1.0 - SAME:
            met = True
        else:
            total += weight
        if total > limit:
            return math.inf
        z[k] += step[k]
        step[k] = -step[k] - (1.0 if step[k] > 0.0 else -1.0)
    return math.inf
