"""True motion of the vehicles of a world, from their poses alone: what the instruments of each may feel.

highway-env advances a pose by the velocity at the start of a step (Euler), and its ``velocity`` leaves out the slip
angle. The velocity at a step's end is therefore taken half way between the steps before and after, the coming one
extrapolated: then the velocities, integrated over time, give the positions back without drift.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lanebound.envs import motion_kernel as kernel
from lanebound.integrity.core.frames import GRAVITY_MPS2
from lanebound.integrity.motion.truth import Truth

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

    def enter_all(self, position_m: Array, heading_rad: Array, speed_mps: Array) -> None:
        """All slots are taken at once, by vehicles that go straight on: (B, 2), (B,), (B,)."""
        self.position_m[:], self.heading_rad[:] = position_m, heading_rad
        ahead = np.stack([np.cos(heading_rad), np.sin(heading_rad)], -1)
        self._chord[:] = self._chord_before[:] = self.step_s * speed_mps[:, None] * ahead
        self.mark()

    def advance(self, rows: NDArray[np.int64], position_m: Array, heading_rad: Array) -> None:
        """Take the poses after a simulation step; (n,), (n, 2), (n,). Slots not named stay where they are."""
        self._steps += 1
        kernel.advance(
            rows, position_m, heading_rad, self.position_m, self.heading_rad, self._chord, self._chord_before
        )

    @property
    def velocity_mps(self) -> Array:
        """(B, 2) velocity now."""
        return (1.5 * self._chord - 0.5 * self._chord_before) / self.step_s

    def epoch(self, time_s: float, dt_s: float, arc_m: Array, lane: NDArray[np.int64]) -> Truth:
        """Truth of the navigation epoch that ends now, of length ``dt_s``; the next one begins here."""
        batch = self.heading_rad.shape[0]
        position, velocity, turn, delta_v = np.empty((4, batch, 3))
        heading, distance = np.empty((2, batch))
        kernel.epoch(
            self.step_s, -GRAVITY_MPS2 * dt_s, self.position_m, self.heading_rad, self._chord, self._chord_before,
            *self._start, position, velocity, heading, turn, delta_v, distance,
        )  # fmt: skip
        self._steps = 0
        return Truth(time_s, dt_s, position, velocity, heading, turn, delta_v, distance, arc_m, lane)

    def adopt(self, rows: NDArray[np.int64], other: Motion, theirs: NDArray[np.int64]) -> None:
        """Take over the slots ``theirs`` of another motion as ``rows``; both are at the end of an epoch."""
        for mine, values in zip(self._arrays, other._arrays, strict=True):
            mine[rows] = values[theirs]

    @property
    def _arrays(self) -> tuple[Array, ...]:
        return self.position_m, self.heading_rad, self._chord, self._chord_before, *self._start

    def mark(self) -> None:
        """The next epoch begins here."""
        self._steps = 0
        self._start = (self.position_m.copy(), self.velocity_mps, self.heading_rad.copy())
