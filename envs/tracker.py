"""The pose that the ego drives by: the solution, carried on between epochs, its jumps taken over smoothly."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.navigation import Fix, NavigationConfig

__all__ = ["Tracker"]

Array = NDArray[np.float64]
ACCELERATION_S = 0.3  # time constant of the acceleration shown: ten odometer pulses at 10 m/s
STANDSTILL_MPS = 0.05


class Tracker:
    """Estimated pose and its derivatives.

    A correction longer than ``jump_m`` (a re-fix after an outage) goes into ``residual_m``, which then fades: the pose
    stays continuous, and its protection level is the solution's plus what has not yet faded.

    Attributes
    ----------
    fix : the newest solution
    position_m, heading_rad : of the pose
    residual_m : (2,) pose less solution and map shift
    """

    def __init__(self, config: NavigationConfig, map_shift_m: Array, fix: Fix) -> None:
        self.config, self.map_shift_m, self.fix = config, map_shift_m, fix
        self.residual_m = np.zeros(2)
        self.yaw_rate_radps = self.acceleration_mps2 = 0.0
        self._solution_m, self.heading_rad = fix.position_m.copy(), fix.heading_rad

    @property
    def position_m(self) -> Array:
        """(2,) where the ego is on its map, to the best of its belief."""
        return np.asarray(self._solution_m + self.residual_m + self.map_shift_m)

    def coast(self, dt_s: float) -> None:
        """Carry the pose on by the last speed and turn rate, between epochs."""
        middle = self.heading_rad + 0.5 * dt_s * self.yaw_rate_radps
        self._solution_m = self._solution_m + dt_s * self.fix.speed_mps * np.array([math.cos(middle), math.sin(middle)])
        self.heading_rad += dt_s * self.yaw_rate_radps

    def take(self, fix: Fix, since_s: float, dt_s: float) -> None:
        """A new solution, ``since_s`` after the pose was last carried on and ``dt_s`` after the last solution."""
        before, start = self.fix, self.heading_rad
        self.coast(since_s)
        jump = fix.position_m - self._solution_m
        fade = math.exp(-dt_s / self.config.smoothing_s) if self.config.smoothing_s > 0.0 else 0.0
        if math.hypot(jump[0], jump[1]) > self.config.jump_m:
            self.residual_m = self.residual_m - jump
        self.residual_m = fade * self.residual_m
        turn = math.remainder(fix.heading_rad - before.heading_rad, 2.0 * math.pi)
        moving = abs(fix.speed_mps) > STANDSTILL_MPS
        self.yaw_rate_radps = turn / dt_s if moving else 0.0
        share = 1.0 - math.exp(-dt_s / ACCELERATION_S)
        self.acceleration_mps2 += share * ((fix.speed_mps - before.speed_mps) / dt_s - self.acceleration_mps2)
        self._solution_m = fix.position_m.copy()
        self.heading_rad = start + math.remainder(fix.heading_rad - start, 2.0 * math.pi)
        self.fix = fix

    def levels_m(self, map_bound_m: float) -> tuple[float, float]:
        """Protection levels of the pose along and across its heading: the solution's, what has not faded, the map's."""
        s, c = math.sin(self.heading_rad), math.cos(self.heading_rad)
        x, y = self.residual_m
        at, ct = abs(c * x + s * y) + map_bound_m, abs(c * y - s * x) + map_bound_m
        return float(self.fix.pl_at_m + at), float(self.fix.pl_ct_m + ct)
