"""Interacting multiple models of one vehicle: mixed by the probabilities of the models (S4 section II-G).

``models`` (r,) of MODEL, probabilities (r,); the transition matrix (r, r) has the model before in its rows and the
model after in its columns (S4 eq 9).

S4's text says how the predictions are combined (with the probabilities after interaction), and neither from which state
each filter predicts nor how the output is formed. Both readings are here:

- standard (default): each filter begins with its own mixture ``mu_i|j = P_ij mu_i / C_j`` of states and covariances,
  and the output is the mixture of the corrected filters (Blom and Bar-Shalom 1988);
- published: each filter begins with the one state and covariance of the output before, so that the models differ in
  their prediction alone. This is a generalised pseudo-Bayesian filter of first order, with S4's ``C_j``.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records

__all__ = ["combine", "mixing_weights", "posterior"]

Array = NDArray[np.float64]
LEAST = 1e-12  # probability below which no model falls, so that it can return


@jit
def mixing_weights(models: Records, probability: Array, transition: Array, standard: bool) -> None:
    """``predicted``, ``C_j = sum_i P_ij mu_i``, and the weights of all models in the start of model j.

    A model that none leads to has no weights of its own: it begins with the output of the epoch before.
    """
    r = probability.shape[0]
    for j in range(r):
        model = models[j]
        model.predicted = 0.0
        for i in range(r):
            model.weight[i] = transition[i, j] * probability[i]
            model.predicted += model.weight[i]
        for i in range(r):
            own = standard and model.predicted > 0.0
            model.weight[i] = model.weight[i] / model.predicted if own else probability[i]


@jit
def combine(models: Records, weight: Array, size: int, out: Any) -> None:
    """The moments of the mixture with weights (r,): the first ``size`` states, and their covariance."""
    x, p = out.x, out.p
    for k in range(size):
        total = 0.0
        for i in range(models.shape[0]):
            total += weight[i] * models[i].x[k]
        x[k] = total
    for k in range(size):
        for m in range(k + 1):
            total = 0.0
            for i in range(models.shape[0]):
                model = models[i]
                total += weight[i] * (model.p[k, m] + (model.x[k] - x[k]) * (model.x[m] - x[m]))
            p[k, m] = p[m, k] = total


@jit
def posterior(models: Records, probability: Array) -> None:
    """``mu_j = Lambda_j C_j / C`` into probability (r,)."""
    r, most, total = probability.shape[0], -math.inf, 0.0
    for j in range(r):
        most = max(most, models[j].likelihood)
    for j in range(r):
        probability[j] = math.exp(models[j].likelihood - most) * models[j].predicted
        total += probability[j]
    left = 0.0
    for j in range(r):
        probability[j] = max(probability[j] / total, LEAST)
        left += probability[j]
    for j in range(r):
        probability[j] /= left
