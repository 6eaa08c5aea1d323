"""True motion of the vehicles of a world, from their poses alone: what the instruments of each may feel.

highway-env advances a pose by the velocity at the start of a step (Euler), and its ``velocity`` leaves out the slip
angle. The velocity at a step's end is therefore taken half way between the steps before and after, the coming one
extrapolated: then the velocities, integrated over time, give the positions back without drift.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.records import azimuth_of, enu_of
from lanebound.integrity.truth import Truth

__all__ = ["Motion"]

Array = NDArray[np.float64]


@dataclass
class Motion:
    """Poses of up to B vehicles at the last steps, one row for each slot.

    Attributes
    ----------
    step_s : length of a simulation step
    position_m, heading_rad : (B, 2) x, y and (B,) now
    """

    step_s: float
    position_m: Array
    heading_rad: Array
    _chord: Array = field(init=False)
    _chord_before: Array = field(init=False)
    _start: tuple[Array, Array, Array] = field(init=False)
    _steps: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self._chord = np.zeros_like(self.position_m)
        self._chord_before = np.zeros_like(self.position_m)
        self.mark()

    @classmethod
    def still(cls, capacity: int, step_s: float) -> Motion:
        """``capacity`` vehicles at rest at the origin."""
        return cls(step_s, np.zeros((capacity, 2)), np.zeros(capacity))

    def enter(self, row: int, position_m: Array, heading_rad: float, speed_mps: float) -> None:
        """A vehicle appears in a slot, after going straight on at its speed for as long as the epoch has lasted.

        ``position_m`` is where it is now, before the next :meth:`advance`.
        """
        self.position_m[row], self.heading_rad[row] = position_m, heading_rad
        chord = self.step_s * speed_mps * np.array([np.cos(heading_rad), np.sin(heading_rad)])
        self._chord[row] = self._chord_before[row] = chord
        position, velocity, heading = self._start
        position[row], velocity[row] = position_m - self._steps * chord, chord / self.step_s
        heading[row] = heading_rad

    def advance(self, rows: NDArray[np.int64], position_m: Array, heading_rad: Array) -> None:
        """Take the poses after a simulation step; (n,), (n, 2), (n,). Slots not named stay where they are."""
        self._steps += 1
        self._chord_before[rows] = self._chord[rows]
        self._chord[rows] = position_m - self.position_m[rows]
        self.position_m[rows], self.heading_rad[rows] = position_m, heading_rad

    @property
    def velocity_mps(self) -> Array:
        """(B, 2) velocity now."""
        return (1.5 * self._chord - 0.5 * self._chord_before) / self.step_s

    def epoch(self, time_s: float, dt_s: float, arc_m: Array, lane: NDArray[np.int64]) -> Truth:
        """Truth of the navigation epoch that ends now, of length ``dt_s``; the next one begins here."""
        (p0, v0, h0), v1 = self._start, self.velocity_mps
        p1, h1 = self.position_m, self.heading_rad
        truth = Truth.between(
            time_s,
            dt_s,
            (enu_of(p0), enu_of(p1)),
            (enu_of(v0), enu_of(v1)),
            (azimuth_of(h0), azimuth_of(h1)),
            arc_m,
            lane,
        )
        self.mark()
        return truth

    def mark(self) -> None:
        """The next epoch begins here."""
        self._steps = 0
        self._start = (self.position_m.copy(), self.velocity_mps, self.heading_rad.copy())
