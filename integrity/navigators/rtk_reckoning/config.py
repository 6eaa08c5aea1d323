"""Configuration of the kind ``rtk_reckoning``."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.monitoring.exclusion import FdeConfig, Search
from lanebound.integrity.navigators.navigator import NavigatorConfig
from lanebound.integrity.navigators.rtk_reckoning.modes import PositioningMode, mode_named
from lanebound.integrity.navigators.rtk_reckoning.monitors import Monitor, monitor_named

__all__ = ["RtkReckoningConfig"]


class RtkReckoningConfig(NavigatorConfig):
    """RTK, bridged by Doppler and by dead reckoning with odometer and gyro (S1 figure 1); the default kind."""

    kind: Literal["rtk_reckoning"] = Field("rtk_reckoning", description="kind of the navigator")
    modes: tuple[str, ...] = Field(
        ("doppler", "imu_odometer"), description="positioning modes between RTK positions, in order of preference"
    )
    monitors: tuple[str, ...] = Field((), description="monitors from outside, beside those that are always on")

    @model_validator(mode="after")
    def _modes_and_monitors_are_known(self) -> Self:
        for what, names in (("modes", self.modes), ("monitors", self.monitors)):
            if len(set(names)) < len(names):
                raise ConfigError(f"{what} must name each one once, got {list(names)}: remove the repeated one")
        _ = self.chosen_modes, self.chosen_monitors
        return self

    @property
    def chosen_modes(self) -> list[PositioningMode]:
        """The records of ``modes``."""
        return [mode_named(name) for name in self.modes]

    @property
    def chosen_monitors(self) -> list[Monitor]:
        """The records of ``monitors``."""
        return [monitor_named(name) for name in self.monitors]

    @property
    def tests(self) -> FdeConfig:
        """The fault tests: ``fde``, which ``risk.direction_test`` lets search in the direction of maximum error."""
        return self.fde.replace(search=Search.DIRECTION) if self.risk.direction_test else self.fde
