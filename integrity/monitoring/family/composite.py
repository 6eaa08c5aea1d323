"""The composite level: residuals split into noise and bias by an AR(1) model (S3 eq 16, [124])."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.monitoring.family.levels import LevelWork, normal_factor
from lanebound.integrity.monitoring.family.memory import Memory, Remembered, rows_of

__all__ = ["CompositeMemory", "composite"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass
class CompositeMemory(Memory):
    """Residuals of B vehicles with m satellites: mean, variance and lag-1 covariance, the last one (B, m), whether it
    was tested (B, m), and when (B, 1)."""

    mean_m: Array
    variance_m2: Array
    lag_m2: Array
    before_m: Array
    kept: Bools
    time_s: Array

    @classmethod
    def new(cls, batch: int, columns: int, risks: int) -> CompositeMemory:
        """See :class:`~lanebound.integrity.monitoring.family.memory.Memory`."""
        mean, variance, lag, before = np.zeros((4, batch, columns))
        return cls(mean, variance, lag, before, np.zeros((batch, columns), bool), np.zeros((batch, 1)))

    def split(self, time_s: Array, error: Array, tested: Bools, stated: Array, window_s: float) -> tuple[Array, Array]:
        """Variance of the innovations and size of the predicted part of each code, (B, m) each [m^2], [m].

        A code begins with its stated variance as that of the noise, which counts as one window of observations.
        """
        share = np.clip((time_s - self.time_s) / window_s, 0.0, 1.0)
        new, known = tested & ~self.kept, tested & self.kept
        mean, lag = np.where(new, 0.0, self.mean_m), np.where(new, 0.0, self.lag_m2)
        variance = np.where(new, stated, self.variance_m2)
        mean = np.where(known, mean + share * (error - mean), mean)
        variance = np.where(known, variance + share * (np.square(error - mean) - variance), variance)
        lag = np.where(known, lag + share * ((error - mean) * (self.before_m - mean) - lag), lag)
        phi = np.clip(lag / np.where(variance > 0.0, variance, 1.0), 0.0, 0.999)
        self.mean_m, self.variance_m2, self.lag_m2 = mean, variance, lag
        self.before_m, self.kept, self.time_s = error, tested, time_s
        bias = np.where(tested, np.abs(mean + phi * (error - mean)), 0.0)
        return np.where(tested, variance * (1.0 - phi**2), stated), bias


def composite(work: LevelWork) -> Remembered:
    """``PL = PL_noise + PL_bias``.

    Mean, variance and lag-1 covariance of ``r_i / R_ii`` are running means over ``window_s``. The innovations
    ``var (1 - phi^2)`` are the noise, of which the level is normal; the part that the model predicts is the bias, which
    counts with its size: ``PL_bias = hypot_q(sum_i |S_qi| |b_i|)``.
    """
    fit, epochs = work.fit, work.epochs
    tested = fit.used & (fit.redundancy > 1e-9)
    error = np.where(tested, fit.residual_m / np.where(tested, fit.redundancy, 1.0), 0.0)
    stated = np.where(epochs.used, np.square(np.where(epochs.used, epochs.sigma_m, 1.0)), 0.0)
    noise, bias = np.zeros_like(error), np.zeros_like(error)
    memory, rows = rows_of(work, CompositeMemory)
    begins = epochs.starts() & (work.memory is None)
    for at in rows:
        memory.kept = memory.kept & ~begins[at, None]
        noise[at], bias[at] = memory.split(
            epochs.time_s[at, None], error[at], tested[at], stated[at], work.config.window_s
        )
    moved = fit.gain[..., :2] * np.sqrt(np.where(fit.used, noise, 0.0))[..., None]
    cov = np.swapaxes(moved, 1, 2) @ moved
    half, off = 0.5 * (cov[:, 0, 0] + cov[:, 1, 1]), 0.5 * (cov[:, 0, 0] - cov[:, 1, 1])
    major = np.sqrt(half + np.hypot(off, cov[:, 0, 1]))
    carried = (np.abs(fit.gain[..., :2]) * bias[..., None]).sum(1)
    level = normal_factor(work.risks) * major[:, None] + np.hypot(carried[:, 0], carried[:, 1])[:, None]
    unchecked = (fit.used & ~tested & (np.abs(fit.gain[..., :2]).max(-1) > 1e-9)).any(-1) | (fit.df <= 0)
    return Remembered(fit.x_m, np.where(unchecked[:, None], np.inf, level), work.alarm, np.ones(fit.df.size, bool))
