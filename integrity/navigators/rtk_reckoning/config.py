"""Configuration of the kind ``rtk_reckoning``."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from lanebound.integrity.monitoring.exclusion import FdeConfig, Search
from lanebound.integrity.navigators.navigator import NavigatorConfig

__all__ = ["RtkReckoningConfig"]


class RtkReckoningConfig(NavigatorConfig):
    """RTK, bridged by Doppler and by dead reckoning with odometer and gyro (S1 figure 1); the default kind."""

    kind: Literal["rtk_reckoning"] = Field("rtk_reckoning", description="kind of the navigator")

    @property
    def tests(self) -> FdeConfig:
        """The fault tests: ``fde``, which ``risk.direction_test`` lets search in the direction of maximum error."""
        return self.fde.replace(search=Search.DIRECTION) if self.risk.direction_test else self.fde
