"""Interacting multiple models of one vehicle: mixed by the probabilities of the models (S4 section II-G).

Axes: states (r, n), covariances (r, n, n), probabilities (r,) of r models; the transition matrix (r, r) has the model
before in its rows and the model after in its columns (S4 eq 9).

S4's text says how the predictions are combined (with the probabilities after interaction), and neither from which state
each filter predicts nor how the output is formed. Both readings are here:

- standard (default): each filter begins with its own mixture ``mu_i|j = P_ij mu_i / C_j`` of states and covariances,
  and the output is the mixture of the corrected filters (Blom and Bar-Shalom 1988);
- published: each filter begins with the one state and covariance of the output before, so that the models differ in
  their prediction alone. This is a generalised pseudo-Bayesian filter of first order, with S4's ``C_j``.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit

__all__ = ["combine", "mix", "mixing_weights", "posterior"]

Array = NDArray[np.float64]
LEAST = 1e-12  # probability below which no model falls, so that it can return


@jit
def mixing_weights(probability: Array, transition: Array, standard: bool, weight: Array, predicted: Array) -> None:
    """``C_j = sum_i P_ij mu_i`` into predicted (r,), and the weight of model i in the start of model j into (r, r).

    A model that none leads to has no weights of its own: it begins with the output of the epoch before.
    """
    r = probability.shape[0]
    for j in range(r):
        predicted[j] = 0.0
        for i in range(r):
            weight[i, j] = transition[i, j] * probability[i]
            predicted[j] += weight[i, j]
        for i in range(r):
            weight[i, j] = weight[i, j] / predicted[j] if standard and predicted[j] > 0.0 else probability[i]


@jit
def mix(x: Array, p: Array, weight: Array, x_out: Array, p_out: Array) -> None:
    """The state and covariance that each model begins with, by weights (r, r)."""
    r, n = x.shape
    for j in range(r):
        combine(x, p, weight[:, j], x_out[j], p_out[j], n)


@jit
def combine(x: Array, p: Array, weight: Array, mean: Array, covariance: Array, size: int) -> None:
    """The moments of the mixture with weights (r,): the first ``size`` states, and their covariance."""
    r = x.shape[0]
    for k in range(size):
        total = 0.0
        for i in range(r):
            total += weight[i] * x[i, k]
        mean[k] = total
    for k in range(size):
        for m in range(k + 1):
            total = 0.0
            for i in range(r):
                total += weight[i] * (p[i, k, m] + (x[i, k] - mean[k]) * (x[i, m] - mean[m]))
            covariance[k, m] = covariance[m, k] = total


@jit
def posterior(predicted: Array, log_likelihood: Array, probability: Array) -> None:
    """``mu_j = Lambda_j C_j / C`` into probability (r,)."""
    r, most, total = predicted.shape[0], -math.inf, 0.0
    for j in range(r):
        most = max(most, log_likelihood[j])
    for j in range(r):
        probability[j] = math.exp(log_likelihood[j] - most) * predicted[j]
        total += probability[j]
    left = 0.0
    for j in range(r):
        probability[j] = max(probability[j] / total, LEAST)
        left += probability[j]
    for j in range(r):
        probability[j] /= left
