"""The barrier of the lane: steering angles that keep a car in its lanes, and speeds at which bends leave the grip.

It needs no acceleration among the actions, so that it holds where steering is the only command. The head of
:mod:`.barrier` states what it bounds and what it does not.

Symbols: v speed [m/s], T length of a policy step [s], e offset [m], psi heading less its steady value in the bend, beta
angle of the velocity less that value, L wheelbase, w and W widths of lane and car, kappa curvature [1/m].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, Reader
from lanebound.agents.drivers.lateral import errors
from lanebound.agents.drivers.plans import EGO_LENGTH_M
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import InputError
from lanebound.integrity.core.frames import wrap_angle

__all__ = ["WALK_MPS", "LaneBarrier", "LaneBarrierConfig"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Flags = Bools | bool
WALK_MPS = 1.0  # at lower speeds steering has no effect


class LaneBarrierConfig(Config):
    """Figures of the barrier of the lane and of bends."""

    gamma: float = Field(0.3, gt=0, le=1, description="share of the barrier that a step may use up [-]; chosen")
    preview_s: float = Field(1.0, gt=0, description="over which the lane barrier looks ahead; chosen")
    lane_floor_m: float = Field(0.15, gt=0, description="M at least, for the believed middle; a hand's breadth, chosen")
    car_width_m: float = Field(2.0, gt=0, description="of highway-env's cars")
    bend_share: float = Field(
        0.75, gt=0, le=1, description="of the grip, for bends; the rest is for corrections; chosen"
    )
    bend_brake_mps2: float = Field(3.0, gt=0, description="braking assumed before bends; chosen")


class LaneBarrier:
    """Bounds of steering and of speed in bends, for observations with any leading axes.

    Parameters
    ----------
    env : only its configuration and the ranges of its actions are read

    Raises
    ------
    InputError
        The observation shows no preview of the route.
    """

    config: LaneBarrierConfig

    def __init__(self, env: DrivingEnv, config: LaneBarrierConfig) -> None:
        self.config, self.reader, self._dt_s = config, Reader(env.config.observation), env.dt_s
        if not self.reader.previews_m:
            raise InputError("observation.preview_m must name a distance for this agent, got none: add one")
        self._inner, self._limits = env.world.action_type, env.config.actuators

    def bend_squared(
        self, observation: Observation, bends: list[tuple[float, Array]], v: Array, behind: Array
    ) -> Array:
        """Square of the speed at which :meth:`bends` need a share of the grip [m2/s2]; inf without a limit of grip.

        ``min(share a_lat / |kappa(d)| + 2 b (d - PL_AT - v T))``: the believed place may be PL_AT too far back, and
        bends come nearer by the way until the next decision.

        Parameters
        ----------
        v : present speed [m/s]
        behind : curvature that may not be over yet [1/m]
        """
        c, grip = self.config, None if self._limits is None else self._limits.lateral_acceleration_mps2
        if grip is None:
            return np.full(v.shape, np.inf)
        late = self.reader.value(observation, "integrity.pl_at") + v * self._dt_s
        squared = c.bend_share * grip / np.maximum(behind, 1e-6)
        for d, kappa in bends:
            bend = c.bend_share * grip / np.maximum(kappa, 1e-6)
            squared = np.minimum(squared, bend + 2.0 * c.bend_brake_mps2 * np.maximum(d - late, 0.0))
        return np.asarray(squared)

    def bends(self, observation: Observation) -> list[tuple[float, Array]]:
        """Places [m] and curvatures [1/m] of bends: at each preview, and on average between two of them."""
        read = self.reader.value
        turned = -np.arctan2(read(observation, "ego.heading_sin"), read(observation, "ego.heading_cos"))
        found, at = [], 0.0
        for d in self.reader.previews_m:
            heading = read(observation, f"road.preview_{d:g}m_heading")
            turn = wrap_angle(heading - turned)
            found += [(at, np.abs(turn) / (d - at)), (d, np.abs(read(observation, f"road.preview_{d:g}m_curvature")))]
            turned, at = heading, d
        return found

    def angle_bounds(
        self, observation: Observation, left: Flags = False, right: Flags = False
    ) -> tuple[Array, Array, Bools]:
        """Bounds of the steering angle [rad] that keep the car in its lanes, and where they have slack.

        ``q = e + v t psi``, the offset after the preview t, stays within ``M = (w - W) / 2 - PL_CT``:
        ``-gamma M + (1 - gamma) q <= q(next) <= gamma M + (1 - gamma) q``, ``q(next) = q + v T psi + G beta``,
        ``G = v T + (v T)^2 / L + 2 T v^2 t / L``. e follows q as a lag of first order, so that it stays there too, and
        one steering angle determines q. All this is of the belief, see :mod:`.barrier`. Where M is below a floor
        the car may be outside of its lane already: the floor takes its place, which keeps the departure smallest.

        ``left`` and ``right`` (...) open the lanes beside: M is larger by w on that side.
        """
        c, dt, reader = self.config, self._dt_s, self.reader
        v = np.maximum(reader.value(observation, "ego.speed"), 0.0)
        e, psi, beta, _ = errors(reader, observation)
        width = reader.value(observation, "ego.lane_width")
        free = 0.5 * (width - c.car_width_m) - reader.value(observation, "integrity.pl_ct")
        m = np.maximum(free, c.lane_floor_m)
        way = v * dt
        reach = way + way**2 / EGO_LENGTH_M + 2.0 * way * v * c.preview_s / EGO_LENGTH_M
        q = e + v * c.preview_s * psi
        middle = -c.gamma * q - way * psi
        per = np.maximum(reach, 0.1)
        low, high = (
            np.arctan(2.0 * np.tan(np.clip(beta + (middle + side * c.gamma * (m + width * more)) / per, -1.0, 1.0)))
            for side, more in ((-1, np.asarray(left)), (1, np.asarray(right)))
        )
        return low, high, (free < c.lane_floor_m) & (v >= WALK_MPS)

    def reachable(self, observation: Observation) -> tuple[Array, Array]:
        """Steering angles that grip and the wheel's rate allow within a decision [rad]."""
        limits, (low, high) = self._limits, self._inner.steering_range
        v = np.maximum(self.reader.value(observation, "ego.speed"), 0.0)
        now = self.reader.value(observation, "ego.steering")
        grip = np.full(v.shape, np.pi / 2)
        if limits is not None and limits.lateral_acceleration_mps2 is not None:
            sine = np.minimum(limits.lateral_acceleration_mps2 * 0.5 * EGO_LENGTH_M / np.maximum(v, 0.1) ** 2, 0.99)
            grip = np.arctan(2.0 * np.tan(np.arcsin(sine)))
        rate = np.inf if limits is None or limits.steering_rate_radps is None else limits.steering_rate_radps
        turn = rate * self._dt_s
        return (
            np.clip(np.maximum(-grip, now - turn), low, high),
            np.clip(np.minimum(grip, now + turn), low, high),
        )

    def steering_bounds(
        self, observation: Observation, left: Flags = False, right: Flags = False
    ) -> tuple[Array, Array, Bools, Bools]:
        """Bounds of steering, free at walking pace; where there is slack; where no angle is safe."""
        low, high, slack = self.angle_bounds(observation, left, right)
        least, most = self.reachable(observation)
        rolls = self.reader.value(observation, "ego.speed") >= WALK_MPS
        none = rolls & ((low > most) | (high < least))
        return np.where(rolls, low, -np.pi), np.where(rolls, high, np.pi), slack, none
