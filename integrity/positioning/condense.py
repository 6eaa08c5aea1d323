"""Many correlated rows of one satellite as few independent ones, without loss for the unknowns.

With ``Q = L L'``, ``A = L^-1 G = U D V'`` and ``b = L^-1 y``, the rows ``D V' x = U'b`` of unit variance have the
normal equations of ``G x = y`` with covariance Q. A window of a hundred epochs thus becomes a handful of rows for each
satellite, which least squares, fault detection and protection levels take as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Condensed", "condense_white", "gauss_markov_covariance"]

Array = NDArray[np.float64]

NEGLIGIBLE = 1e-6  # of the largest singular value


@dataclass(frozen=True)
class Condensed:
    """Rows (r, n) and right-hand sides (r,) of unit variance; what no x can explain: ``misfit`` and its ``freedom``."""

    design: Array
    y: Array
    misfit: float
    freedom: int


def condense_white(white: Array) -> Condensed:
    """At most n rows in place of m rows of unit variance: (m, n + 1), the right-hand side last."""
    left, size, across = np.linalg.svd(white[:, :-1], full_matrices=False)
    keep = size > NEGLIGIBLE * max(float(size.max(initial=0.0)), np.finfo(np.float64).tiny)
    rotated = left[:, keep].T @ white[:, -1]
    misfit = max(float(white[:, -1] @ white[:, -1] - rotated @ rotated), 0.0)
    return Condensed(size[keep, None] * across[keep], rotated, misfit, white.shape[0] - int(keep.sum()))


def gauss_markov_covariance(time_s: Array, sigma: Array, tau_s: float, white: float = 0.0) -> Array:
    """``sigma_i sigma_j (exp(-|t_i - t_j| / tau) + white [i = j])``: an error that lasts, and noise.

    time_s, sigma (m,), white over the variance of the lasting error -> (m, m); tau_s 0 for noise of ``sigma`` alone.
    """
    if tau_s <= 0.0:
        return np.diag(sigma**2)
    apart = np.abs(time_s[:, None] - time_s[None, :])
    correlation = np.exp(-apart / tau_s) + white * np.eye(len(time_s))
    return np.asarray(sigma[:, None] * sigma[None, :] * correlation)
