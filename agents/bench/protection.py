"""Speed of the protection level kernel against the same computation written epoch by epoch in NumPy."""

from __future__ import annotations

import math
from contextlib import nullcontext

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr

from lanebound.agents.bench.rows import Row, alternate, median_ratio
from lanebound.integrity.core.accel import serial
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.protection import protection_levels_batch
from lanebound.integrity.monitoring.risk import RiskConfig

__all__ = ["measure"]

Array = NDArray[np.float64]

SATELLITES = 30
SYSTEMS = 4
FAST_EPOCHS = 20_000
SLOW_EPOCHS = 40
CONFIG = RiskConfig(integrity_risk=1e-6, satellite_prior=(1e-5,) * 5)


class Sky:
    """Random epochs: lines of sight, clock group, variances for integrity and accuracy, biases, headings."""

    def __init__(self, epochs: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        shape = (epochs, SATELLITES)
        elevation = np.arcsin(rng.uniform(np.sin(np.radians(8.0)), 1.0, shape))
        azimuth = rng.uniform(0.0, 2.0 * np.pi, shape)
        flat = np.cos(elevation)
        self.los = np.stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)], -1)
        self.group = rng.permuted(np.tile(np.arange(SATELLITES) % SYSTEMS, (epochs, 1)), axis=1)
        self.variance = 0.09 + 0.04 / np.sin(elevation) ** 2
        self.accuracy = 0.6 * self.variance
        self.bias = rng.uniform(0.0, 0.2, shape)
        self.heading = rng.uniform(0.0, 2.0 * np.pi, epochs)

    def kernel(self, parallel: bool) -> Array:
        """Levels of all epochs by the kernels.  (E, 2) [m]."""
        with nullcontext() if parallel else serial():
            levels = protection_levels_batch(
                self.los,
                True,
                self.group,
                self.variance,
                self.heading,
                CONFIG,
                accuracy_m2=self.accuracy,
                bias_m=self.bias,
            )
        return levels.root_m[:, 0]

    def naive(self) -> Array:
        """The same levels, one epoch, one mode and one axis at a time.  (E, 2) [m]."""
        return np.array([self._naive_epoch(e) for e in range(len(self.heading))])

    def _naive_epoch(self, e: int) -> list[float]:
        clock = np.eye(SYSTEMS)[self.group[e]]
        g = np.hstack([-self.los[e], clock])
        s, c = math.sin(self.heading[e]), math.cos(self.heading[e])
        turn = np.zeros((2, g.shape[1]))
        turn[:, :2] = [[s, c], [c, -s]]
        weight = np.diag(1.0 / self.variance[e])
        full = turn @ np.linalg.inv(g.T @ weight @ g) @ g.T @ weight
        columns = [self._naive_mode(e, full, full)]
        for k in range(SATELLITES):
            left = weight.copy()
            left[k, k] = 0.0
            columns.append(self._naive_mode(e, turn @ np.linalg.inv(g.T @ left @ g) @ g.T @ left, full))
        sigma, delta, bias = (np.array(part) for part in zip(*columns, strict=True))
        offset = CONFIG.false_alarm_factors(SATELLITES)[SATELLITES] * delta + bias
        priors = np.full(SATELLITES + 1, CONFIG.satellite_prior[0])
        pairs = 0.5 * (priors[1:].sum() ** 2 - (priors[1:] ** 2).sum())
        priors[0] = 2.0
        budget = 0.5 * (CONFIG.integrity_risk - pairs)
        return [self._naive_root(priors, offset[:, q], sigma[:, q], budget) for q in range(2)]

    def _naive_mode(self, e: int, rows: Array, full: Array) -> tuple[Array, Array, Array]:
        sigma = np.sqrt(np.diag(rows @ np.diag(self.variance[e]) @ rows.T))
        apart = rows - full
        delta = np.sqrt(np.maximum(np.diag(apart @ np.diag(self.accuracy[e]) @ apart.T), 0.0))
        return sigma, delta, np.abs(rows) @ self.bias[e]

    @staticmethod
    def _naive_root(priors: Array, offset: Array, sigma: Array, budget: float) -> float:
        def excess(x: float) -> float:
            return float((priors * ndtr((offset - x) / sigma)).sum() - budget)

        return float(brentq(excess, 0.0, 1e4, xtol=1e-9, rtol=1e-12))


def measure(rounds: int = 5) -> list[Row]:
    """Ratio on all threads and rate on all threads and on one; both sides are compared first."""
    small, large = Sky(SLOW_EPOCHS, 1), Sky(FAST_EPOCHS, 2)
    worst = float(np.abs(small.kernel(False) / small.naive() - 1.0).max())
    if not worst < 1e-8:
        raise InputError(f"the kernel must equal the plain form to 1e-8, it differs by {worst}: fix it before timing")

    def fast(parallel: bool) -> int:
        large.kernel(parallel)
        return FAST_EPOCHS

    def slow() -> int:
        small.naive()
        return SLOW_EPOCHS

    rates = alternate({"threads": lambda: fast(True), "one": lambda: fast(False), "naive": slow}, rounds)
    return [
        Row("pl_kernel_n30_vs_naive", median_ratio(rates, "threads", "naive"), "x", gate=800.0, stretch=3000.0),
        Row("pl_kernel_n30_epochs_per_s", float(np.median(rates["threads"])), "1/s", stretch=3.0e6),
        Row("pl_kernel_n30_epochs_per_s_one_core", float(np.median(rates["one"])), "1/s"),
    ]
