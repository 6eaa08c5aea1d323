"""ERAIM: a bank of filters aided by displacements, the one of all codes and one without each code.

The composite level follows from residuals split into noise and bias by an AR(1) model (S3 eq 16, [124]).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.monitoring.family.config import FamilyMonitorConfig
from lanebound.integrity.monitoring.family.levels import LevelWork, normal_factor
from lanebound.integrity.monitoring.family.memory import Memory, Remembered, blend, rows_of, share_of, steps_of
from lanebound.integrity.monitoring.family.separations import separations
from lanebound.integrity.monitoring.protection import multi_hypothesis
from lanebound.integrity.monitoring.risk import false_alarm_factor
from lanebound.integrity.monitoring.separation import Separation

__all__ = ["BankMemory", "CompositeMemory", "composite", "extended"]

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


NOISE_M = 1e-9  # of rounding, in separations


@dataclass
class BankMemory(Memory):
    """Banks of B vehicles with m satellites: of the filter of all codes and of those without each one, position,
    deviation (inf before it has begun) and deviation of the separation (B, 1 + m, 2); and which codes have entered the
    bank since it began (B, m)."""

    position_m: Array
    sigma_m: Array
    delta_m: Array
    entered: Bools

    @classmethod
    def new(cls, batch: int, columns: int, risks: int) -> BankMemory:
        """See :class:`~lanebound.integrity.monitoring.family.memory.Memory`."""
        shape = (batch, 1 + columns, 2)
        return cls(np.zeros(shape), np.full(shape, np.inf), np.zeros(shape), np.zeros((batch, columns), bool))


def extended(work: LevelWork) -> Remembered:
    """ERAIM: the level is the root of the sum over hypotheses (S2 eq 10-11), the alarm its separation test.

    Deviations follow ``s = (1 - K) (s + q) + K sigma``, those of separations the same with what the gains differ by. A
    code that has entered the bank stays a hypothesis until the drive ends, and the separations are tested at every
    epoch, with codes or without: what a faulty code has moved stays in the filters when it is gone.
    """
    fit, (step, spread) = work.fit, steps_of(work)
    parts = separations(fit)
    count, modes = parts.sigma_m.shape[:2]
    snapshot = fit.x_m[:, None, :2] - parts.separation_m
    there = np.isfinite(parts.sigma_m) & fit.solved[:, None, None]
    position, entered = fit.x_m.copy(), np.zeros(fit.used.shape, bool)
    sigma, delta, apart = np.full((count, modes, 2), np.inf), np.zeros((count, modes, 2)), np.zeros((count, modes, 2))
    memory, rows = rows_of(work, BankMemory)
    for at in rows:
        anew = np.isinf(spread[at])
        x, s = memory.position_m + step[at, None], memory.sigma_m + spread[at, None]
        share = share_of(s, parts.sigma_m[at], there[at])
        old = np.where(np.isfinite(s), memory.delta_m, 0.0)
        other = np.abs(share[:, :1] - share)  # moves a filter apart by the innovation of the filter of all codes
        moved = (other > 0.0) & np.isfinite(s[:, :1]) & (np.isfinite(s) | there[at])
        innovation = np.where(moved, s[:, :1] + parts.sigma_m[at, :1], 0.0)
        memory.delta_m = (1.0 - share) * old + share * parts.delta_m[at] + other * innovation
        memory.position_m = x + share * (snapshot[at] - x)
        memory.sigma_m = blend(share, s, parts.sigma_m[at])
        memory.entered = np.where(anew, False, memory.entered) | (fit.used[at] & fit.solved[at, None])
        position[at, :2], entered[at] = memory.position_m[:, 0], memory.entered
        sigma[at], delta[at], apart[at] = memory.sigma_m, memory.delta_m, memory.position_m[:, :1] - memory.position_m
    known = np.isfinite(sigma) & np.isfinite(sigma[:, :1])
    bank = Separation(sigma, delta, np.zeros_like(sigma), apart, np.zeros((count, modes), np.int64), parts.gain_track)
    k_fa = false_alarm_factor(work.config.false_alarm, entered.sum(-1))
    failed = (known & (np.abs(apart) > k_fa[:, None, None] * delta + NOISE_M)).any((1, 2))
    level = bank_levels(bank, entered, work.config, work.risks, k_fa)
    return Remembered(position, level, work.alarm | failed, np.isfinite(sigma[:, 0, 0]))


def bank_levels(bank: Separation, entered: Bools, config: FamilyMonitorConfig, risks: Array, k_fa: Array) -> Array:
    """Root of the sum over hypotheses, half of the risk on each axis.  (E, R)."""
    prior = np.concatenate([np.full((len(entered), 1), 2.0), config.satellite_prior * entered], 1)
    levels = [multi_hypothesis(bank, prior, k_fa, np.full((len(entered), 2), 0.5 * risk)) for risk in risks]
    return np.stack([np.hypot(level[:, 0], level[:, 1]) for level in levels], -1)
