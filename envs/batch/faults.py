"""The faults of N episodes side by side: each schedule goes by the clock of its own episode."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.sensors.effects import FaultEffects
from lanebound.integrity.sensors.faults import FaultSchedule, add_effects
from lanebound.integrity.sky.view import SkyView

__all__ = ["NO_FAULTS", "EpisodeFaults"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
NO_FAULTS = FaultSchedule()


class EpisodeFaults:
    """Schedules of N environments; their effects have the bits of those of N single environments.

    Attributes
    ----------
    schedules : (N) in the times of the episodes' clocks
    """

    def __init__(self, count: int) -> None:
        self.schedules = [NO_FAULTS] * count
        self._span_s = np.array([NO_FAULTS.span_s] * count)  # (N, 2), so that most epochs look at no schedule

    def put(self, row: int, schedule: FaultSchedule) -> None:
        """Give an environment other faults."""
        self.schedules[row], self._span_s[row] = schedule, schedule.span_s

    def adopt(self, rows: Rows, other: EpisodeFaults, theirs: Rows) -> None:
        """Take over the faults of the environments ``theirs`` (n,) of others in ``rows`` (n,)."""
        for row, their in zip(rows.tolist(), theirs.tolist(), strict=True):
            self.put(row, other.schedules[their])

    def effects(
        self, clock_s: Array, dt_s: float, vehicles: int, sky_over: Callable[[int], SkyView]
    ) -> FaultEffects | None:  # fmt: skip
        """Effects on N M vehicles in the epochs of length ``dt_s`` that end now; None where no fault acts.

        clock_s (N,) of the episodes; vehicles: M; sky_over: the sky of an environment over its M vehicles.
        """
        near = np.flatnonzero((self._span_s[:, 0] < clock_s) & (clock_s <= self._span_s[:, 1]))
        effects = None
        for e, time_s in zip(near.tolist(), clock_s[near].tolist(), strict=True):
            acting = self.schedules[e].active(time_s)
            if not acting:
                continue
            sky, rows = sky_over(e), slice(e * vehicles, (e + 1) * vehicles)
            if effects is None:
                effects = FaultEffects.blank(clock_s.size * vehicles, sky.satellites)
            own = FaultEffects(effects.signals[rows], effects.vehicles[rows])  # views: changes are in ``effects``
            add_effects(own, acting, time_s, dt_s, sky)
        return effects
