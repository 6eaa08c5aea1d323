"""Assessment of a drive: how levels bound errors, errors by mode, availability, outages.

Exceedance rates have exact intervals. Errors are medians, RMSE and percentiles (S1 table 2, S3 II.A).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import bdtrc, betaincinv

from lanebound.integrity.assessment.plotting import count_zones
from lanebound.integrity.assessment.record import AXES, Record, find_events
from lanebound.integrity.core.errors import InputError, require_finite, require_in_range, require_probability
from lanebound.integrity.positioning.modes import Mode

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

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


def bounding_by_axis(error_m: Array, pl_m: Array) -> dict[str, dict[str, Any]]:
    """``{"at": {...}, "ct": {...}}`` of errors and levels (..., 2) on both axes, as JSON data."""
    return {axis: asdict(measure_bounding(error_m[..., q], pl_m[..., q])) for q, axis in enumerate(AXES)}


def bounding_by_mode(record: Record) -> dict[str, dict[str, dict[str, Any]]]:
    """``{mode key: {"at": {...}, "ct": {...}}}`` for the modes that occur, as JSON data."""
    return {
        mode.key: bounding_by_axis(*(values[keep] for values in record.by_epoch()))
        for mode in record.modes_present()
        for keep in [np.ravel(record.mode == mode)]
    }


def assess(record: Record, al_at_m: float, al_ct_m: float, time_to_alert_s: float = 1.0) -> dict[str, Any]:
    """Compute all statistics of a record as JSON data: shares, accuracy, bounding, availability, events, zones."""
    limits = zip(AXES, (al_at_m, al_ct_m), strict=True)
    return {
        "epochs": record.epochs,
        "alert_limit": {"at_m": al_at_m, "ct_m": al_ct_m},
        "mode_share": mode_share(record),
        "accuracy": accuracy_by_mode(record),
        "bounding": bounding_by_mode(record),
        "availability": availability_by_mode(record, al_at_m, al_ct_m),
        "integrity_outages": find_outages(integrity_available(record, al_at_m, al_ct_m), record.time_s).summary(),
        "rtk_outages": find_outages(record.mode == Mode.RTK, record.time_s).summary(),
        "events": find_events(record, al_at_m, al_ct_m, time_to_alert_s).summary(),
        "stanford": {axis: count_zones(record, axis, al).to_dict() for axis, al in limits},
    }


def integrity_available(record: Record, al_at_m: float, al_ct_m: float) -> Bools:
    """Whether ``PL <= AL`` on both axes (S3 II.B), with the shape of the record."""
    limits = (al_at_m, al_ct_m)
    for axis, limit in zip(AXES, limits, strict=True):
        require_in_range(f"al_{axis}_m", limit, 0.0, np.inf, low_open=True, high_open=True)
    at, ct = (record.pl(axis) <= limit for axis, limit in zip(AXES, limits, strict=True))
    return np.asarray(at & ct)


def availability_by_mode(record: Record, al_at_m: float, al_ct_m: float) -> dict[str, float]:
    """Share of available epochs in each occurring mode, by key, and in ``all`` epochs (also those without solution)."""
    usable = integrity_available(record, al_at_m, al_ct_m)
    shares = {mode.key: float(usable[record.mode == mode].mean()) for mode in record.modes_present()}
    return {**shares, "all": float(usable.mean())}


@dataclass(frozen=True)
class Outages:
    """Uninterrupted intervals without service: start [s] and length [s], both (R,), of all vehicles."""

    start_s: Array
    length_s: Array

    def summary(self) -> dict[str, Any]:
        """Number, and shortest, median, longest and total length [s], as JSON data; 0 without outages."""
        length = self.length_s if self.length_s.size else np.zeros(1)
        return {
            "count": int(self.length_s.size),
            "min_s": float(length.min()),
            "median_s": float(np.median(length)),
            "max_s": float(length.max()),
            "total_s": float(self.length_s.sum()),
        }


def find_outages(service: ArrayLike, time_s: ArrayLike) -> Outages:
    """Find intervals in which ``service`` is False; epoch i represents the time from epoch i to i + 1.

    service (T,) or (T, B), time_s (T,). In an outage at the end, the last epoch has the length of a median interval.

    >>> find_outages([True, False, False, True], [0.0, 0.5, 1.0, 1.5]).length_s
    array([1.])
    """
    on, time = np.asarray(service, dtype=np.bool_), np.asarray(time_s, dtype=np.float64)
    interval = float(np.median(np.diff(time))) if time.size > 1 else 0.0
    edges = np.append(time, time[-1] + interval)
    off = ~on.reshape(time.size, -1)
    padded = np.zeros((time.size + 2, off.shape[1]), dtype=np.int8)
    padded[1:-1] = off
    change = np.diff(padded, axis=0)
    _, first = np.nonzero(change.T == 1)
    _, after = np.nonzero(change.T == -1)
    return Outages(edges[first], edges[after] - edges[first])


@dataclass(frozen=True)
class AxisAccuracy:
    """Statistics of an error [m] over ``epochs``; percentiles are of its absolute value (CEN 16803: 50, 75, 95 %)."""

    epochs: int
    median_m: float
    p75_m: float
    p95_m: float
    rmse_m: float
    mean_m: float
    max_m: float


def measure_accuracy(error_m: ArrayLike) -> AxisAccuracy:
    """Compute statistics of signed errors of any shape.

    Raises
    ------
    InputError
        There are no errors, or an error is not finite.
    """
    error = require_finite("error_m", error_m).ravel()
    if error.size == 0:
        raise InputError("error_m must have at least one entry, got none: select a mode that occurs")
    p50, p75, p95 = np.percentile(np.abs(error), [50.0, 75.0, 95.0])
    rmse = np.sqrt(np.mean(error**2))
    figures = (float(v) for v in (p50, p75, p95, rmse, error.mean(), np.abs(error).max()))
    return AxisAccuracy(error.size, *figures)


def accuracy_by_mode(record: Record) -> dict[str, dict[str, dict[str, Any]]]:
    """``{mode key or "all": {"at": {...}, "ct": {...}}}``; modes that do not occur are left out; JSON data."""
    selections = {mode.key: record.mode == mode for mode in record.modes_present()}
    positioned = record.mode != Mode.NONE
    if positioned.any():
        selections["all"] = positioned
    return {
        key: {axis: asdict(measure_accuracy(getattr(record, f"error_{axis}_m")[mask])) for axis in AXES}
        for key, mask in selections.items()
    }


def mode_share(record: Record) -> dict[str, float]:
    """Share of the epochs in each mode, by key; the sum is 1."""
    return {mode.key: float((record.mode == mode).mean()) for mode in Mode}
