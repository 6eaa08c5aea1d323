"""Interacting multiple models in NumPy, for any batch: the reference of ``mixing_kernel``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.positioning.filters.vehicle_models import Interaction

__all__ = ["combine", "interact", "mixing_weights", "posterior", "predicted_probabilities"]

Array = NDArray[np.float64]

LEAST = 1e-12  # probability below which no model falls, so that it can return


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
