"""What perception is given at each step: who is really there, and what they believe of themselves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lanebound.envs.records import heading_of, xy_of
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.positioning.modes import Mode

__all__ = ["Claims", "Vehicles"]

Array = NDArray[np.float64]
COURSE_FROM_MPS = 2.0  # below, Doppler noise turns the course by degrees
Rows = NDArray[np.int64]


@dataclass(frozen=True)
class Vehicles:
    """The V vehicles that are really there, the ego among them.

    Attributes
    ----------
    slot : (V,) int64, row of each vehicle in everything that has a row for each of C slots; no two share one
    key : (V,) int64, name of each vehicle, never given twice; a slot whose key changes has a new vehicle
    position_m : (V, 2) x, y of the middle; heading_rad, speed_mps : (V,)
    length_m, width_m : (V,)
    """

    slot: Rows
    key: Rows
    position_m: Array
    heading_rad: Array
    speed_mps: Array
    length_m: Array
    width_m: Array


@dataclass(frozen=True)
class Claims:
    """What the vehicles in C slots believe of themselves and would broadcast; rows of empty slots need only be finite.

    Attributes
    ----------
    position_m : (C, 2) x, y; heading_rad, speed_mps : (C,)
    pl_at_m, pl_ct_m : (C,) protection levels along and across the heading, inf if missing
    initialised : (C,) bool, the position means something; without, the vehicle keeps silent
    """

    position_m: Array
    heading_rad: Array
    speed_mps: Array
    pl_at_m: Array
    pl_ct_m: Array
    initialised: NDArray[np.bool_]

    @classmethod
    def of(cls, solution: Solution, silent: int = 0) -> Claims:
        """The claims of navigators, in the plane, and of ``silent`` rows more that claim nothing.

        The course is told as the heading: it is where the vehicle goes.
        """
        n = solution.mode.shape[0]
        claims = cls.silent(n + silent)
        claims.position_m[:n] = xy_of(solution.position_en_m)
        claims.heading_rad[:n] = heading_of(_course_rad(solution))
        claims.speed_mps[:n], claims.initialised[:n] = solution.speed_mps, solution.mode != Mode.NONE.value
        claims.pl_at_m[:n], claims.pl_ct_m[:n] = solution.pl_at_m, solution.pl_ct_m
        return claims

    @classmethod
    def silent(cls, slots: int) -> Claims:
        """Nobody says anything."""
        heading, speed, pl_at, pl_ct = np.zeros((4, slots))
        return cls(np.zeros((slots, 2)), heading, speed, pl_at, pl_ct, np.zeros(slots, dtype=np.bool_))


def _course_rad(solution: Solution) -> Array:
    """Azimuths of the estimated velocities, those of the headings where a vehicle is too slow or goes backwards."""
    east, north = solution.velocity_en_mps.T
    ahead = solution.speed_mps > COURSE_FROM_MPS
    return np.where(ahead, np.arctan2(east, north), solution.heading_rad)
