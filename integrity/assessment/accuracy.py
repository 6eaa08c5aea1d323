"""Statistics of position errors by mode: median, RMSE, percentiles (S1 table 2, S3 II.A)."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lanebound.integrity.assessment.record import AXES, Record
from lanebound.integrity.core.errors import InputError, require_finite
from lanebound.integrity.positioning.modes import Mode

__all__ = ["AxisAccuracy", "accuracy_by_mode", "measure_accuracy", "mode_share"]


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
