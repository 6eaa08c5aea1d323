"""Input of an assessment (errors, levels, modes and alerts of a drive at each epoch), and its integrity events.

Events are by epoch and axis (S3 II.C): available, MI, HMI, integrity failure, false alert. With AL the alert limit and
PE the true error: available when ``PL <= AL``; MI when available and ``PL < PE <= AL``; HMI when available and ``PE >
AL``; integrity failure when ``PE > AL`` has lasted longer than the time to alert without any alarm.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lanebound.integrity.core.angles_kernel import ROUNDING_M
from lanebound.integrity.core.errors import InputError, require_finite, require_in_range
from lanebound.integrity.positioning.modes import Mode

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

Axis = Literal["at", "ct"]
AXES: tuple[Axis, Axis] = ("at", "ct")


@dataclass(frozen=True)
class Record:
    """Epochs of one vehicle, arrays (T,), or of B vehicles, arrays (T, B).

    Attributes
    ----------
    time_s : (T,) strictly increasing.
    mode : integer codes of :class:`~lanebound.integrity.positioning.modes.Mode`.
    error_at_m, error_ct_m : signed position error, estimate minus truth, along and across the track.
    pl_at_m, pl_ct_m : protection levels; ``inf`` for none.
    alert : there is an alert at this epoch.
    available : the position is declared available at this epoch.
    """

    time_s: Array
    mode: NDArray[np.integer[Any]]
    error_at_m: Array
    error_ct_m: Array
    pl_at_m: Array
    pl_ct_m: Array
    alert: Bools
    available: Bools

    def __post_init__(self) -> None:
        time = require_finite("time_s", self.time_s)
        if time.ndim != 1 or time.size == 0 or (np.diff(time) <= 0.0).any():
            raise InputError(f"time_s must be a strictly increasing (T,) array, got shape {time.shape}: sort it")
        shape = np.shape(self.error_at_m)
        for field in fields(self)[1:]:
            found = np.shape(getattr(self, field.name))
            if found != shape or found[:1] != time.shape or len(found) > 2:
                raise InputError(
                    f"{field.name} must have shape {shape} = (T,) or (T, B) with T = {time.size}, got {found}"
                )
        for name in ("error_at_m", "error_ct_m"):
            require_finite(name, getattr(self, name))
        for name in ("pl_at_m", "pl_ct_m"):
            if not (np.asarray(getattr(self, name)) >= 0.0).all():
                raise InputError(f"{name} must be non-negative (inf where there is none), got a negative or NaN entry")

    @property
    def epochs(self) -> int:
        """Number of vehicle epochs, T or T * B."""
        return int(np.size(self.error_at_m))

    @property
    def interval_s(self) -> float:
        """Median time between epochs [s]; 0 for a single epoch."""
        return float(np.median(np.diff(self.time_s))) if self.time_s.size > 1 else 0.0

    def by_epoch(self) -> tuple[Array, Array]:
        """Absolute errors and levels of all vehicle epochs on both axes.  (E, 2) each."""
        error, pl = (np.stack([np.ravel(of(axis)) for axis in AXES], -1) for of in (self.error, self.pl))
        return error, pl

    def error(self, axis: Axis) -> Array:
        """Absolute error of an axis, ``"at"`` or ``"ct"`` [m]."""
        return np.asarray(np.abs(getattr(self, f"error_{_checked(axis)}_m")))

    def pl(self, axis: Axis) -> Array:
        """Protection level of an axis, ``"at"`` or ``"ct"`` [m]."""
        return np.asarray(getattr(self, f"pl_{_checked(axis)}_m"))

    def modes_present(self) -> list[Mode]:
        """The modes that occur, in order of preference, without ``NONE``."""
        return [mode for mode in Mode if mode is not Mode.NONE and bool((self.mode == mode).any())]


def _checked(axis: Axis) -> Axis:
    if axis not in AXES:
        raise InputError(f"axis must be 'at' or 'ct', got {axis!r}")
    return axis


EPS_S = 1e-9  # ages are sums of epoch intervals


class Zone(IntEnum):
    """Zones of the Stanford diagram (S3 Fig. 4)."""

    NOMINAL = 0
    MISLEADING = 1
    HAZARDOUS = 2
    UNAVAILABLE = 3
    UNAVAILABLE_MISLEADING = 4

    @property
    def label(self) -> str:
        """Short description of the zone."""
        return _ZONE_LABELS[self]


_ZONE_LABELS = {
    Zone.NOMINAL: "nominal operation",
    Zone.MISLEADING: "misleading information",
    Zone.HAZARDOUS: "hazardously misleading",
    Zone.UNAVAILABLE: "system unavailable",
    Zone.UNAVAILABLE_MISLEADING: "unavailable, misleading",
}


def classify(error_m: ArrayLike, pl_m: ArrayLike, al_m: float) -> NDArray[np.int64]:
    """Classify errors and protection levels (...,) [m] into zones (...,); PE = PL is nominal, PL = inf unavailable.

    An error beyond its level or limit by no more than rounding (ROUNDING_M) equals it.
    """
    al = float(require_in_range("al_m", al_m, 0.0, np.inf, low_open=True, high_open=True))
    pe, pl = np.abs(np.asarray(error_m, dtype=np.float64)) - ROUNDING_M, np.asarray(pl_m, dtype=np.float64)
    unavailable = np.where(pe > pl, Zone.UNAVAILABLE_MISLEADING, Zone.UNAVAILABLE)
    available = np.where(pe > al, Zone.HAZARDOUS, np.where(pe > pl, Zone.MISLEADING, Zone.NOMINAL))
    return np.where(pl <= al, available, unavailable).astype(np.int64)


@dataclass(frozen=True)
class AxisEvents:
    """Events of one axis, bool arrays (T,) or (T, B) as in the record.

    Attributes
    ----------
    available : ``PL <= AL`` and the position is declared available.
    mi, hmi : misleading and hazardously misleading information.
    failure : positioning failure, ``PE > AL``, with or without an alert.
    integrity_failure : the failure has lasted longer than the TTA and no alarm has been raised since its onset.
    false_alert : an alert without a positioning failure on this axis.
    """

    available: Bools
    mi: Bools
    hmi: Bools
    failure: Bools
    integrity_failure: Bools
    false_alert: Bools

    def counts(self) -> dict[str, int]:
        """Number of epochs with each event, and under ``..._events`` the number of uninterrupted runs."""
        named = {name: getattr(self, name) for name in ("available", "mi", "hmi", "failure", "integrity_failure")}
        named["false_alert"] = self.false_alert
        epochs = {name: int(mask.sum()) for name, mask in named.items()}
        return epochs | {f"{name}_events": _runs(mask) for name, mask in named.items() if name != "available"}

    def rates(self) -> dict[str, float]:
        """Share of epochs with each event."""
        total = self.available.size
        return {name: count / total for name, count in self.counts().items() if not name.endswith("_events")}


@dataclass(frozen=True)
class Events:
    """Events of both axes; an epoch of a vehicle is misleading if one of the axes is misleading."""

    at: AxisEvents
    ct: AxisEvents
    time_to_alert_s: float

    @property
    def mi(self) -> Bools:
        """Misleading on one axis or both, and hazardous on neither."""
        return np.asarray((self.at.mi | self.ct.mi) & ~self.hmi)

    @property
    def hmi(self) -> Bools:
        """Hazardously misleading on either axis."""
        return np.asarray(self.at.hmi | self.ct.hmi)

    @property
    def available(self) -> Bools:
        """Available on both axes."""
        return np.asarray(self.at.available & self.ct.available)

    @property
    def integrity_failure(self) -> Bools:
        """Integrity failure on either axis."""
        return np.asarray(self.at.integrity_failure | self.ct.integrity_failure)

    @property
    def false_alert(self) -> Bools:
        """An alert although both axes are within their limits."""
        return np.asarray(self.at.false_alert & self.ct.false_alert)

    def summary(self) -> dict[str, Any]:
        """Counts and rates of each axis and of both, as JSON data."""
        axes: dict[str, Any] = {
            axis: {"counts": e.counts(), "rates": e.rates()} for axis, e in zip(AXES, (self.at, self.ct), strict=True)
        }
        both = {name: float(getattr(self, name).mean()) for name in ("available", "mi", "hmi", "integrity_failure")}
        both["false_alert"] = float(self.false_alert.mean())
        return {**axes, "either": both, "time_to_alert_s": self.time_to_alert_s}


def find_events(record: Record, al_at_m: float, al_ct_m: float, time_to_alert_s: float = 1.0) -> Events:
    """Find all events of a record on both axes (S3 II.C); alert limits [m], time to alert [s]."""
    tta = float(require_in_range("time_to_alert_s", time_to_alert_s, 0.0, np.inf, high_open=True))
    at, ct = (_axis_events(record, axis, al, tta) for axis, al in zip(AXES, (al_at_m, al_ct_m), strict=True))
    return Events(at, ct, tta)


def _axis_events(record: Record, axis: Axis, al_m: float, tta_s: float) -> AxisEvents:
    zone = classify(record.error(axis), record.pl(axis), al_m)
    declared, alert = np.asarray(record.available, dtype=np.bool_), np.asarray(record.alert, dtype=np.bool_)
    failure = record.error(axis) > al_m + ROUNDING_M
    overdue = running_age_s(record.time_s, failure) > tta_s + EPS_S
    return AxisEvents(
        available=(zone <= Zone.HAZARDOUS) & declared,
        mi=(zone == Zone.MISLEADING) & declared,
        hmi=(zone == Zone.HAZARDOUS) & declared,
        failure=failure,
        integrity_failure=overdue & ~_true_since_onset(failure, alert),
        false_alert=alert & ~failure,
    )


def running_age_s(time_s: Array, active: Bools) -> Array:
    """Time since the start of the current run of ``active`` [s], -1 outside runs.  (T,), (T, ...) -> (T, ...)."""
    start = _run_start(active)
    time = np.asarray(time_s, dtype=np.float64)
    now = time.reshape((-1,) + (1,) * (active.ndim - 1))
    return np.where(active, now - time[start], -1.0)


def _run_start(active: Bools) -> NDArray[np.int64]:
    """Index of the first epoch of the run of each active epoch (undefined outside runs)."""
    begins = active.copy()
    begins[1:] &= ~active[:-1]
    index = np.arange(active.shape[0]).reshape((-1,) + (1,) * (active.ndim - 1))
    return np.asarray(np.maximum.accumulate(np.where(begins, index, 0), axis=0))


def _true_since_onset(active: Bools, signal: Bools) -> Bools:
    """Whether ``signal`` has been true at any epoch since the start of the current run of ``active``."""
    total = np.cumsum(signal, axis=0)
    before = np.concatenate([np.zeros_like(total[:1]), total[:-1]])
    return np.asarray(active & (total > np.take_along_axis(before, _run_start(active), axis=0)))


def _runs(mask: Bools) -> int:
    """Number of uninterrupted runs of True along the first axis."""
    begins = mask.copy()
    begins[1:] &= ~mask[:-1]
    return int(begins.sum())


def alert_delays(time_s: Array, alert: Bools, onset_s: ArrayLike, until_s: ArrayLike | None = None) -> Array:
    """Time from the onset of each fault to the first alert at or after it, ``inf`` without an alert until ``until_s``.

    time_s (T,), alert (T,), onset_s (F,) -> (F,) [s]. An alert that is active at the onset has delay 0.

    Raises
    ------
    InputError
        ``alert`` is not (T,).
    """
    time, on = np.asarray(time_s, dtype=np.float64), np.asarray(alert, dtype=np.bool_)
    if on.shape != time.shape:
        raise InputError(f"alert must have shape {time.shape} like time_s, got {on.shape}: pass one vehicle at a time")
    onset = np.atleast_1d(np.asarray(onset_s, dtype=np.float64))
    until = np.broadcast_to(np.inf if until_s is None else np.asarray(until_s, dtype=np.float64), onset.shape)
    at = np.append(time[on], np.inf)
    first = at[np.searchsorted(at, onset - EPS_S)]
    return np.where(first <= until, np.maximum(first - onset, 0.0), np.inf)
