"""Correction of any batch by a linear observation, in NumPy: the reference of ``correction_kernel``.

``z = H x + w``, ``w ~ N(0, R)``. All functions take any leading batch axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Innovation", "correct", "innovate", "symmetric"]

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
