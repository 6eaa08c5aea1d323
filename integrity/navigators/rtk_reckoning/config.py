"""Configuration of the kind ``rtk_reckoning``."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from lanebound.integrity.navigators.navigator import NavigatorConfig

__all__ = ["RtkReckoningConfig"]


class RtkReckoningConfig(NavigatorConfig):
    """RTK, bridged by Doppler and by dead reckoning with odometer and gyro (S1 figure 1); the default kind."""

    kind: Literal["rtk_reckoning"] = Field("rtk_reckoning", description="kind of the navigator")
