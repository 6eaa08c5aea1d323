"""The integrity-aware driver with levels that follow from the time since RTK alone, in place of the navigator's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from lanebound.agents.drivers.aware import AwareConfig, IntegrityAware
from lanebound.agents.drivers.base import Observation, Reader, StatelessDriver
from lanebound.agents.drivers.plan import carry_out
from lanebound.envs.core import DrivingEnv
from lanebound.envs.observation import ObservationConfig
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError

__all__ = ["AGES_S", "ClockAware", "ClockConfig", "ClockReader", "LevelsByAge", "make_clock"]

Array = NDArray[np.float64]
AGES_S = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 15.0, 30.0, 60.0)
"""Times since RTK at which a level is given; chosen: outages of streets last seconds to a minute."""
AXES = ("at", "ct")


class LevelsByAge(Config):
    """Levels by the time since RTK, linear in between.

    The defaults are medians of the levels of `nominal` in LaneKeeping under its sky (``lanebound assess decisions``,
    16 training seeds).
    """

    age_s: tuple[float, ...] = Field(AGES_S, min_length=1, description="times since the last RTK position [s]")
    pl_at_m: tuple[float, ...] = Field(
        (0.2, 0.58, 0.89, 1.5, 2.6, 4.8, 8.6, 8.6, 8.6), min_length=1, description="level along the track at each [m]"
    )
    pl_ct_m: tuple[float, ...] = Field(
        (0.21, 0.69, 1.1, 2.1, 3.8, 7.1, 10.0, 10.0, 10.0),
        min_length=1,
        description="level across the track at each [m]",
    )

    @model_validator(mode="after")
    def _one_level_for_each_age(self) -> Self:
        for name in ("pl_at_m", "pl_ct_m"):
            if len(getattr(self, name)) != len(self.age_s):
                raise ConfigError(
                    f"{name} must have one level for each of the {len(self.age_s)} values of age_s, got "
                    f"{len(getattr(self, name))}: give as many"
                )
        if any(later <= age for age, later in zip(self.age_s, self.age_s[1:], strict=False)):
            raise ConfigError(f"age_s must rise, got {list(self.age_s)}: sort it")
        return self


class ClockConfig(LevelsByAge, AwareConfig):
    """Thresholds of the integrity-aware driver, and the levels in place of the navigator's."""


class ClockReader(Reader):
    """Reads observations as others do, but levels, their ratios and the alert by the time since RTK.

    The alert is on while such a level exceeds its limit; it is as old as the navigator's alert. Each vehicle of the
    traffic has the ego's level, but those that a sensor measures, whose distance has no part of the position. Where a
    camera keeps the lane, under an alert roads do not agree, and the other road beside the believed one is possible.

    Parameters
    ----------
    config : of the observations
    figures : levels by age
    """

    def __init__(self, config: ObservationConfig, figures: LevelsByAge) -> None:
        super().__init__(config)
        self._figures = figures

    def value(self, observation: Observation, column: str) -> Array:
        """A quantity in its unit, shaped as the leading axes of the observation."""
        group, _, name = column.partition(".")
        if group == "integrity":
            if name in ("pl_at", "pl_ct"):
                return self._level(observation, name[-2:])
            if name in ("ratio_at", "ratio_ct"):
                axis = name[-2:]
                return self._level(observation, axis) / super().value(observation, f"integrity.al_{axis}")
            if name == "alert":
                return self._alert(observation).astype(np.float64)
            if name == "alert_age":  # services renew the position, so that only this timer can stop the car for good
                return np.where(self._alert(observation), super().value(observation, column), 0.0)
            if name == "roads_agree":
                return (~self._alert(observation)).astype(np.float64)
            if name == "possible_limit":
                limit, other = (
                    super(ClockReader, self).value(observation, f"road.{n}_limit") for n in ("speed", "other")
                )
                return np.where(self._alert(observation), np.minimum(limit, other), limit)
        return super().value(observation, column)

    def rows(self, observation: Observation, name: str) -> Array:
        """A quantity of all K vehicles of the traffic, (..., K)."""
        found = super().rows(observation, name)
        if name in ("pl_at", "pl_ct"):
            level = self._level(observation, name[-2:])[..., None]
            return np.where(super().rows(observation, "sensor") > 0.5, found, level)
        return found

    def _level(self, observation: Observation, axis: str) -> Array:
        age = super().value(observation, "integrity.since_rtk")
        return np.asarray(np.interp(age, self._figures.age_s, getattr(self._figures, f"pl_{axis}_m")))

    def _alert(self, observation: Observation) -> NDArray[np.bool_]:
        over = [self._level(observation, axis) > super(ClockReader, self).value(observation, f"integrity.al_{axis}")
                for axis in AXES]  # fmt: skip
        return np.asarray(over[0] | over[1])


class ClockAware(IntegrityAware):
    """The integrity-aware driver by a clock: what it does better with the navigator's levels, these decide.

    It reads alert limits, the time since RTK, the predicted sky and, while its own alert is on, the age of the
    navigator's alert; no protection level.
    """

    NEEDED: ClassVar[Sequence[str]] = (*IntegrityAware.NEEDED, "integrity.al_at", "integrity.al_ct")
    config: ClockConfig

    def __init__(self, env: DrivingEnv, config: ClockConfig) -> None:
        super().__init__(env, config)
        self.reader = ClockReader(env.config.observation, config)

    def _permitted(self, observation: Observation, slow_mps: Array) -> Array:
        """The share of the limit: the permitted speed of the observation is by the level."""
        return slow_mps


def make_clock(env: DrivingEnv, config: ClockConfig | None = None) -> StatelessDriver:
    """The integrity-aware driver by a clock."""
    return carry_out(env, ClockAware(env, config or ClockConfig()))
