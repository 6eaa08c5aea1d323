"""The poses that N egos drive by: what ``Tracker`` and the trust of ``Cockpit`` are for one, over arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.navigation import NavigationConfig
from lanebound.envs.records import heading_of, xy_of
from lanebound.envs.tracker import ACCELERATION_S, STANDSTILL_MPS
from lanebound.envs.vector import columns_kernel as k
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.solution import Solution

__all__ = ["Trackers"]

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


def _wrapped(angle: Array) -> Array:
    """The angle in [-pi, pi], as ``math.remainder`` has it."""
    return angle - 2.0 * np.pi * np.round(angle / (2.0 * np.pi))


class Trackers:
    """Estimated poses of N egos, with what a jump has left to be taken over.

    Attributes
    ----------
    map_shift_m : (N, 2) error of each ego's map
    """

    def __init__(self, config: NavigationConfig, count: int, map_bound_m: float, limits_m: tuple[float, float]) -> None:
        self._config, self._map_bound_m, self._limits_m = config, map_bound_m, np.array(limits_m)
        self.map_shift_m = np.zeros((count, 2))
        self._solution_m, self._residual_m = np.zeros((2, count, 2))
        self._heading_rad, self._yaw_rate, self._acceleration = np.zeros((3, count))
        self._fix_heading, self._fix_speed = np.zeros((2, count))
        self._levels_m = np.zeros((count, 2))
        self._alert, self._available = np.zeros((2, count), dtype=np.bool_)
        self._reason = np.zeros(count, dtype=np.int64)

    def begin(self, rows: Rows, solution: Solution, map_shift_m: Array) -> None:
        """Start at the first solution (n rows) of an episode."""
        self.map_shift_m[rows] = map_shift_m
        self._residual_m[rows] = 0.0
        self._yaw_rate[rows] = self._acceleration[rows] = 0.0
        self._solution_m[rows] = xy_of(solution.position_en_m)
        self._heading_rad[rows] = _heading(solution)
        self._keep(rows, solution)

    def adopt(self, rows: Rows, other: Trackers) -> None:
        """Go on as the egos ``rows`` of other trackers do."""
        for mine, theirs in zip(self._arrays, other._arrays, strict=True):
            mine[rows] = theirs[rows]

    @property
    def _arrays(self) -> tuple[NDArray[Any], ...]:
        return (
            self.map_shift_m, self._solution_m, self._residual_m, self._heading_rad, self._yaw_rate,
            self._acceleration, self._fix_heading, self._fix_speed, self._levels_m, self._alert, self._available,
            self._reason,
        )  # fmt: skip

    def coast(self, rows: Rows, dt_s: float) -> None:
        """Carry the poses on by the last speeds and turn rates, between epochs."""
        turned = dt_s * self._yaw_rate[rows]
        middle = self._heading_rad[rows] + 0.5 * turned
        way = dt_s * self._fix_speed[rows]
        self._solution_m[rows] += way[:, None] * np.stack([np.cos(middle), np.sin(middle)], -1)
        self._heading_rad[rows] += turned

    def take(self, rows: Rows, solution: Solution, since_s: float, dt_s: float) -> None:
        """New solutions (n rows), ``since_s`` after the poses were last carried on, ``dt_s`` after the last ones."""
        start, c = self._heading_rad[rows], self._config
        self.coast(rows, since_s)
        jump = xy_of(solution.position_en_m) - self._solution_m[rows]
        far = np.hypot(jump[:, 0], jump[:, 1]) > c.jump_m
        fade = np.exp(-dt_s / c.smoothing_s) if c.smoothing_s > 0.0 else 0.0
        self._residual_m[rows] = fade * np.where(far[:, None], self._residual_m[rows] - jump, self._residual_m[rows])
        heading, speed = _heading(solution), solution.speed_mps
        turn = _wrapped(heading - self._fix_heading[rows])
        self._yaw_rate[rows] = np.where(np.abs(speed) > STANDSTILL_MPS, turn / dt_s, 0.0)
        share, rate = 1.0 - np.exp(-dt_s / ACCELERATION_S), (speed - self._fix_speed[rows]) / dt_s
        self._acceleration[rows] += share * (rate - self._acceleration[rows])
        self._solution_m[rows] = xy_of(solution.position_en_m)
        self._heading_rad[rows] = start + _wrapped(heading - start)
        self._keep(rows, solution)

    def _keep(self, rows: Rows, s: Solution) -> None:
        """What the newest solutions say beside the pose."""
        self._fix_heading[rows], self._fix_speed[rows] = _heading(s), s.speed_mps
        self._levels_m[rows, 0], self._levels_m[rows, 1] = s.pl_at_m, s.pl_ct_m
        self._alert[rows], self._available[rows], self._reason[rows] = s.alert, s.available, s.reason

    def place(self, rows: Rows, belief: Array) -> None:
        """Write the poses into ``belief`` (N, BELIEF)."""
        pose = self._solution_m[rows] + self._residual_m[rows] + self.map_shift_m[rows]
        belief[rows, k.B_X], belief[rows, k.B_Y] = pose.T
        belief[rows, k.B_HEADING], belief[rows, k.B_SPEED] = self._heading_rad[rows], self._fix_speed[rows]
        belief[rows, k.B_YAW_RATE], belief[rows, k.B_ACCELERATION] = self._yaw_rate[rows], self._acceleration[rows]

    def trust(self, rows: Rows, belief: Array) -> None:
        """Write levels and alert of the poses: the solution's, what has not faded and the map's; then the reasons."""
        s, c = np.sin(self._heading_rad[rows]), np.cos(self._heading_rad[rows])
        x, y = self._residual_m[rows].T
        left = np.stack([np.abs(c * x + s * y), np.abs(c * y - s * x)], -1) + self._map_bound_m
        levels = self._levels_m[rows] + left
        over_at, over_ct = (levels > self._limits_m).T
        over, alert = over_at | over_ct, self._alert[rows]
        own = np.where(over_at & over_ct, AlertReason.BOTH.code, np.where(over_at, AlertReason.PL_AT.code, 0))
        own = np.where(over_ct & ~over_at, AlertReason.PL_CT.code, own)
        belief[rows, k.B_PL_AT], belief[rows, k.B_PL_CT] = levels.T
        belief[rows, k.B_AVAILABLE], belief[rows, k.B_ALERT] = self._available[rows] & ~over, alert | over
        belief[rows, k.B_REASON] = np.where(over & ~alert, own, self._reason[rows])


def _heading(solution: Solution) -> Array:
    """Headings in the plane, in [-pi, pi)."""
    heading: Array = (heading_of(solution.heading_rad) + np.pi) % (2.0 * np.pi) - np.pi
    return heading
