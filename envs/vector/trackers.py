"""The poses that N egos drive by: what ``Tracker`` and the trust of ``Cockpit`` are for one, over arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.navigation import NavigationConfig
from lanebound.envs.vector.lanes_kernel import Lanes
from lanebound.envs.vector.trackers_kernel import TRACK, Fixes, begin_all, coast_all, settle_all, take_all
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.navigators.solution import Solution

__all__ = ["Trackers"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


class Trackers:
    """Estimated poses of N egos, with what a jump has left to be taken over.

    Parameters
    ----------
    config : what becomes of jumps
    count : number N of egos
    lanes : of their maps
    map_bound_m, limits_m : what levels have for the error of the map; alert limits along and across
    """

    def __init__(
        self, config: NavigationConfig, count: int, lanes: Lanes, map_bound_m: float, limits_m: tuple[float, float]
    ) -> None:
        self._lanes = lanes
        codes = [reason.code for reason in (AlertReason.BOTH, AlertReason.PL_AT, AlertReason.PL_CT)]
        self._figures = np.array([config.jump_m, config.smoothing_s, map_bound_m, *limits_m, *codes], dtype=np.float64)
        self.tracks = np.zeros((count, TRACK))

    def begin(self, rows: Rows, solution: Solution, vehicles: int, map_shift_m: Array, belief: Array) -> None:
        """Start at the first solution of an episode: of environments ``rows`` (n,) of so many vehicles, the ego first.

        map_shift_m (n, 2) : error of each ego's map
        """
        begin_all(rows, vehicles, _fixes(solution), map_shift_m, self.tracks, belief)
        self._settle(rows, 0.0, belief)

    def adopt(self, rows: Rows, other: Trackers) -> None:
        """Go on as the egos ``rows`` of other trackers do."""
        self.tracks[rows] = other.tracks[rows]

    def coast(self, rows: Rows, dt_s: float, belief: Array) -> None:
        """Carry the poses on by the last speeds and turn rates, between epochs."""
        coast_all(rows, dt_s, self.tracks)
        self._settle(rows, dt_s, belief)

    def take(
        self, rows: Rows, solution: Solution, vehicles: int, since_s: float, dt_s: float, belief: Array
    ) -> None:  # fmt: skip
        """New solutions of all environments, ``since_s`` after poses were carried on, ``dt_s`` after the last ones."""
        take_all(rows, vehicles, _fixes(solution), since_s, dt_s, self._figures, self.tracks, belief)
        self._settle(rows, since_s, belief)

    def _settle(self, rows: Rows, passed_s: float, belief: Array) -> None:
        settle_all(rows, self._lanes, passed_s, self._figures, self.tracks, belief)


def _fixes(solution: Solution) -> Fixes:
    return Fixes(*(getattr(solution, name) for name in Fixes._fields))
