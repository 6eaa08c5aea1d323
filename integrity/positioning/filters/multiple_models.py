"""Interacting multiple models: one filter for each model, mixed by the probabilities of the models (S4 section II-G).

Axes: states (..., r, n), covariances (..., r, n, n), probabilities (..., r) of r models; the transition matrix (r, r)
has the model before in its rows and the model after in its columns (S4 eq 9).

S4's text says how the predictions are combined (with the probabilities after interaction), and neither from which state
each filter predicts nor how the output is formed. Both readings are here:

- standard (default): each filter begins with its own mixture ``mu_i|j = P_ij mu_i / C_j`` of states and covariances,
  and the output is the mixture of the corrected filters (Blom and Bar-Shalom 1988);
- published: each filter begins with the one state and covariance of the output before, so that the models differ in
  their prediction alone. This is a generalised pseudo-Bayesian filter of first order, with S4's ``C_j``.
"""

from __future__ import annotations

from enum import Enum

import numpy as np
from numpy.typing import NDArray

__all__ = ["TRANSITION", "Interaction", "combine", "interact", "mixing_weights", "posterior", "predicted_probabilities"]

Array = NDArray[np.float64]

TRANSITION = ((0.7, 0.3), (0.4, 0.6))
"""S4 eq 9: from straight and from curved, to straight and to curved, at each scan [-]."""
LEAST = 1e-12  # probability below which no model falls, so that it can return


class Interaction(Enum):
    """How the filters of the models begin a scan."""

    STANDARD = "standard"
    PUBLISHED = "published"


def predicted_probabilities(probability: Array, transition: Array) -> Array:
    """``C_j = sum_i P_ij mu_i``.  (..., r) -> (..., r)."""
    return np.asarray((probability[..., None, :] @ transition)[..., 0, :])


def mixing_weights(probability: Array, transition: Array, form: Interaction = Interaction.STANDARD) -> Array:
    """Weight of model i in the start of model j, (..., r, r), first axis i; each column sums to 1."""
    if form is Interaction.PUBLISHED:
        return np.asarray(np.repeat(probability[..., :, None], transition.shape[0], axis=-1))
    joint = transition * probability[..., :, None]
    return np.asarray(joint / joint.sum(-2, keepdims=True))


def interact(x: Array, p: Array, weight: Array) -> tuple[Array, Array]:
    """The state and covariance that each model begins with, by mixing weights (..., r, r)."""
    by = np.swapaxes(weight, -1, -2)  # model after, model before
    mean = by @ x
    apart = x[..., None, :, :] - mean[..., :, None, :]  # after, before, state
    spread = np.swapaxes(by[..., None] * apart, -1, -2) @ apart
    n = x.shape[-1]
    flat = by @ p.reshape(*p.shape[:-2], n * n)
    return mean, np.asarray(flat.reshape(*mean.shape, n) + spread)


def posterior(predicted: Array, log_likelihood: Array) -> Array:
    """``mu_j = Lambda_j C_j / C``.  (..., r) each -> (..., r)."""
    scaled = np.exp(log_likelihood - log_likelihood.max(-1, keepdims=True)) * predicted
    found = np.maximum(scaled / scaled.sum(-1, keepdims=True), LEAST)
    return np.asarray(found / found.sum(-1, keepdims=True))


def combine(x: Array, p: Array, weight: Array) -> tuple[Array, Array]:
    """The moments of the mixture with weights (..., r): state (..., n) and covariance (..., n, n)."""
    mean = weight[..., None, :] @ x
    apart, n = x - mean, x.shape[-1]
    spread = np.swapaxes(weight[..., None] * apart, -1, -2) @ apart
    flat = weight[..., None, :] @ p.reshape(*p.shape[:-2], n * n)
    return mean[..., 0, :], np.asarray(flat.reshape(*p.shape[:-3], n, n) + spread)
