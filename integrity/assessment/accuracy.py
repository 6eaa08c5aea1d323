"""Assessment of a drive: position errors by mode (median, RMSE, percentiles; S1 table 2, S3 II.A), availability,
outages.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.assessment.bounding import bounding_by_mode
from lanebound.integrity.assessment.events import find_events
from lanebound.integrity.assessment.record import AXES, Record
from lanebound.integrity.assessment.stanford import count_zones
from lanebound.integrity.core.errors import InputError, require_finite, require_in_range
from lanebound.integrity.positioning.modes import Mode

__all__ = [
    "AxisAccuracy",
    "Outages",
    "accuracy_by_mode",
    "assess",
    "availability_by_mode",
    "find_outages",
    "integrity_available",
    "measure_accuracy",
    "mode_share",
]


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


Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


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
