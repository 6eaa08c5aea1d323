"""Levels with memory: KIPL and ERAIM (filters aided by displacements), and the composite of noise and bias.

The filters work on positions, on East and North apart: ``x^- = x + step``, ``K = P^- / (P^- + sigma^2)``. Errors of
codes last for seconds to minutes, so that no filter of this module takes them as independent between epochs: deviations
of old and new errors add up as they are, not as squares. That is exact for errors that do not change, and an upper
bound of the deviation for every other correlation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError
from lanebound.integrity.monitoring.family.config import FamilyMonitorConfig
from lanebound.integrity.monitoring.family.epochs import CodeEpochs
from lanebound.integrity.monitoring.family.fit import CodeFit
from lanebound.integrity.monitoring.family.levels import LevelWork, isotropic_factor, normal_factor
from lanebound.integrity.monitoring.family.separations import separations
from lanebound.integrity.monitoring.protection import multi_hypothesis
from lanebound.integrity.monitoring.risk import false_alarm_factor
from lanebound.integrity.monitoring.separation import Separation

__all__ = ["Remembered", "composite", "extended", "isotropic_kalman"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

LEAST_STEP_M = 1e-3  # deviation of a step, that gains stay positive


@dataclass(frozen=True)
class Remembered:
    """Positions (E, 3), levels (E, R), inf before the method has begun, and alarms (E,) of its own test."""

    position_enu_m: Array
    hpl_m: Array
    alarm: Bools


def _steps(epochs: CodeEpochs) -> tuple[Array, Array]:
    """Steps (E, 2) and their deviations (E,), inf at the beginning of a drive."""
    if epochs.step_enu_m is None or epochs.step_sigma_m is None:
        raise InputError("step_enu_m must be known for filters, got None: add wheels, gyro or Doppler to the epochs")
    return epochs.step_enu_m[:, :2], np.where(epochs.starts(), np.inf, np.maximum(epochs.step_sigma_m, LEAST_STEP_M))


def isotropic_kalman(work: LevelWork) -> Remembered:
    """KIPL in a conservative form.

    ``L_k = max(1 - K) (L_{k-1} + z q) + max(K) k |r| d_major``: the level of the old position, grown by the quantile z
    of the step's error, and the isotropic level of the new one, each by its share. Levels add up where the errors of
    all epochs are jointly elliptical (as the isotropic law is), whatever their correlation; an epoch without redundancy
    only moves the position.
    """
    fit, (step, spread) = work.fit, _steps(work.epochs)
    good, major = fit.solved & (fit.df > 0), fit.major_m
    factor = isotropic_factor(np.maximum(fit.df, 1), work.risks) * np.sqrt(fit.wsse)[:, None]
    z = normal_factor(work.risks)
    plane = np.diagonal(fit.cofactor, axis1=1, axis2=2)[:, :2]
    x, p, level = np.zeros(2), np.full(2, np.inf), np.full(work.risks.size, np.inf)
    position, found = fit.x_m.copy(), np.full((fit.df.size, work.risks.size), np.inf)
    for k in range(fit.df.size):
        x, p = x + step[k], p + spread[k] ** 2
        level = level + z * spread[k]
        if good[k]:
            share = np.where(np.isinf(p), 1.0, p / (np.where(np.isinf(p), 1.0, p) + plane[k]))
            x = x + share * (fit.x_m[k, :2] - x)
            old = np.zeros_like(level) if (share == 1.0).all() else (1.0 - share.min()) * level
            level = old + share.max() * factor[k] * major[k]
            p = share * plane[k]
        position[k, :2], found[k] = x, level
    return Remembered(position, found, np.zeros(fit.df.size, bool))


def extended(work: LevelWork) -> Remembered:
    """ERAIM: a bank of filters, the one of all codes and one without each code, by solution separation.

    The deviation of each filter and of each separation follows ``s = (1 - K) hypot(s, q) + K sigma``; the level is the
    root of the sum over hypotheses (S2 eq 10-11), the alarm its separation test.
    """
    epochs, fit, config = work.epochs, work.fit, work.config
    parts, (step, spread) = separations(fit), _steps(epochs)
    count, modes = parts.sigma_m.shape[:2]
    snapshot = fit.x_m[:, None, :2] - parts.separation_m
    x, s, sd = np.zeros((modes, 2)), np.full((modes, 2), np.inf), np.zeros((modes, 2))
    position = fit.x_m.copy()
    sigma, delta, apart = np.full((count, modes, 2), np.inf), np.zeros((count, modes, 2)), np.zeros((count, modes, 2))
    for k in range(count):
        x, s = x + step[k], np.hypot(s, spread[k])
        if np.isinf(spread[k]):
            sd[:] = 0.0
        own = parts.sigma_m[k]
        there = np.isfinite(own) & fit.solved[k]
        before = np.where(np.isinf(s), 1.0, s) ** 2
        share = np.where(there, np.where(np.isinf(s), 1.0, before / (before + np.where(there, own, 1.0) ** 2)), 0.0)
        x = x + share * (snapshot[k] - x)
        new = np.where(there, share * np.where(there, own, 0.0), 0.0)
        s = np.where(
            share == 1.0, new, np.where(np.isinf(s), np.inf, (1.0 - share) * np.where(np.isinf(s), 0.0, s) + new)
        )
        sd = (1.0 - share) * sd + share * parts.delta_m[k]
        position[k, :2], sigma[k], delta[k], apart[k] = x[0], s, sd, x[0] - x
    bank = Separation(sigma, delta, np.zeros_like(sigma), apart, np.zeros((count, modes), np.int64), parts.gain_track)
    number = fit.used.sum(-1)
    k_fa = false_alarm_factor(config.false_alarm, number)
    alarm = (np.abs(apart) > k_fa[:, None, None] * delta + 1e-9).any((1, 2)) & fit.solved
    return Remembered(position, bank_levels(bank, fit, config, work.risks, k_fa), alarm)


def bank_levels(bank: Separation, fit: CodeFit, config: FamilyMonitorConfig, risks: Array, k_fa: Array) -> Array:
    """Root of the sum over hypotheses, half of the risk on each axis; modes of absent codes have no prior.  (E, R)."""
    prior = np.concatenate([np.full((fit.df.size, 1), 2.0), config.satellite_prior * fit.used], 1)
    levels = [multi_hypothesis(bank, prior, k_fa, np.full((fit.df.size, 2), 0.5 * risk)) for risk in risks]
    return np.stack([np.hypot(level[:, 0], level[:, 1]) for level in levels], -1)


def composite(work: LevelWork) -> Remembered:
    """``PL = PL_noise + PL_bias``: residuals of each code are split by an AR(1) model (S3 eq 16, [124]).

    Mean, variance and lag-1 covariance of ``r_i / R_ii`` are running means over ``window_s``. The innovations
    ``var (1 - phi^2)`` are the noise, of which the level is normal; the part that the model predicts is the bias, which
    counts with its size: ``PL_bias = hypot_q(sum_i |S_qi| |b_i|)``.
    """
    fit, config = work.fit, work.config
    tested = fit.used & (fit.redundancy > 1e-9)
    error = np.where(tested, fit.residual_m / np.where(tested, fit.redundancy, 1.0), 0.0)
    noise, bias = _split(work.epochs, error, tested, config.window_s)
    spread = np.where(fit.used, noise, 0.0)
    moved = fit.gain[..., :2] * np.sqrt(spread)[..., None]
    cov = np.swapaxes(moved, 1, 2) @ moved
    half, off = 0.5 * (cov[:, 0, 0] + cov[:, 1, 1]), 0.5 * (cov[:, 0, 0] - cov[:, 1, 1])
    major = np.sqrt(half + np.hypot(off, cov[:, 0, 1]))
    carried = (np.abs(fit.gain[..., :2]) * bias[..., None]).sum(1)
    level = normal_factor(work.risks) * major[:, None] + np.hypot(carried[:, 0], carried[:, 1])[:, None]
    unchecked = (fit.used & ~tested & (np.abs(fit.gain[..., :2]).max(-1) > 1e-9)).any(-1) | (fit.df <= 0)
    return Remembered(fit.x_m, np.where(unchecked[:, None], np.inf, level), np.zeros(fit.df.size, bool))


def _split(epochs: CodeEpochs, error: Array, tested: Bools, window_s: float) -> tuple[Array, Array]:
    """Variance of the innovations and size of the predicted part of each code, (E, m) each [m^2], [m].

    A code begins with its stated variance as that of the noise, which counts as one window of observations.
    """
    starts, dt = epochs.starts(), np.diff(epochs.time_s, prepend=epochs.time_s[:1])
    columns = error.shape[1]
    mean, var, lag, before = np.zeros((4, columns))
    kept = np.zeros(columns, bool)
    noise, bias = np.zeros_like(error), np.zeros_like(error)
    stated = np.where(epochs.used, np.square(np.where(epochs.used, epochs.sigma_m, 1.0)), 0.0)
    for k in range(error.shape[0]):
        share = 1.0 if starts[k] else min(1.0, max(dt[k], 0.0) / window_s)
        new = tested[k] & (~kept | starts[k])
        mean, var, lag = np.where(new, 0.0, mean), np.where(new, stated[k], var), np.where(new, 0.0, lag)
        known = tested[k] & ~new
        mean = np.where(known, mean + share * (error[k] - mean), mean)
        var = np.where(known, var + share * (np.square(error[k] - mean) - var), var)
        lag = np.where(known, lag + share * ((error[k] - mean) * (before - mean) - lag), lag)
        phi = np.clip(lag / np.where(var > 0.0, var, 1.0), 0.0, 0.999)
        noise[k] = np.where(tested[k], var * (1.0 - phi**2), stated[k])
        bias[k] = np.where(tested[k], np.abs(mean + phi * (error[k] - mean)), 0.0)
        before, kept = error[k], tested[k]
    return noise, bias
