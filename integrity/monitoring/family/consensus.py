"""RANSAC and P-RANSAC: solutions of small subsets, judged by how many of the other codes agree with them (S3 [77]).

A subset has 4 codes of one system, and 1 more for each further system. With N codes of one system up to N - 5 faulty
ones can be told apart, because the right subset needs one more code that agrees; N - 4 is what may be left out.
"""

from __future__ import annotations

from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.streams import named_generator
from lanebound.integrity.monitoring.family.config import FamilyMonitorConfig
from lanebound.integrity.monitoring.family.epochs import MOST_SYSTEMS, CodeEpochs
from lanebound.integrity.monitoring.family.fit import CodeFit, solve_codes

__all__ = ["range_errors", "ransac"]

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
