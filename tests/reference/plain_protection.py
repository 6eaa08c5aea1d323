"""Protection levels in plain NumPy: one epoch, one mode of one satellite, and one axis at a time."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr

from lanebound.integrity.monitoring.risk import RiskConfig

__all__ = ["plain_levels"]

Array = NDArray[np.float64]


def plain_levels(
    los: Array, group: NDArray[np.int64], variance: Array, accuracy: Array, bias: Array, heading_rad: float,
    risk: RiskConfig,
) -> list[float]:  # fmt: skip
    """Levels along and across the track [m] of one epoch of m satellites with faults of one at a time."""
    count = len(los)
    clock = np.eye(int(group.max()) + 1)[group]
    g = np.hstack([-los, clock])
    s, c = math.sin(heading_rad), math.cos(heading_rad)
    turn = np.zeros((2, g.shape[1]))
    turn[:, :2] = [[s, c], [c, -s]]
    weight = np.diag(1.0 / variance)
    full = turn @ np.linalg.inv(g.T @ weight @ g) @ g.T @ weight
    columns = [_mode(full, full, variance, accuracy, bias)]
    for k in range(count):
        left = weight.copy()
        left[k, k] = 0.0
        rows = turn @ np.linalg.inv(g.T @ left @ g) @ g.T @ left
        columns.append(_mode(rows, full, variance, accuracy, bias))
    sigma, delta, offset = (np.array(part) for part in zip(*columns, strict=True))
    offset = risk.false_alarm_factors(count)[count] * delta + offset
    priors = np.full(count + 1, risk.satellite_prior[0])
    pairs = 0.5 * (priors[1:].sum() ** 2 - (priors[1:] ** 2).sum())
    priors[0] = 2.0
    budget = 0.5 * (risk.integrity_risk - pairs)
    return [_root(priors, offset[:, q], sigma[:, q], budget) for q in range(2)]


def _mode(rows: Array, full: Array, variance: Array, accuracy: Array, bias: Array) -> tuple[Array, Array, Array]:
    """Sigma, sigma of the separation, and bias on both axes."""
    sigma = np.sqrt(np.diag(rows @ np.diag(variance) @ rows.T))
    apart = rows - full
    delta = np.sqrt(np.maximum(np.diag(apart @ np.diag(accuracy) @ apart.T), 0.0))
    return sigma, delta, np.abs(rows) @ bias


def _root(priors: Array, offset: Array, sigma: Array, budget: float) -> float:
    def excess(x: float) -> float:
        return float((priors * ndtr((offset - x) / sigma)).sum() - budget)

    return float(brentq(excess, 0.0, 1e4, xtol=1e-9, rtol=1e-12))
