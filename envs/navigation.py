"""Source of the position of the ego: the true pose, a constant offset from it, or the navigator."""

from __future__ import annotations

from enum import Enum
from typing import Self

from pydantic import Field, model_validator

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.navigators.navigator import Start

__all__ = ["NavigationConfig", "Source"]


class Source(Enum):
    """Source of the belief."""

    NAVIGATOR = "navigator"
    PERFECT = "perfect"
    OFFSET = "offset"

    @property
    def uses_sensors(self) -> bool:
        """Whether positions are sensed, not given."""
        return self is Source.NAVIGATOR


class NavigationConfig(Config):
    """Source of the position of the ego, and the start of its navigation."""

    source: Source = Field(
        Source.NAVIGATOR,
        description="navigator: from simulated sensors; perfect: true pose; offset: true pose and a constant error",
    )
    rate_hz: float = Field(10.0, gt=0, le=20, description="navigation epochs in a second; must divide simulation_hz")
    offset_at_m: float = Field(0.0, ge=-50, le=50, description="error along the track, forward, for source offset")
    offset_ct_m: float = Field(0.0, ge=-50, le=50, description="error across the track, to the right, for offset")
    start: Start = Field(
        Start.TOLD,
        description="told: the ego knows its pose at the start; cold: no level before its heading is known",
    )
    start_sigma_m: float | None = Field(
        None,
        gt=0,
        le=10,
        description="1-sigma of the known start position (none: 0.05 m, or 10 m with code services alone); chosen",
    )
    start_heading_deg: float = Field(0.5, gt=0, le=45, description="1-sigma of the heading known at the start; chosen")
    warm_up_s: float = Field(
        3.0,
        ge=0,
        le=60,
        description="time on a straight approach before the episode",
    )
    map_sigma_m: float = Field(
        0.03, ge=0, le=1, description="1-sigma of the map's shift on each axis; HD maps claim 0.1 m at 3 sigma"
    )
    jump_m: float = Field(
        0.25, gt=0, description="a correction larger than this is smoothed; larger than RTK noise, chosen"
    )
    smoothing_s: float = Field(1.0, ge=0, le=30, description="time constant of the smoothing; 0: none")

    @model_validator(mode="after")
    def _offset_is_used(self) -> Self:
        for name in ("offset_at_m", "offset_ct_m"):
            value = getattr(self, name)
            if value != 0.0 and self.source is not Source.OFFSET:
                raise ConfigError(
                    f"{name} must be 0 with source {self.source.value}, got {value}: leave it out, or set "
                    "source to offset"
                )
        return self

    @property
    def clock_start_s(self) -> float:
        """Time of the clock of the navigators at the start of an episode: whole epochs of warm-up plus one."""
        return (self.epochs_before(1.0 / self.rate_hz) + 1) / self.rate_hz

    def epochs_before(self, epoch_s: float) -> int:
        """Epochs of the approach before an episode."""
        return max(1, round(self.warm_up_s / epoch_s))

    def steps_per_epoch(self, simulation_hz: int) -> int:
        """Simulation steps in a navigation epoch; the nearest number where the rates do not divide."""
        return max(1, round(simulation_hz / self.rate_hz))
