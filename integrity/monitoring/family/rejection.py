"""Rejection of codes for cities (S3 V-B1): local tests with or without separability, and robust weights.

Each function takes epochs and returns them with fewer codes or larger deviations.

RANSAC and P-RANSAC judge solutions of small subsets by how many of the other codes agree with them (S3 [77]). A subset
has 4 codes of one system, and 1 more for each further system. With N codes of one system up to N - 5 faulty ones can be
told apart, because the right subset needs one more code that agrees; N - 4 is what may be left out.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, ndtri

from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.monitoring.family.config import FamilyMonitorConfig, Rejection
from lanebound.integrity.monitoring.family.epochs import MOST_SYSTEMS, CodeEpochs
from lanebound.integrity.monitoring.family.fit import CodeFit, row_correlation, solve_codes
from lanebound.integrity.positioning.danish import variance_factor

__all__ = ["REJECTIONS", "ROBUST", "global_threshold", "igg3_weight", "local_threshold", "range_errors", "ransac"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


POSITION = 3
ROWS_AT_ONCE = 8192


def ransac(epochs: CodeEpochs, config: FamilyMonitorConfig) -> CodeEpochs:
    """Epochs with the inliers of the best subset: the most inliers, then the least sum of squares."""
    inliers = np.zeros_like(epochs.used)
    for number in np.unique(_sizes(epochs)):
        rows = np.flatnonzero(_sizes(epochs) == number)
        inliers[rows] = _best_inliers(epochs.take(rows), int(number), config)
    enough = inliers.sum(-1) >= _sizes(epochs)
    return epochs.with_codes(used=np.where(enough[:, None], inliers, epochs.used))


def p_ransac(epochs: CodeEpochs, config: FamilyMonitorConfig) -> CodeEpochs:
    """RANSAC, then all ranges are compared with the solution of its inliers; those beyond the limit are left out."""
    found = ransac(epochs, config)
    error, known = range_errors(epochs, found, solve_codes(found))
    agrees = epochs.used & known & (np.abs(error) <= config.inlier_sigmas * epochs.sigma_m)
    enough = agrees.sum(-1) >= _sizes(epochs)
    return epochs.with_codes(used=np.where(enough[:, None], agrees, found.used))


def range_errors(epochs: CodeEpochs, current: CodeEpochs, fit: CodeFit) -> tuple[Array, Bools]:
    """Observation less prediction of all codes by the fit of ``current``, and where its system has a clock.  (E, m)."""
    away = epochs.y_m + (epochs.los_enu @ fit.x_m[..., None])[..., 0]
    out, known = np.zeros_like(away), np.zeros_like(epochs.used)
    for system in np.unique(epochs.system):
        own = np.flatnonzero(epochs.system == system)
        share = fit.clock_share[:, own]
        clock = (share * np.where(current.used[:, own], away[:, own], 0.0)).sum(-1)
        out[:, own] = away[:, own] - clock[:, None]
        known[:, own] = ((share.sum(-1) > 0.0) & fit.solved)[:, None]
    return out, known


def _sizes(epochs: CodeEpochs) -> NDArray[np.int64]:
    """Codes of a subset: 3 and the number of systems in view.  (E,)."""
    there = [(epochs.used & (epochs.system == s)).any(-1) for s in range(MOST_SYSTEMS)]
    return np.asarray(POSITION + np.sum(there, axis=0), dtype=np.int64)


def _best_inliers(epochs: CodeEpochs, size: int, config: FamilyMonitorConfig) -> Bools:
    """Inliers of the best subset of epochs whose subsets have ``size`` codes.  (E, m)."""
    best = np.zeros_like(epochs.used)
    step = max(1, ROWS_AT_ONCE // config.subsets)
    for first in range(0, epochs.count, step):
        part = epochs.take(slice(first, first + step))
        best[first : first + step] = _best_of(part, _subsets(part, size, config), config)
    return best


def _best_of(epochs: CodeEpochs, chosen: Bools, config: FamilyMonitorConfig) -> Bools:
    """The inliers of the best of T subsets (E, T, m)."""
    count, trials, columns = chosen.shape
    wide = epochs.take(np.repeat(np.arange(count), trials))
    subset = wide.with_codes(used=chosen.reshape(-1, columns))
    error, known = range_errors(wide, subset, solve_codes(subset))
    ratio = np.square(error / np.where(wide.used, wide.sigma_m, 1.0))
    inlier = wide.used & known & (ratio <= config.inlier_sigmas**2)
    score = inlier.sum(-1) - np.where(inlier, ratio, 0.0).sum(-1) / (1.0 + columns * config.inlier_sigmas**2)
    at = score.reshape(count, trials).argmax(-1)
    return np.asarray(inlier.reshape(count, trials, columns)[np.arange(count), at])


def _subsets(epochs: CodeEpochs, size: int, config: FamilyMonitorConfig) -> Bools:
    """T subsets of each epoch, (E, T, m): all of them for few codes of one system, else drawn, one of each system at
    least.

    Draws follow from the seed and the time of the epoch, so that an epoch has the same ones in every batch.
    """
    count, columns = epochs.used.shape
    out = np.zeros((count, config.subsets, columns), bool)
    for e in range(count):
        seen = np.flatnonzero(epochs.used[e])
        if seen.size < size:
            continue
        if size == POSITION + 1 and comb(seen.size, size) <= config.subsets:
            for t, subset in enumerate(combinations(seen, size)):
                out[e, t, list(subset)] = True
            continue
        key = [config.seed, int(epochs.drive[e]), int(np.rint(1e3 * epochs.time_s[e])) % 2**32]
        order = named_generator(key, "ransac").random((config.subsets, seen.size))
        for system in np.unique(epochs.system[seen]):  # the first of each system comes before all others
            own = np.flatnonzero(epochs.system[seen] == system)
            first = own[order[:, own].argmin(-1)]
            order[np.arange(config.subsets), first] -= 1.0
        picked = seen[np.argsort(order, axis=-1)[:, :size]]
        out[e, np.arange(config.subsets)[:, None], picked] = True
    return out


Robust = Callable[[Array, FamilyMonitorConfig], Array]

ROBUST = {Rejection.DANISH, Rejection.HUBER, Rejection.IGG3}  # change deviations by residuals
LEAST_WEIGHT = 1e-6  # robust weights below this leave the code out


def global_threshold(df: NDArray[np.int64], false_alarm: float) -> Array:
    """``chi2_{1-a}(df)``, inf without redundancy.  (E,)."""
    return np.where(df > 0, chdtri(np.maximum(df, 1), false_alarm), np.inf)


def local_threshold(number: NDArray[np.int64], false_alarm: float) -> Array:
    """``Qinv(a / (2 m))`` of m two-sided local tests.  (E,)."""
    return np.asarray(-ndtri(false_alarm / (2.0 * np.maximum(number, 1))))


def local_tests(epochs: CodeEpochs, config: FamilyMonitorConfig) -> CodeEpochs:
    """While the global test fails: exclude the code with the largest normalised residual above its threshold."""
    return _exclude(epochs, config, _largest)


def separable_tests(epochs: CodeEpochs, config: FamilyMonitorConfig) -> CodeEpochs:
    """As :func:`local_tests`, but only where the faulty code can be told apart.

    A code is excluded if no other code with a normalised residual above its threshold has a test correlated with its
    own by ``separable_below`` or more; else nothing is excluded and the alarm stays (geometry and separability checks,
    S3 [70]).
    """
    return _exclude(epochs, config, _separable)


def separation_tests(epochs: CodeEpochs, config: FamilyMonitorConfig) -> CodeEpochs:
    """Exclude the code of the largest separation in its deviations: ``d_i / sigma_di`` of single codes is ``w_i``."""
    return _exclude(epochs, config, _largest, always=True)


Choice = Callable[[CodeFit, CodeEpochs, FamilyMonitorConfig], tuple[NDArray[np.int64], Bools]]


def _exclude(epochs: CodeEpochs, config: FamilyMonitorConfig, choose: Choice, always: bool = False) -> CodeEpochs:
    """Exclude one code after another of epochs that fail; stops where the redundancy is used up."""
    used = epochs.used.copy()
    open_ = np.arange(epochs.count)
    for _ in range(config.most_excluded):
        part = epochs.take(open_).with_codes(used=used[open_])
        fit = solve_codes(part)
        fails = fit.solved & (fit.df > 1)
        if not always:
            fails &= fit.wsse > global_threshold(fit.df, config.false_alarm)
        row, found = choose(fit, part, config)
        found &= fails
        open_, row = open_[found], row[found]
        if not open_.size:
            break
        used[open_, row] = False
    return epochs.with_codes(used=used)


def _largest(fit: CodeFit, epochs: CodeEpochs, config: FamilyMonitorConfig) -> tuple[NDArray[np.int64], Bools]:
    size = np.abs(fit.normalised)
    row = size.argmax(-1)
    limit = local_threshold(epochs.used.sum(-1), config.false_alarm)
    return row, np.asarray(size[np.arange(row.size), row] > limit)


def _separable(fit: CodeFit, epochs: CodeEpochs, config: FamilyMonitorConfig) -> tuple[NDArray[np.int64], Bools]:
    row, found = _largest(fit, epochs, config)
    alike = np.abs(row_correlation(fit, epochs.system, row)) >= config.separable_below
    alike[np.arange(row.size), row] = False
    beyond = np.abs(fit.normalised) > local_threshold(epochs.used.sum(-1), config.false_alarm)[:, None]
    return row, np.asarray(found & ~(alike & beyond).any(-1))


def _reweighted(epochs: CodeEpochs, config: FamilyMonitorConfig, weight: Robust) -> CodeEpochs:
    """Repeat the solution with ``sigma_i / sqrt(weight(v_i))``, ``v_i = r_i / sigma_i`` by the first deviations."""
    current = epochs
    for _ in range(config.robust_rounds):
        fit = solve_codes(current)
        v = np.where(epochs.used, fit.residual_m / epochs.sigma_m, 0.0)
        if (epochs.used & ~current.used).any():  # residuals of codes that were left out, to let them in again
            v = np.where(epochs.used & ~current.used, _left_out(epochs, current, fit) / epochs.sigma_m, v)
        w = np.where(fit.solved[:, None], weight(v, config), 1.0)
        kept = w > LEAST_WEIGHT
        enough = (epochs.used & kept).sum(-1) > fit.used.sum(-1) - fit.df  # redundancy stays, or nothing is left out
        kept |= ~enough[:, None]
        w = np.where(kept, np.maximum(w, LEAST_WEIGHT), 1.0)
        current = epochs.with_codes(sigma_m=epochs.sigma_m / np.sqrt(w), used=epochs.used & kept)
    return current


def _left_out(epochs: CodeEpochs, current: CodeEpochs, fit: CodeFit) -> Array:
    """Observation less prediction of every code by a fit; 0 for systems that the fit has no clock of.  (E, m)."""
    away = epochs.y_m + (epochs.los_enu @ fit.x_m[..., None])[..., 0]
    out = np.zeros_like(away)
    for system in np.unique(epochs.system):
        own = epochs.system == system
        share = fit.clock_share[:, own]
        clock = (share * np.where(current.used[:, own], away[:, own], 0.0)).sum(-1)
        known = share.sum(-1) > 0.0
        out[:, own] = np.where(known[:, None], away[:, own] - clock[:, None], 0.0)
    return out


def danish(epochs: CodeEpochs, config: FamilyMonitorConfig) -> CodeEpochs:
    """Weights of Krarup: ``exp(1 - (v/c)^2)`` beyond c."""
    return _reweighted(epochs, config, lambda v, c: 1.0 / variance_factor(v, c.danish))


def huber(epochs: CodeEpochs, config: FamilyMonitorConfig) -> CodeEpochs:
    """Weights of Huber: ``k / |v|`` beyond k."""
    return _reweighted(epochs, config, lambda v, c: c.huber_k / np.maximum(np.abs(v), c.huber_k))


def igg3_weight(v: Array, k0: float, k1: float) -> Array:
    """``1`` up to k0, ``k0/|v| ((k1 - |v|) / (k1 - k0))^2`` up to k1, 0 beyond (IGG-III, Yang 1994).  (...,)."""
    size = np.abs(v)
    middle = k0 / np.maximum(size, k0) * np.square((k1 - np.minimum(size, k1)) / (k1 - k0))
    return np.where(size <= k0, 1.0, middle)


def igg3(epochs: CodeEpochs, config: FamilyMonitorConfig) -> CodeEpochs:
    """Weights of IGG-III, which leave out codes beyond k1."""
    return _reweighted(epochs, config, lambda v, c: igg3_weight(v, c.igg3_k0, c.igg3_k1))


REJECTIONS: dict[Rejection, Callable[[CodeEpochs, FamilyMonitorConfig], CodeEpochs]] = {
    Rejection.NONE: lambda epochs, config: epochs,
    Rejection.LOCAL_TEST: local_tests,
    Rejection.SEPARABLE: separable_tests,
    Rejection.SEPARATION: separation_tests,
    Rejection.RANSAC: ransac,
    Rejection.P_RANSAC: p_ransac,
    Rejection.DANISH: danish,
    Rejection.HUBER: huber,
    Rejection.IGG3: igg3,
}
