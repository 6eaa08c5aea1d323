"""Input of an assessment: errors, protection levels, modes and alerts of a drive at each epoch."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.errors import InputError, require_finite
from lanebound.integrity.positioning.modes import Mode

__all__ = ["AXES", "Axis", "Record"]

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
