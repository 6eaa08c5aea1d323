"""Bounding of errors by protection levels: exceedance rates with exact intervals, and ratios of level and error."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import bdtrc, betaincinv

from lanebound.integrity.assessment.record import AXES, Axis, Record
from lanebound.integrity.core.errors import InputError, require_probability

__all__ = ["Bounding", "bounding_by_mode", "clopper_pearson", "doubt", "measure_bounding"]

RATIO_QUANTILES = (0.001, 0.01, 0.05, 0.5)
FEWEST, BY_CHANCE = 2, 1e-3  # exceedances that show anything, and their probability at the declared risk


def clopper_pearson(events: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Exact two-sided confidence interval of a probability after ``events`` in ``trials`` (Clopper and Pearson 1934).

    ``B(a/2; k, n - k + 1)`` and ``B(1 - a/2; k + 1, n - k)``, B the quantile of the beta distribution. Trials are
    assumed independent; for epochs within the correlation time of the errors the interval is too narrow.

    Raises
    ------
    InputError
        ``events`` is outside [0, trials], there are no trials, or the confidence is outside (0, 1).
    """
    require_probability("confidence", confidence)
    if trials < 1 or not 0 <= events <= trials:
        raise InputError(
            f"events must lie in [0, trials] with trials >= 1, got {events} of {trials}: correct the counts"
        )
    tail = 0.5 * (1.0 - confidence)
    low = float(betaincinv(events, trials - events + 1, tail)) if events > 0 else 0.0
    high = float(betaincinv(events + 1, trials - events, 1.0 - tail)) if events < trials else 1.0
    return low, high


@dataclass(frozen=True)
class Bounding:
    """Rate of ``|error| > PL`` with its interval, and quantiles of ``PL / |error|`` (1 and more: bounded).

    ``pl_median_m`` is None if less than half of the epochs have a protection level. A missing level is an infinite
    ratio; infinite ratios are given as None.
    """

    epochs: int
    exceeded: int
    rate: float
    rate_low: float
    rate_high: float
    pl_median_m: float | None
    ratio_min: float | None
    ratio_quantiles: dict[str, float | None]


def measure_bounding(error_m: ArrayLike, pl_m: ArrayLike, confidence: float = 0.95) -> Bounding:
    """Measure the bounding of errors by protection levels, arrays of the same shape [m].

    Raises
    ------
    InputError
        There are no epochs, or the shapes differ.
    """
    error, pl = np.abs(np.asarray(error_m, dtype=np.float64)), np.asarray(pl_m, dtype=np.float64)
    if error.shape != pl.shape or error.size == 0:
        raise InputError(
            f"error_m and pl_m must have one non-empty shape, got {error.shape} and {pl.shape}: align them"
        )
    exceeded = int((error > pl).sum())
    ratio = pl / np.maximum(error, np.finfo(np.float64).tiny)
    ratio = np.where(np.isfinite(ratio), ratio, np.inf)
    quantiles = np.quantile(ratio, RATIO_QUANTILES, method="lower")
    return Bounding(
        error.size,
        exceeded,
        exceeded / error.size,
        *clopper_pearson(exceeded, error.size, confidence),
        _finite(float(np.quantile(pl, 0.5, method="lower"))),
        _finite(float(ratio.min())),
        {f"{q:g}": _finite(float(v)) for q, v in zip(RATIO_QUANTILES, quantiles, strict=True)},
    )


def doubt(risk: float, error_m: ArrayLike, pl_m: ArrayLike, of: str) -> str | None:
    """Words where errors (N, ...) exceed their levels [m] in far more of the N cases than at a risk; else None.

    A case counts once if any of its errors exceeds. The tail of the binomial distribution must be below BY_CHANCE.
    """
    over = np.abs(np.asarray(error_m, dtype=np.float64)) > np.asarray(pl_m, dtype=np.float64)
    cases = len(over)
    found = int(over.reshape(cases, -1).any(1).sum())
    if found < FEWEST or bdtrc(found - 1, cases, risk) >= BY_CHANCE:
        return None
    return (
        f"errors exceed their levels in {found} of {cases} {of}, at a risk of {risk:g}: the recording or the declared "
        "sensor errors are to be doubted"
    )


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def bounding_by_mode(record: Record) -> dict[str, dict[Axis, dict[str, Any]]]:
    """``{mode key: {"at": {...}, "ct": {...}}}`` for the modes that occur, as JSON data."""
    return {
        mode.key: {axis: asdict(measure_bounding(record.error(axis)[keep], record.pl(axis)[keep])) for axis in AXES}
        for mode in record.modes_present()
        for keep in [record.mode == mode]
    }
