"""Weighted least squares with residuals, and dilution of precision: the reference of the geometry kernels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.errors import require_finite, require_shape
from lanebound.integrity.positioning.least_squares import POSITION_COLUMNS, Gain, gain, weights

__all__ = ["Dilution", "Solution", "dilution", "solve"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Solution:
    """Estimate (..., n), residuals (..., m) and their covariance (..., m, m), ``e'W e`` and its df (...,), the gain."""

    estimate: Array
    residual: Array
    residual_covariance: Array
    chi2: Array
    freedom: Ints
    gain: Gain


@dataclass(frozen=True)
class Dilution:
    """HDOP, PDOP (..., unitless) and weighted horizontal ("metre") DOP (..., [m]); inf where not solvable."""

    hdop: Array
    pdop: Array
    weighted_hdop_m: Array


def solve(
    design: ArrayLike,
    covariance: ArrayLike,
    y: ArrayLike,
    rows: ArrayLike | None = None,
    required: int = POSITION_COLUMNS,
) -> Solution:
    """``x = S y``, ``e = (I - G S) y``, ``Q_e = Q_y - G (G'WG)^-1 G'`` (S1 eq 1, 9) on the used rows; else zeros.

    design (..., m, n), covariance (..., m, m) [m^2], y (..., m) [m], rows (..., m) bool.
    """
    g, q, obs = require_finite("design", design), require_finite("covariance", covariance), require_finite("y", y)
    require_shape("y", obs, (g.shape[-2],))
    used = np.ones(obs.shape[-1], bool) if rows is None else np.asarray(rows, dtype=bool)
    w = weights(q, used)
    s = gain(g, w, required)
    keep = used & s.solved[..., None]
    seen = np.where(keep[..., None], g, 0.0)
    estimate = (s.gain @ obs[..., None])[..., 0]
    residual = np.where(keep, obs - (seen @ estimate[..., None])[..., 0], 0.0)
    both = keep[..., :, None] & keep[..., None, :]
    residual_covariance = np.where(both, q - seen @ s.cofactor @ np.swapaxes(seen, -1, -2), 0.0)
    chi2 = (residual[..., None, :] @ w @ residual[..., :, None])[..., 0, 0]
    live = (np.diagonal(s.cofactor, axis1=-2, axis2=-1) > 0.0).sum(-1)
    freedom = np.where(s.solved, np.broadcast_to(used, keep.shape).sum(-1) - live, 0).astype(np.int64)
    return Solution(estimate, residual, residual_covariance, chi2, freedom, s)


def dilution(design: ArrayLike, weight: ArrayLike) -> Dilution:
    """HDOP and PDOP from ``(G'G)^-1``, the weighted HDOP from ``(G'WG)^-1`` (S2 2.2, equations in ENU).

    design (..., m, n) with the columns E, N, U first; weight (..., m, m), zero rows are rows out of view.
    """
    w = require_finite("weight", weight)
    used = np.diagonal(w, axis1=-2, axis2=-1) > 0.0
    plain = gain(design, used[..., None] * np.eye(used.shape[-1]))
    weighted = gain(design, w)
    return Dilution(_root_trace(plain, 2), _root_trace(plain, 3), _root_trace(weighted, 2))


def _root_trace(s: Gain, columns: int) -> Array:
    """Root of the sum of the first diagonal entries of the cofactor; inf where not solved."""
    diagonal = np.diagonal(s.cofactor, axis1=-2, axis2=-1)[..., :columns]
    return np.where(s.solved, np.sqrt(np.maximum(diagonal.sum(-1), 0.0)), np.inf)
