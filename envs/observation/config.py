"""Contents, scales and form of an observation."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Literal, Self

from pydantic import field_validator, model_validator

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.plugins import bare_name, find
from lanebound.integrity.positioning.modes import Mode

__all__ = ["ObservationConfig"]


class ObservationConfig(Config):
    """Form, content and scales of an observation; every entry is its quantity over its scale, clipped to its bounds."""

    form: Literal["dict", "flat"] = Field("dict", description="one vector for each group, or all groups in one vector")
    history: int = Field(1, ge=1, le=64, description="number of stacked observations, the newest last [-]")
    integrity: Literal["full", "clock", "blind", "oracle"] = Field(
        "full",
        description="levels, alerts and modes (full), mode and time since RTK (clock), none of these (blind), or the "
        "true state with levels of 0 (oracle)",
    )
    services: tuple[str, ...] = Field(
        (), description="services whose modes have entries, in addition to those of navigator.service; by code of mode"
    )
    navigator_services: tuple[str, ...] = Field(
        (), description="services of navigator.service, whose modes have entries; an environment sets it"
    )
    context: bool = Field(
        False, description="entries of the context monitor; an environment sets it where the navigator has one"
    )
    filters: bool = Field(
        False,
        description="model probability, NIS and trust level have entries; an environment sets it for kind: filter",
    )
    speed_geometry: bool = Field(
        False,
        description="SDOP has an entry; an environment sets it for navigator.positioning.mode.doppler_max_sdop",
    )
    permitted_speed: bool = Field(
        False,
        description="speed permitted under an alert has an entry; an environment sets it for cost.alert_speed: level",
    )
    closure: bool = Field(
        False, description="a lane that closes has entries, once its message has arrived; for WorkZoneWorld"
    )
    tolls: bool = Field(False, description="the open geo-object has entries; for TollingWorld")
    roads: bool = Field(
        False,
        description="the roads nearby and the way to the goal have entries; an environment sets it for lane_sensor",
    )
    vehicles: int = Field(6, ge=0, le=64, description="number of vehicles in traffic, the nearest first [-]")
    preview_m: tuple[float, ...] = Field(
        (5.0, 10.0, 20.0, 40.0, 80.0), description="distances ahead at which the route's centreline is given; chosen"
    )
    satellites_m: tuple[float, ...] = Field(
        (0.0, 20.0, 40.0, 80.0, 160.0), description="distances ahead at which satellites are predicted; chosen"
    )
    speed_max_mps: float = Field(40.0, gt=0, description="scale of speeds; highway-env's fastest vehicle")
    acceleration_max_mps2: float = Field(10.0, gt=0, description="scale of accelerations; dry road, chosen")
    yaw_rate_max_radps: float = Field(1.0, gt=0, description="scale of yaw rates; 10 m/s on 10 m radius, chosen")
    offset_max_m: float = Field(12.0, gt=0, description="scale of lateral offsets; three lanes of 4 m, chosen")
    lane_width_max_m: float = Field(6.0, gt=0, description="scale of lane widths; chosen")
    curvature_max_per_m: float = Field(0.1, gt=0, description="scale of curvatures; a turn of 10 m radius, chosen")
    range_m: float = Field(150.0, gt=0, description="scale of distances to vehicles and along the lane; chosen")
    other_road_max_m: float = Field(50.0, gt=0, description="scale of distances to other roads; chosen")
    pl_max_m: float = Field(
        10.0,
        gt=0,
        description="scale of protection levels, and value of missing ones; chosen: over two lanes",
    )
    ratio_max: float = Field(3.0, gt=1, description="scale of PL / AL [-]; chosen")
    trend_window_s: float = Field(1.0, gt=0, description="period of the trend of protection levels; chosen")
    hdop_max: float = Field(10.0, gt=0, description="scale of HDOP [-]; chosen")
    sdop_max: float = Field(10.0, gt=0, description="scale of SDOP [-]; chosen")
    satellites_max: int = Field(40, ge=1, description="scale of numbers of satellites [-]; five systems, chosen")
    nis_max: float = Field(20.0, gt=0, description="scale of NIS [-]; chosen: above the gate of positions, 13.8")
    excluded_max: int = Field(5, ge=1, description="scale of the number of excluded satellites [-]; chosen")
    elapsed_max_s: float = Field(
        60.0, gt=0, description="scale of times since an event; chosen: above the longest outage of 50 s"
    )
    age_max_s: float = Field(5.0, gt=0, description="scale of the age of perceived vehicles; chosen")
    length_max_m: float = Field(20.0, gt=0, description="scale of the length of vehicles; an articulated lorry")
    width_max_m: float = Field(4.0, gt=0, description="scale of the width of vehicles; chosen")

    @field_validator("services", mode="before")
    @classmethod
    def _services_as_a_navigator_names_them(cls, value: Any) -> Any:
        """A list, or one name; ``rtk`` is left out, whose mode has an entry anyway."""
        names = [value] if isinstance(value, str) else value
        return [name for name in names if name != Mode.RTK.key] if isinstance(names, list | tuple) else value

    @model_validator(mode="after")
    def _services_exist(self) -> Self:
        for name in self.services:
            bare_name(name)  # imports the module that registers the service
            find(name, {mode.key: mode for mode in Mode if mode.is_service}, "services")
        return self

    @model_validator(mode="after")
    def _distances_ascend(self) -> Self:
        for name, distances, bound in (("preview_m", self.preview_m, ">"), ("satellites_m", self.satellites_m, ">=")):
            positive = all(d > 0.0 or (bound == ">=" and d == 0.0) for d in distances)
            if not positive or any(a >= b for a, b in pairwise(distances)):
                raise ConfigError(f"{name} must be {bound} 0 and ascend, got {list(distances)}: correct the distances")
        return self

    @property
    def shown_services(self) -> frozenset[str]:
        """Services whose modes have entries."""
        return frozenset(name.rpartition(":")[2] for name in (*self.services, *self.navigator_services))

    @property
    def shows_levels(self) -> bool:
        """Whether protection levels are shown at all."""
        return self.integrity in ("full", "oracle")
