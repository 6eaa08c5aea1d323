"""The residual test in its three forms (S3 III-A): residuals, parity space, range comparison; all are the same number.

The forms take a full design matrix, one epoch or many, without masks. Monitors use the residuals.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import InputError, require_finite, require_in_range

__all__ = ["parity_statistic", "range_comparison_statistic", "residual_statistic"]

Array = NDArray[np.float64]


def _whitened(design: ArrayLike, sigma_m: ArrayLike, y_m: ArrayLike) -> tuple[Array, Array]:
    g, y = require_finite("design", design), require_finite("y_m", y_m)
    sigma = np.broadcast_to(require_in_range("sigma_m", sigma_m, 0.0, np.inf, low_open=True), y.shape)
    if g.shape[-2] <= g.shape[-1]:
        raise InputError(f"design must have more rows than columns, got {g.shape[-2]} x {g.shape[-1]}: add codes")
    return g / sigma[..., None], y / sigma


def residual_statistic(design: ArrayLike, sigma_m: ArrayLike, y_m: ArrayLike) -> Array:
    """``r'W r`` of the least-squares residuals.  (..., m, n), (..., m), (..., m) -> (...,)."""
    g, y = _whitened(design, sigma_m, y_m)
    x = np.linalg.solve(np.swapaxes(g, -1, -2) @ g, np.swapaxes(g, -1, -2) @ y[..., None])
    return np.asarray(np.square(y - (g @ x)[..., 0]).sum(-1))


def parity_statistic(design: ArrayLike, sigma_m: ArrayLike, y_m: ArrayLike) -> Array:
    """``p'p`` with ``p = P y`` and P an orthonormal basis of what the design does not reach.  (...,)."""
    g, y = _whitened(design, sigma_m, y_m)
    full = np.linalg.qr(g, mode="complete").Q
    p = np.swapaxes(full[..., g.shape[-1] :], -1, -2) @ y[..., None]
    return np.asarray(np.square(p[..., 0]).sum(-1))


def range_comparison_statistic(design: ArrayLike, sigma_m: ArrayLike, y_m: ArrayLike) -> Array:
    """``d'D^-1 d`` of the other ranges less their prediction by the first n, D the covariance of d.  (...,).

    ``d = y_b - G_b G_a^-1 y_a``, ``D = I + (G_b G_a^-1)(G_b G_a^-1)'`` for whitened rows; the first n must determine x.
    """
    g, y = _whitened(design, sigma_m, y_m)
    n = g.shape[-1]
    carried = np.swapaxes(
        np.linalg.solve(np.swapaxes(g[..., :n, :], -1, -2), np.swapaxes(g[..., n:, :], -1, -2)), -1, -2
    )
    d = y[..., n:] - (carried @ y[..., :n, None])[..., 0]
    covariance = np.eye(d.shape[-1]) + carried @ np.swapaxes(carried, -1, -2)
    return np.asarray((d * np.linalg.solve(covariance, d[..., None])[..., 0]).sum(-1))
