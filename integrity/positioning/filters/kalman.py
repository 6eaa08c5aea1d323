"""Correction step of a Kalman filter with a linear observation, and the test of its innovation (S4 eq 8).

``z = H x + w``, ``w ~ N(0, R)``. All functions take any leading batch axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtri

from lanebound.integrity.core.errors import require_in_range

__all__ = ["Innovation", "correct", "gate_threshold", "innovate", "symmetric"]

Array = NDArray[np.float64]
LOG_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True)
class Innovation:
    """``nu = z - H x`` (..., m), its covariance ``S = H P H' + R`` (..., m, m) and the inverse of that."""

    residual: Array
    covariance: Array
    inverse: Array

    @property
    def nis(self) -> Array:
        """Normalised innovation squared ``nu' S^-1 nu`` (...,), chi-square with m degrees of freedom (S4 eq 8)."""
        return np.asarray((self.residual[..., None, :] @ self.inverse @ self.residual[..., :, None])[..., 0, 0])

    @property
    def log_likelihood(self) -> Array:
        """``-(nu' S^-1 nu + m log 2 pi + log det S) / 2`` (...,), the logarithm of S4's likelihood function."""
        _, log_det = np.linalg.slogdet(self.covariance)
        return np.asarray(-0.5 * (self.nis + self.residual.shape[-1] * LOG_2PI + log_det))


def innovate(x: Array, p: Array, z: Array, h: Array, r: Array) -> Innovation:
    """The innovation of observations z (..., m) with design h (..., m, n) and covariance r (..., m, m)."""
    residual = z - (h @ x[..., None])[..., 0]
    s = h @ p @ np.swapaxes(h, -1, -2) + r
    return Innovation(residual, s, np.asarray(np.linalg.inv(s), dtype=np.float64))


def correct(
    x: Array, p: Array, h: Array, found: Innovation, used: NDArray[np.bool_] | bool = True
) -> tuple[Array, Array, Array]:
    """``W = P H' S^-1``, ``x + W nu``, ``P - W S W'`` (S4 section II-D3); where not ``used`` (...,) nothing changes.

    Returns
    -------
    x (..., n), P (..., n, n), W (..., n, m); W is 0 where not used.
    """
    w = p @ np.swapaxes(h, -1, -2) @ found.inverse
    w = np.where(np.asarray(used)[..., None, None], w, 0.0)
    state = x + (w @ found.residual[..., None])[..., 0]
    return state, symmetric(p - w @ found.covariance @ np.swapaxes(w, -1, -2)), w


def symmetric(p: Array) -> Array:
    """The symmetric part of matrices (..., n, n)."""
    return np.asarray(0.5 * (p + np.swapaxes(p, -1, -2)))


def gate_threshold(false_rejection: ArrayLike, dimension: int) -> Array:
    """``g^2`` of S4 eq 8: the chi-square quantile that a right observation exceeds with this probability.  (...,)."""
    share = require_in_range("false_rejection", false_rejection, 0.0, 1.0, low_open=True, high_open=True)
    return np.asarray(chdtri(dimension, share))
