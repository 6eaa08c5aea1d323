"""Lateral position of the other drivers in their lanes: an offset of each driver, and a slow wander about it.

The line of a driver lies at ``y(t) = sigma_o n_0 + sigma_w / sqrt(M) sum_m (n_2m-1 cos(w_m t) + n_2m sin(w_m t))`` to
the right of the middle, with standard normal n of that driver. The frequencies ``w_m = tan(pi (m - 1/2) / 2M) / tau``
share the power of a Gauss-Markov process of correlation time tau equally. The line moves aside by at most
``WANDER_SLOPE`` of the way of the car, and stays within ``WANDER_MOST_M``. The driver steers to it by highway-env's
law; with both sigmas at 0 drivers are highway-env's own, bit for bit.

Sources: the standard deviation of the lateral position is about 0.19 m for sober drivers on a motorway (J. C. Verster,
T. Roth, Int. J. Gen. Med. 4, 359-371, 2011, on the road at 95 km/h). The spread between drivers and the correlation
time are chosen: lane keeping has its power below some 0.2 Hz.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from highway_env.road.road import LaneIndex
from highway_env.utils import not_zero, wrap_to_pi
from highway_env.vehicle.controller import ControlledVehicle
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from lanebound.envs.worlds.idm_parameters_kernel import WANDER_MOST_M, WANDER_SHAPES, WANDER_SLOPE
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.streams import named_generator, named_states

__all__ = ["Wander", "WanderConfig", "moved_aside"]

Array = NDArray[np.float64]
SHAPES_AT_ONCE = 256  # simulation steps
FREQUENCIES = (WANDER_SHAPES - 1) // 2
STREAM = "wander"


class WanderConfig(Config):
    """Spread of the drivers' lines in their lanes; 0 and 0 for lines in the middle, as highway-env has them."""

    offset_sigma_m: float = Field(0.15, ge=0, le=0.5, description="1 sigma of the mean offset of a driver; chosen")
    wander_sigma_m: float = Field(
        0.19, ge=0, le=0.5, description="1 sigma of the wander; Verster and Roth 2011, sober drivers on a motorway"
    )
    correlation_s: float = Field(5.0, gt=0, description="correlation time of the wander; chosen")

    @property
    def wanders(self) -> bool:
        """Whether any driver leaves the middle of its lane."""
        return self.offset_sigma_m > 0.0 or self.wander_sigma_m > 0.0

    def shapes(self, first: int, count: int, dt_s: float) -> Array:
        """Rows of the sum over time, from step ``first`` on, that the weights of a driver multiply.  -> (n, K) [m]."""
        share = (np.arange(1, FREQUENCIES + 1) - 0.5) / FREQUENCIES
        angle = np.outer(dt_s * np.arange(first, first + count), np.tan(0.5 * np.pi * share) / self.correlation_s)
        wave = np.stack([np.cos(angle), np.sin(angle)], axis=-1).reshape(count, -1)
        offset = np.full((count, 1), self.offset_sigma_m)
        return np.hstack([offset, self.wander_sigma_m / math.sqrt(FREQUENCIES) * wave])

    def weights(self, generator: np.random.Generator, drivers: int) -> Array:
        """Weights of the next drivers of a generator (drivers, K), standard normal."""
        return generator.standard_normal((drivers, WANDER_SHAPES))

    def generator(self, seed: int) -> np.random.Generator:
        """The generator of an episode, which draws the weights of its drivers in the order of their entry."""
        return named_generator(seed, STREAM)

    def states(self, seeds: Sequence[int]) -> NDArray[np.uint64]:
        """States (n, 4) of the generators of n episodes, for compiled draws of the same weights."""
        return named_states(seeds, STREAM)


def moved_aside(x: float, y: float, heading: float, aside: float) -> tuple[float, float]:
    """A point ``aside`` to the right of another one [m]."""
    return x - math.sin(heading) * aside, y + math.cos(heading) * aside


class Wander:
    """The lines of the drivers of a single environment.

    Parameters
    ----------
    config : their spread
    seed : of the episode
    dt_s : simulation step
    """

    def __init__(self, config: WanderConfig, seed: int, dt_s: float) -> None:
        self.config, self.dt_s = config, dt_s
        self._generator = config.generator(seed)
        self._shapes: list[list[float]] = []

    def enter(self, vehicle: Vehicle) -> None:
        """Put the vehicle of a driver on its line, to which it steers from now on."""
        if not self.config.wanders:
            return
        weights = self.config.weights(self._generator, 1)[0]
        if not isinstance(vehicle, ControlledVehicle):
            return
        line = _Line(self, vehicle, weights)
        x, y = moved_aside(float(vehicle.position[0]), float(vehicle.position[1]), float(vehicle.heading), line.aside_m)
        vehicle.position = np.array([x, y])
        vehicle.act = partial(_act, line)
        vehicle.steering_control = partial(_steering, line)

    def shape(self, step: int) -> list[float]:
        """The shape at a simulation step (K,), the same for all drivers."""
        known = len(self._shapes)
        if step >= known:
            self._shapes += self.config.shapes(known, max(step + 1 - known, SHAPES_AT_ONCE), self.dt_s).tolist()
        return self._shapes[step]


class _Line:
    """The line of one driver, ``aside_m`` to the right of the middle of its lane."""

    def __init__(self, wander: Wander, vehicle: ControlledVehicle, weights: Array) -> None:
        self.wander, self.vehicle, self.weights, self.steps = wander, vehicle, weights.tolist(), 0
        self.aside_m = self._goal_m()

    def follow(self) -> None:
        """Move towards the line of the end of this step, as fast as the car may move aside."""
        self.steps += 1
        most = WANDER_SLOPE * max(self.vehicle.speed, 0.0) * self.wander.dt_s
        self.aside_m += min(max(self._goal_m() - self.aside_m, -most), most)

    def _goal_m(self) -> float:
        goal = 0.0
        for factor, weight in zip(self.wander.shape(self.steps), self.weights, strict=True):
            goal += factor * weight  # in the order of the kernel
        return min(max(goal, -WANDER_MOST_M), WANDER_MOST_M)


def _act(line: _Line, action: Any = None) -> None:
    """As the driver acts, along its line."""
    line.follow()
    type(line.vehicle).act(line.vehicle, action)


def _steering(line: _Line, target_lane_index: LaneIndex) -> float:
    """``ControlledVehicle.steering_control`` of highway-env, to the line in place of the middle of the lane."""
    v = line.vehicle
    lane = v.road.network.get_lane(target_lane_index)
    s, r = lane.local_coordinates(v.position)
    ahead = lane.heading_at(s + v.speed * v.TAU_PURSUIT)
    course = np.arcsin(np.clip(-v.KP_LATERAL * (r - line.aside_m) / not_zero(v.speed), -1, 1))
    rate = v.KP_HEADING * wrap_to_pi(ahead + np.clip(course, -np.pi / 4, np.pi / 4) - v.heading)
    slip = np.arcsin(np.clip(v.LENGTH / 2 / not_zero(v.speed) * rate, -1, 1))
    return float(np.clip(np.arctan(2 * np.tan(slip)), -v.MAX_STEERING_ANGLE, v.MAX_STEERING_ANGLE))
