"""Rates of misleading epochs that are too small for counting: in closed form, and by importance sampling.

Errors and separations of one epoch are independent, because a minimum-variance solution is uncorrelated with its
residuals. A fault of size ``f`` in satellite k is therefore misleading with the probability

    P(|x + f g_k| > PL) P(quiet | f) <= P(|x + f g_k| > PL) P(|t_k + f h_k| < threshold),

where ``g_k`` and ``h_k`` are the effects of 1 m on the error and on the separation of the satellite itself; the other
separations can only increase the detection. Levels must hold for any size. The default is therefore the size with the
largest product.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from lanebound.integrity.assessment.exceedance import AXES, LARGEST_FAULT
from lanebound.integrity.assessment.measurement_model import Form, Prepared

__all__ = [
    "DRAWN",
    "FaultSize",
    "expected_one_fault",
    "fault_chance",
    "importance_rates",
    "mean_and_deviation",
    "worst_fault",
]

Array = NDArray[np.float64]

DRAWN = ("no fault", "one fault")  # sampled strata; the others are bounded by their probability
GRID = 401  # sizes tried at first, a tenth of a sigma of the separation apart or closer
BEYOND = 4.0  # sigmas of the separation, past which no size can be the worst


class FaultSize(Enum):
    """Size of a simulated fault."""

    WORST = "worst"
    UNIFORM = "uniform"


def fault_chance(prepared: Prepared, axis: int, level_m: float, size_m: Array) -> Array:
    """Probability that a fault of ``size_m`` (n, ...) in each satellite is misleading, tested by its own separation."""
    column = (slice(None),) + (None,) * (size_m.ndim - 1)
    sigma = np.linalg.norm(prepared.error_rows[axis])
    error = prepared.shift[axis] + size_m * prepared.fault_error[:, axis][column]
    apart = np.abs(prepared.test_shift[column] + size_m * np.diag(prepared.fault_test)[column])
    beyond = ndtr((error - level_m) / sigma) + ndtr((-error - level_m) / sigma)
    return np.asarray(beyond * (ndtr(prepared.threshold - apart) - ndtr(-prepared.threshold - apart)))


def worst_fault(prepared: Prepared, axis: int, level_m: float) -> tuple[Array, Array]:
    """Size of a fault in each satellite with the largest misleading probability, and this probability.  (n,) [m], (n,).

    A grid of both signs is evaluated, then twice a finer grid around the best size. In the most likely misleading case
    the separation is at the threshold and the rest of the error is in the solution without the satellite; this limits
    the range of the grid.
    """
    unit = prepared.sigma_of_fault_m
    apart = np.abs(unit * prepared.fault_error[:, axis])
    left = np.maximum(level_m + np.abs(prepared.tolerant_shift[:, axis]) - prepared.threshold * apart, 0.0)
    square = (prepared.tolerant_rows[:, axis] ** 2).sum(-1)
    reach = prepared.threshold + np.abs(prepared.test_shift) + left * apart / square + BEYOND
    middle, half = np.zeros_like(reach), reach
    for points in (GRID, 41, 41):
        size = (middle[:, None] + half[:, None] * np.linspace(-1.0, 1.0, points)) * unit[:, None]
        chance = fault_chance(prepared, axis, level_m, size)
        best = chance.argmax(-1)
        middle = middle + half * np.linspace(-1.0, 1.0, points)[best]
        half = half * 2.0 / (points - 1)
    return middle * unit, np.asarray(chance.max(-1))


def expected_one_fault(prepared: Prepared, form: Form, sizes: FaultSize = FaultSize.WORST) -> Array:
    """Probability of a misleading fault in one satellite, along and across, in closed form.  (R, 2).

    The tests of the other satellites are ignored; the result is an upper bound, and 0 without a level.
    """
    out = np.zeros_like(prepared.levels_m[form])
    most = LARGEST_FAULT * prepared.threshold * prepared.sigma_of_fault_m
    share = (np.arange(GRID) + 0.5) / GRID * 2.0 - 1.0
    for (r, axis), level in np.ndenumerate(prepared.levels_m[form]):
        if not np.isfinite(level):
            continue
        if sizes is FaultSize.WORST:
            chance = worst_fault(prepared, axis, float(level))[1]
        else:
            chance = fault_chance(prepared, axis, float(level), most[:, None] * share).mean(-1)
        out[r, axis] = prepared.prior @ chance
    return out


def importance_rates(
    prepared: Prepared,
    form: Form,
    row: int,
    draws: int,
    generator: np.random.Generator,
    sizes: FaultSize = FaultSize.WORST,
) -> tuple[Array, Array]:
    """Rates of misleading epochs without a fault and with one, along and across, and their variances, (2, 2) each.

    In each stratum (no fault, each single fault) the errors are drawn around plus and minus the level, half of them on
    each side. The draws ``e`` are shifted by ``m`` along the gain of the solution (with a fault: of the solution
    without the faulty satellite), and have the weight ``phi(e) / (phi(e - m)/2 + phi(e + m)/2)``, at most 2.
    """
    level = prepared.levels_m[form][row]
    rate, variance = np.zeros((len(DRAWN), AXES)), np.zeros((len(DRAWN), AXES))
    alone, few = 1.0 - prepared.prior.sum(), max(draws // 8, 64)
    at_threshold = prepared.threshold * prepared.sigma_of_fault_m  # [m]
    for axis in range(AXES):
        away = level[axis] - abs(prepared.shift[axis])
        found = _weighted(prepared, prepared.error_rows[axis], away, axis, level[axis], draws, generator)
        rate[0, axis], variance[0, axis] = alone * found[0], alone**2 * found[1]
        worst = worst_fault(prepared, axis, float(level[axis]))[0] if sizes is FaultSize.WORST else None
        for k, prior in enumerate(prepared.prior):
            moved = abs(at_threshold[k] * prepared.fault_error[k, axis])
            away = level[axis] - moved - abs(prepared.tolerant_shift[k, axis])
            if worst is None:
                size = generator.uniform(-LARGEST_FAULT, LARGEST_FAULT, few) * at_threshold[k]
            else:
                size = np.full(few, worst[k])
            rows = prepared.tolerant_rows[k, axis]
            found = _weighted(prepared, rows, away, axis, level[axis], few, generator, k, size)
            rate[1, axis] += prior * found[0]
            variance[1, axis] += prior**2 * found[1]
    return rate, variance


def _weighted(
    prepared: Prepared,
    rows: Array,
    away_m: float,
    axis: int,
    level_m: float,
    draws: int,
    generator: np.random.Generator,
    faulty: int = 0,
    size_m: Array | None = None,
) -> tuple[float, float]:
    """Mean of one stratum and its variance, with errors of ``rows`` drawn around plus and minus ``away_m``."""
    mean = rows * (max(away_m, 0.0) / float(rows @ rows))
    side = np.where(np.arange(draws) % 2 == 0, 1.0, -1.0)
    normal = generator.standard_normal((draws, rows.size)) + side[:, None] * mean
    along = normal @ mean
    weight = np.exp(0.5 * mean @ mean - np.logaddexp(along, -along) + np.log(2.0))
    error = normal @ prepared.error_rows[axis] + prepared.shift[axis]
    statistic = normal @ prepared.test_rows.T + prepared.test_shift
    if size_m is not None:
        error += size_m * prepared.fault_error[faulty, axis]
        statistic += np.outer(size_m, prepared.fault_test[faulty])
    misleading = (np.abs(error) > level_m) & (np.abs(statistic).max(-1) < prepared.threshold)
    value = weight * misleading
    half = value.reshape(-1, 2).mean(-1)  # one draw on each side, as a stratified pair
    return float(half.mean()), float(half.var(ddof=1) / half.size)


def mean_and_deviation(rates: Sequence[Array], variances: Sequence[Array]) -> tuple[Array, Array, Array]:
    """Mean over cases, its standard deviation from the spread of cases, and that of the draws only.  (...,) each."""
    r, v = np.stack(rates), np.stack(variances)
    between = r.std(0, ddof=1) / np.sqrt(len(r)) if len(r) > 1 else np.sqrt(v.mean(0))
    return r.mean(0), between, np.sqrt(v.sum(0)) / len(r)
