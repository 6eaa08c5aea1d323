"""Extended and unscented prediction in NumPy, for any batch: the reference of ``prediction_kernel``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from plain_kalman import symmetric
from plain_vehicle_models import (
    MotionInput,
    jacobian,
    noise_gain,
    scan_sigmas,
    transition,
)

from lanebound.integrity.positioning.filters.vehicle_models import S
from lanebound.integrity.positioning.filters.vehicle_states_kernel import STATES

__all__ = ["ProcessNoise", "SigmaWeights", "predict_extended", "predict_unscented", "sigma_points"]

Array = NDArray[np.float64]
JITTER = 1e-16  # makes a singular covariance decomposable; a standard deviation of 1e-8
RELATIVE = 1e-12  # likewise, of the variance of each state


@dataclass(frozen=True)
class ProcessNoise:
    """Noise of r models over a scan.

    curved (r,); sigma (r, 4) 1-sigma of yaw acceleration, acceleration, slip (rate or acceleration) and slide rate;
    errors (..., STATES, STATES) variance that the states of sensor errors gain.
    """

    curved: NDArray[np.bool_]
    sigma: Array
    errors: Array


@dataclass(frozen=True)
class SigmaWeights:
    """Scaling of sigma points; S4 section II-E: alpha 1, kappa 0, beta 2."""

    alpha: float = 1.0
    kappa: float = 0.0
    beta: float = 2.0

    def of(self, length: int) -> tuple[float, Array, Array]:
        """``L + lambda``, and the weights of mean and covariance (2 L + 1,)."""
        scale = self.alpha**2 * (length + self.kappa)
        mean = np.full(2 * length + 1, 0.5 / scale)
        mean[0] = (scale - length) / scale
        covariance = mean.copy()
        covariance[0] += 1.0 - self.alpha**2 + self.beta
        return scale, mean, covariance


def predict_extended(x: Array, p: Array, u: MotionInput, noise: ProcessNoise) -> tuple[Array, Array, Array]:
    """``f(x)``, ``F P F' + G Q G'`` and F.  x (..., r, STATES)."""
    f, g = jacobian(x, u), noise_gain(x, u.dt_s, noise.curved) * scan_sigmas(noise.sigma)[:, None, :]
    grown = f @ p @ np.swapaxes(f, -1, -2) + g @ np.swapaxes(g, -1, -2) + noise.errors
    return transition(x, u), symmetric(grown), f


def sigma_points(x: Array, p: Array, scale: float) -> Array:
    """``x``, ``x + sqrt(scale P)_i``, ``x - sqrt(scale P)_i``.  (..., n) and (..., n, n) -> (..., 2 n + 1, n)."""
    n = x.shape[-1]
    lifted = p + np.eye(n) * (JITTER + RELATIVE * np.diagonal(p, axis1=-2, axis2=-1))[..., None, :]
    root = np.swapaxes(np.linalg.cholesky(scale * lifted), -1, -2)
    middle = x[..., None, :]
    return np.concatenate([middle, middle + root, middle - root], axis=-2)


def predict_unscented(
    x: Array, p: Array, u: MotionInput, noise: ProcessNoise, weights: SigmaWeights | None = None
) -> tuple[Array, Array, Array]:
    """The unscented prediction with the noise as part of the state (S4 section II-E), and F for the bounds of biases.

    The noises of :func:`noise_gain` extend the state. Errors of sensors change linearly, so their noise is added
    afterwards.
    """
    sigma = scan_sigmas(noise.sigma)
    moving = STATES + sigma.shape[-1]
    scale, mean_weight, covariance_weight = (weights or SigmaWeights()).of(moving)
    points = sigma_points(x, p, scale)
    spread = points[..., 1:, :]
    of_noise = np.sqrt(scale) * sigma
    inner = MotionInput(
        u.dt_s, u.turn_rad[..., None], u.acceleration_mps2[..., None], u.accelerated, u.gnss_decay, u.compass_decay
    )
    centre = transition(x, u)
    moved = transition(spread, inner)
    g = noise_gain(x, u.dt_s, noise.curved) * of_noise[:, None, :]
    pushed = np.swapaxes(g, -1, -2)
    every = np.concatenate(
        [centre[..., None, :], moved, centre[..., None, :] + pushed, centre[..., None, :] - pushed], axis=-2
    )
    # a straight model has no slip rate: the jitter of the decomposition must not create one
    every[..., S.SLIP_RATE] = np.where(noise.curved[:, None], every[..., S.SLIP_RATE], 0.0)
    mean = mean_weight @ every
    apart = every - mean[..., None, :]
    grown = np.swapaxes(covariance_weight[:, None] * apart, -1, -2) @ apart + noise.errors
    return mean, symmetric(grown), jacobian(x, u)
