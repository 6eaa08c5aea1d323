"""Errors, protection levels and alert limits of the last seconds, for the strip charts."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Tape", "Trace"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trace:
    """Series of equal length T, oldest first; levels may be inf. ``alert`` is (T,) bool, the rest (T,) float."""

    time_s: Array
    err_at_m: Array
    pl_at_m: Array
    al_at_m: Array
    err_ct_m: Array
    pl_ct_m: Array
    al_ct_m: Array
    alert: NDArray[np.bool_]

    def __len__(self) -> int:
        return int(self.time_s.shape[0])

    @classmethod
    def empty(cls) -> Trace:
        """A trace without epochs."""
        return _trace(np.zeros((8, 0)))


class Tape:
    """Record of the epochs of the last ``window_s``."""

    def __init__(self, window_s: float = 30.0) -> None:
        self.window_s = window_s
        self._rows: deque[tuple[float, ...]] = deque()

    def clear(self) -> None:
        """Delete all epochs, at a reset."""
        self._rows.clear()

    def add(
        self,
        time_s: float,
        *,
        err_at_m: float,
        pl_at_m: float,
        al_at_m: float,
        err_ct_m: float,
        pl_ct_m: float,
        al_ct_m: float,
        alert: bool,
    ) -> None:
        """Append one epoch; errors may be signed."""
        self._rows.append((time_s, err_at_m, pl_at_m, al_at_m, err_ct_m, pl_ct_m, al_ct_m, float(alert)))
        while self._rows[0][0] < time_s - self.window_s:
            self._rows.popleft()

    @property
    def trace(self) -> Trace:
        """The recorded epochs."""
        if not self._rows:
            return Trace.empty()
        return _trace(np.array(self._rows, dtype=np.float64).T)


def _trace(columns: Array) -> Trace:
    """The series by row, in the order of the fields."""
    time, err_at, pl_at, al_at, err_ct, pl_ct, al_ct, alert = columns
    return Trace(time, err_at, pl_at, al_at, err_ct, pl_ct, al_ct, alert > 0.5)
