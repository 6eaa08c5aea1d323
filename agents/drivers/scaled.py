"""A driver whose speed, gap and steering follow the size of the protection levels, and its twin by a clock."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lanebound.agents.drivers.base import Observation, StatelessDriver
from lanebound.agents.drivers.clock import ClockReader, LevelsByAge
from lanebound.agents.drivers.lateral import LqrSteering
from lanebound.agents.drivers.margins import Levelled, LevelledConfig
from lanebound.agents.drivers.plan import carry_out
from lanebound.agents.drivers.plans import EGO_LENGTH_M
from lanebound.envs.core import DrivingEnv
from lanebound.integrity.core.config import Field

__all__ = ["ClockScaled", "ClockScaledConfig", "LevelScaled", "ScaledConfig", "make_clock_scaled", "make_level_scaled"]

Array = NDArray[np.float64]


class ScaledConfig(LevelledConfig):
    """How speed follows a level."""

    fill: float = Field(
        2.0,
        gt=0,
        description="level over room up to which the limit is driven [-]; on training seeds 1 cost an eighth of the "
        "speed at no clearly less harm (1.5, with 2 1.9)",
    )
    car_width_m: float = Field(2.0, gt=0, description="of highway-env's cars")


class LevelScaled(Levelled):
    """RSS with levels of both vehicles, at the speed at which the level across fits into the room across.

    What a level sweeps counts, as in :mod:`lanebound.envs.batch.budget_kernel`: ``v PL_CT <= fill v_limit room(v)``,

        room(v) = min(w / 2 - |d|, w / 2 - tracking) - (W |cos psi| + L |sin psi|) / 2 - v T |sin psi|
                  - kappa (PL_AT + L / 2)^2 / 2

    with the symbols and the least room of that budget; the third term counts for a car that moves away from the middle,
    kappa is the largest curvature up to PL_AT + L/2 + v T ahead. The sweep is linear in v, so v is a ratio. Gaps are
    less PL_AT of both vehicles at any level. While PL_CT exceeds the room of a car in the middle of its lane, the
    regulator takes that share of the offset: the car keeps its course rather than to follow a position that may be a
    lane off. A law that steers past others, as where steering is the only command (Racetrack), is left as it is. No
    lane is changed while PL_CT exceeds half of its width. Under an alert a level counts as its limit at least, as after
    a failed test it bounds nothing.

    Where a camera keeps the lane, the room is the distance to the road beside, and the speed falls to the limit of that
    one at least; changes of lanes for the goal wait while PL_CT reaches it, until they must be made.
    """

    NEEDED: ClassVar[Sequence[str]] = (*Levelled.NEEDED, "integrity.alert", "integrity.al_at", "integrity.al_ct")
    config: ScaledConfig

    def __init__(self, env: DrivingEnv, config: ScaledConfig) -> None:
        super().__init__(env, config)
        self._budget, self._dt_s = env.config.budget, env.dt_s
        if isinstance(self.steering, LqrSteering) and not self.reader.config.roads:
            self._law, self.steering = self.steering, self._steer

    def free_speed(self, observation: Observation) -> Array:
        """Speed that the route and the level across allow."""
        return np.minimum(super().free_speed(observation), self._level_speed(observation))

    def _level_speed(self, observation: Observation) -> Array:
        read, c = self.reader.value, self.config
        limit, level = read(observation, "road.speed_limit"), self._level(observation, "ct")
        if self.reader.config.roads:
            other = np.minimum(read(observation, "road.other_limit"), limit)
            by_level = limit * c.fill * read(observation, "road.other_road") / np.maximum(level, 1e-6)
            return np.maximum(by_level, other)
        top = c.fill * np.where(limit < self.reader.scale("road.speed_limit"), limit, c.speed_mps)
        room, outwards = self._room(observation)
        return np.asarray(top * room / np.maximum(level + top * outwards, 1e-6))

    def _level(self, observation: Observation, axis: str) -> Array:
        """The level, the largest shown if missing; under an alert the limit at least."""
        level, limit = (self.reader.value(observation, f"integrity.{name}_{axis}") for name in ("pl", "al"))
        return np.where(self.reader.value(observation, "integrity.alert") > 0.5, np.maximum(level, limit), level)

    def _room(self, observation: Observation) -> tuple[Array, Array]:
        """Room across at rest [m], and what each m/s takes of it [s]."""
        read, dt = self.reader.value, self._dt_s
        e, sine = read(observation, "ego.lateral_offset"), read(observation, "ego.heading_sin")
        reach = self._level(observation, "at") + 0.5 * EGO_LENGTH_M
        kappa, sweep = np.zeros_like(e), np.maximum(read(observation, "ego.speed"), 0.0) * dt
        for d in self.reader.previews_m:
            there = np.abs(read(observation, f"road.preview_{d:g}m_curvature"))
            kappa = np.maximum(kappa, np.where((d <= reach + sweep) | (d == self.reader.previews_m[0]), there, 0.0))
        half = 0.5 * read(observation, "ego.lane_width")
        body = 0.5 * (self.config.car_width_m * np.abs(read(observation, "ego.heading_cos")))
        body += 0.5 * EGO_LENGTH_M * np.abs(sine) + 0.5 * kappa * reach**2
        room = np.minimum(half - np.abs(e), half - self._budget.tracking_m) - body
        return np.maximum(room, self._budget.least_m), np.where(e * sine > 0.0, dt * np.abs(sine), 0.0)

    def _steer(self, observation: Observation) -> Array:
        """The regulator, with the share of the offset that the level leaves [rad]."""
        read = self.reader.value
        centred = 0.5 * (read(observation, "ego.lane_width") - self.config.car_width_m) - self._budget.tracking_m
        level = np.maximum(self._level(observation, "ct"), 1e-6)
        taken = np.minimum(np.maximum(centred, self._budget.least_m) / level, 1.0)
        return self._law(observation, (1.0 - taken) * read(observation, "ego.lateral_offset"))

    def waits(self, observation: Observation) -> NDArray[np.bool_]:
        """Where the level across reaches the middle of the next lane, or with a lane sensor the road beside."""
        room = "road.other_road" if self.reader.config.roads else "ego.lane_width"
        share = 1.0 if self.reader.config.roads else 0.5
        return np.asarray(self._level(observation, "ct") > share * self.reader.value(observation, room))


class ClockScaledConfig(LevelsByAge, ScaledConfig):
    """How speed follows a level, and the levels."""


class ClockScaled(LevelScaled):
    """The same with levels by the time since RTK: what :class:`LevelScaled` does better, the size of levels decides."""

    config: ClockScaledConfig

    def __init__(self, env: DrivingEnv, config: ClockScaledConfig) -> None:
        super().__init__(env, config)
        self.reader = ClockReader(env.config.observation, config)


def make_level_scaled(env: DrivingEnv, config: ScaledConfig | None = None) -> StatelessDriver:
    """The driver whose speed, gap and steering follow the size of the levels."""
    return carry_out(env, LevelScaled(env, config or ScaledConfig()))


def make_clock_scaled(env: DrivingEnv, config: ClockScaledConfig | None = None) -> StatelessDriver:
    """The same driver by a clock."""
    return carry_out(env, ClockScaled(env, config or ClockScaledConfig()))
