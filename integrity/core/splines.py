"""Regression on piecewise bilinear functions of two variables (tensor products of linear B-splines), with a ridge."""

from __future__ import annotations

from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

__all__ = ["KNOTS", "Basis", "fit_linear", "fit_logistic"]

Array = NDArray[np.float64]

KNOTS = 6  # at quantiles of what is fitted
RIDGE = 1.0  # penalty of a squared coefficient, in samples
NEWTON_STEPS, LONGEST_STEP, SETTLED = 30, 5.0, 1e-4


class Basis:
    """Columns of a model: an intercept, and products of hat functions of two variables with knots at their quantiles.

    Parameters
    ----------
    x, y : (n,) samples of both variables
    knots : how many of each; with one knot the variable does not enter

    Attributes
    ----------
    x, y : knots
    """

    def __init__(self, x: Array, y: Array, knots: tuple[int, int] = (KNOTS, KNOTS)) -> None:
        self.x, self.y = _knots(x, knots[0]), _knots(y, knots[1])

    @classmethod
    def of(cls, x: Array, y: Array) -> Self:
        """The basis with these knots."""
        basis = cls.__new__(cls)
        basis.x, basis.y = x, y
        return basis

    def at(self, x: Array, y: Array) -> Array:
        """The columns (n, k) of samples."""
        products = _hats(x, self.x)[:, :, None] * _hats(y, self.y)[:, None, :]
        return np.concatenate([np.ones((x.size, 1)), products.reshape(x.size, -1)], 1)


def _knots(values: Array, count: int) -> Array:
    """Distinct quantiles of values."""
    return np.unique(np.quantile(values, np.linspace(0.0, 1.0, count) if count > 1 else [0.5]))


def _hats(values: Array, knots: Array) -> Array:
    """Linear B-splines (n, K), whose sum is 1; constant beyond the knots."""
    return np.stack([np.interp(values, knots, row) for row in np.eye(knots.size)], -1)


def _penalty(columns: Array) -> Array:
    """The ridge, without the intercept."""
    ridge = np.full(columns.shape[1], RIDGE)
    ridge[0] = 1e-6
    return ridge


def fit_linear(columns: Array, target: Array) -> Array:
    """Coefficients of ridge regression."""
    return np.asarray(np.linalg.solve(columns.T @ columns + np.diag(_penalty(columns)), columns.T @ target))


def fit_logistic(columns: Array, target: NDArray[np.bool_]) -> Array:
    """Coefficients of ridge-penalised logistic regression, by Newton's method."""
    ridge, x = _penalty(columns), np.zeros(columns.shape[1])
    for _ in range(NEWTON_STEPS):
        p = expit(columns @ x)
        slope = columns.T @ (target - p) - ridge * x
        step = np.linalg.solve((columns * (p * (1.0 - p))[:, None]).T @ columns + np.diag(ridge), slope)
        x += np.clip(step, -LONGEST_STEP, LONGEST_STEP)
        if np.abs(step).max() < SETTLED:
            break
    return x
