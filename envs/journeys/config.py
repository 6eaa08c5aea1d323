"""Configuration of journeys."""

from __future__ import annotations

from enum import Enum
from typing import Self

from pydantic import model_validator

from lanebound.envs.sky.cities import CitiesConfig
from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.sky.survey import MapConfig

__all__ = ["Departure", "JourneyConfig", "JourneyReward", "Realised"]


class Departure(Enum):
    """Whether the hour of departure is drawn, or chosen by the first action."""

    FIXED = "fixed"
    CHOOSE = "choose"


class Realised(Enum):
    """Where availability comes from: a law fitted on drives of the navigator, or the navigator itself."""

    FAST = "fast"
    FULL = "full"


class JourneyReward(Config):
    """Weights of the terms of the reward, which are losses."""

    time: float = Field(1.0, ge=0, description="of a minute")
    energy: float = Field(1.2, ge=0, description="of a kWh; chosen: 0.30 EUR, as 1.2 minutes at 15 EUR an hour")
    unusable: float = Field(0.0, ge=0, description="of a minute without a usable position, which also is a cost")


class JourneyConfig(Config):
    """Where and when journeys take place, what is chosen, and what it is worth."""

    cities: CitiesConfig = Field(
        CitiesConfig(), description="generated cities; `count` 4 of train by default, `vary` must be false"
    )
    hours: tuple[float, ...] = Field(
        (3.0, 9.0, 15.0, 21.0), description="hours of departure, GPS time [h]; a city has a forecast for each"
    )
    departure: Departure = Field(Departure.FIXED, description="fixed: the hour is drawn; choose: the first action")
    speed_classes: tuple[float, ...] = Field(
        (1.0,), description="shares of the speed limit, of which one is chosen for each street; one: no choice"
    )
    map: MapConfig = Field(MapConfig(), description="errors of the map by which streets are predicted")
    realised: Realised = Field(
        Realised.FAST, description="fast: a law fitted on drives; full: the navigator drives each street"
    )
    reward: JourneyReward = Field(JourneyReward(), description="weights of the terms of the reward")
    cost_limit: float = Field(
        47.0, ge=0, description="limit of the cost of a journey, seconds without a usable position"
    )
    duration_s: float = Field(600.0, gt=0, le=3600, description="after which a journey is truncated [s]")

    @model_validator(mode="after")
    def _choices(self) -> Self:
        for name, values, high in (("hours", self.hours, 24.0), ("speed_classes", self.speed_classes, 1.0)):
            inside = all(0.0 <= v < high if name == "hours" else 0.2 <= v <= high for v in values)
            if not values or not inside or len(set(values)) < len(values):
                bounds = "in [0, 24)" if name == "hours" else "in [0.2, 1]"
                raise ConfigError(f"{name} must be distinct numbers {bounds}, got {list(values)}: correct them")
        if self.cities.vary:
            raise ConfigError("cities.vary must be false, got True: generated maps differ by their seeds")
        return self
