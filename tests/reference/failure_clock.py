"""Integrity failures epoch by epoch: the reference of ``find_events``, which sees a whole drive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.assessment.record import EPS_S

__all__ = ["FailureClock"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass
class FailureClock:
    """Detection of integrity failures epoch by epoch, during a simulation.

    Attributes
    ----------
    age_s : (B,) time since the onset of the current positioning failure, -1 without failure [s].
    tta_s : (B,) time from this onset to the alert, ``inf`` without an alert [s].
    """

    age_s: Array
    tta_s: Array

    @classmethod
    def initial(cls, vehicles: int) -> FailureClock:
        """The state without failures."""
        return cls(np.full(vehicles, -1.0), np.full(vehicles, np.inf))

    def copy(self) -> FailureClock:
        """An independent copy."""
        return FailureClock(self.age_s.copy(), self.tta_s.copy())

    def advance(self, failure: Bools, alert: Bools, dt_s: float, time_to_alert_s: float) -> Bools:
        """Advance in place by one epoch; returns whether each vehicle has an integrity failure (B,)."""
        continued = failure & (self.age_s >= 0.0)
        self.age_s[:] = np.where(failure, np.where(continued, self.age_s + dt_s, 0.0), -1.0)
        no_alert = ~(continued & (self.tta_s < np.inf))
        self.tta_s[:] = np.where(failure & alert & no_alert, self.age_s, np.where(no_alert, np.inf, self.tta_s))
        return np.asarray(failure & (self.tta_s == np.inf) & (self.age_s > time_to_alert_s + EPS_S))
