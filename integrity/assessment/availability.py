"""Availability and outages of the position."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.assessment.record import AXES, Record
from lanebound.integrity.core.errors import require_in_range

__all__ = ["Outages", "availability_by_mode", "find_outages", "integrity_available"]

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
