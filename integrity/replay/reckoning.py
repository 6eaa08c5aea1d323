"""Dead-reckoned path from wheel speed and yaw rate in its own frame: it starts at the origin with heading 0 (North)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["DeadReckonedPath", "reckon", "turned"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DeadReckonedPath:
    """Times (T,) [s], heading clockwise from the initial one (T,) [rad], position (T, 2) [m], distance (T,) [m]."""

    time_s: Array
    heading_rad: Array
    position_m: Array
    distance_m: Array


def reckon(time_s: Array, speed_mps: Array, yaw_rate_radps: Array, axle_m: float = 0.0) -> DeadReckonedPath:
    """``dp = V dt [sin t, cos t]`` with the means of speed and heading over each interval (inverse of S1 eq 4).

    All (T,); the yaw rate is positive to the right (clockwise). The rear axle moves in the direction of the heading.
    The path is that of a point ``axle_m`` ahead of it, which also moves sideways in a bend.
    """
    dt = np.diff(time_s)
    turn = 0.5 * (yaw_rate_radps[1:] + yaw_rate_radps[:-1]) * dt
    heading = np.concatenate([[0.0], np.cumsum(turn)])
    run = 0.5 * (speed_mps[1:] + speed_mps[:-1]) * dt
    middle = 0.5 * (heading[1:] + heading[:-1])
    steps = run[:, None] * np.stack([np.sin(middle), np.cos(middle)], -1)
    ahead = axle_m * np.stack([np.sin(heading), np.cos(heading) - 1.0], -1)
    position = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)]) + ahead
    return DeadReckonedPath(time_s, heading, position, np.concatenate([[0.0], np.cumsum(np.abs(run))]))


def turned(offset_m: Array, angle_rad: float) -> Array:
    """Rotate offsets (..., 2) clockwise by an angle, which increases the headings of a path by this angle."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    east, north = offset_m[..., 0], offset_m[..., 1]
    return np.stack([c * east + s * north, c * north - s * east], -1)
