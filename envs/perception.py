"""Perception of traffic: broadcasts of the other vehicles, the sensor of the ego, or both.

The formulas are in :mod:`lanebound.envs.batch.perception_kernel`.
"""

from __future__ import annotations

from statistics import NormalDist
from typing import Literal, Self

from pydantic import Field, model_validator

from lanebound.envs.batch.perception_kernel import CAM_MOST_S
from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.sensors.uwb import RangingConfig
from lanebound.integrity.sensors.v2v import V2vConfig

__all__ = ["CooperationConfig", "PerceptionConfig", "SensorConfig"]


class SensorConfig(Config):
    """The sensor of the ego: a fused set of radars or lidars that reports whole vehicles."""

    range_m: float = Field(80.0, gt=0, description="farthest vehicle seen [m]; near-range mode of 77 GHz radars, 70 m")
    field_of_view_deg: float = Field(
        360.0, gt=0, le=360, description="opening of the field of view, centred ahead [deg]; surround set"
    )
    range_sigma_m: float = Field(
        0.2,
        ge=0,
        description="error of the distance, middle to middle, 1 sigma [m]; 77 GHz radar 0.1 m, and the body's",
    )
    bearing_sigma_deg: float = Field(0.3, ge=0, description="error of the bearing, 1 sigma [deg]; 77 GHz radar ahead")
    lateral_bias_sigma_m: float = Field(
        0.1,
        ge=0,
        description="error across the car, constant in an episode, 1 sigma [m]; mounting and box fits, chosen",
    )
    speed_sigma_mps: float = Field(0.1, ge=0, description="error of the relative speed, 1 sigma [m/s]; 77 GHz radar")
    heading_sigma_deg: float = Field(2.0, ge=0, description="error of the relative heading, 1 sigma [deg]; box fits")
    corner_m: float | None = Field(
        None,
        ge=6.1,
        le=100,
        description="distance of buildings at the corners of Intersection from the middles of both roads, which hide "
        "vehicles; None: none. Turning lanes need 6.1 m [m]",
    )
    integrity_risk: float = Field(
        1e-5, gt=0, lt=1, description="risk of its bounds, half along, half across [-]; as the navigator's"
    )

    @property
    def bound_sigmas(self) -> float:
        """How many standard deviations bound an error: ``Qinv(risk / 4)``."""
        return -NormalDist().inv_cdf(self.integrity_risk / 4.0)


class CooperationConfig(Config):
    """Ranges to the others, and the test of what they broadcast."""

    ranging: RangingConfig = Field(RangingConfig(), description="modules and their errors")
    integrity_risk: float = Field(
        1e-5, gt=0, lt=1, description="risk of its bounds, half along, half across [-]; as the navigator's"
    )
    false_alarm: float = Field(
        1e-6, gt=0, lt=1, description="probability that a test refuses an honest message or a range in free sight [-]"
    )
    window_s: float = Field(
        0.5, ge=0, description="time for which broadcasts must contradict the ranges [s]; as long as later paths"
    )
    own_heading_sigma_deg: float = Field(0.5, ge=0, description="error of the ego's heading, 1 sigma [deg]; chosen")
    heading_sigma_deg: float = Field(
        2.0, ge=0, description="error of another's heading by its course, 1 sigma [deg]; side slip in turns; chosen"
    )


class PerceptionConfig(Config):
    """Sources of perceived traffic, and how long their measurements are used."""

    source: Literal["v2v", "sensor", "both", "cooperative", "none", "truth"] = Field(
        "v2v",
        description="source of the traffic; cooperative: broadcasts that are tested by ranges; truth: every vehicle as "
        "it is, at no age",
    )
    others: Literal["full", "surrogate"] = Field(
        "full",
        description="what the others broadcast: by a receiver of each (full), or with errors and levels of recorded "
        "episodes (surrogate)",
    )
    v2v: V2vConfig = Field(default_factory=V2vConfig, description="the radio channel")
    sensor: SensorConfig = Field(default_factory=SensorConfig, description="the ego's own sensor")
    cooperation: CooperationConfig = Field(
        default_factory=CooperationConfig, description="ranges to the others, for source cooperative"
    )
    wrong_share: float = Field(
        0.0, ge=0, le=1, description="share of the others whose broadcasts are displaced in the whole episode [-]"
    )
    wrong_m: tuple[float, float] = Field(
        (5.0, 20.0), description="range of the displacement, in any direction, with their levels unchanged [m]; chosen"
    )
    drop_after_s: float = Field(
        1.0, ge=0, description="largest age of a measurement; older ones are dropped [s]; our choice"
    )
    acceleration_bound_mps2: float = Field(
        8.0, ge=0, description="bound of others' acceleration along [m/s^2]; emergency braking, dry"
    )
    lateral_bound_mps2: float = Field(
        8.0,
        ge=0,
        description="bound of others' acceleration across [m/s^2]; the same tyres, friction circle",
    )
    course_bound_deg: float = Field(
        5.0,
        ge=0,
        lt=90,
        description="bound of the angle between course and heading of others [deg]; our choice",
    )

    @model_validator(mode="after")
    def _wrong_senders_send(self) -> Self:
        low, high = self.wrong_m
        if not 0.0 < low <= high:
            raise ConfigError(f"wrong_m must be two numbers > 0, the lower one first, got {[low, high]}: correct them")
        if self.wrong_share and not self.others_navigate:
            raise ConfigError(
                f"wrong_share must be 0 without broadcasts of receivers, got {self.wrong_share:g} with source "
                f"'{self.source}' and others '{self.others}': set source to v2v, both or cooperative, others to full"
            )
        return self

    @model_validator(mode="after")
    def _messages_are_used(self) -> Self:
        # A car at rest sends one CAM in a second: it would be lost before the next one.
        least = CAM_MOST_S + self.v2v.latency_s
        if self.v2v.messages == "cam" and self.drop_after_s < least:
            raise ConfigError(
                f"drop_after_s must be at least {least:g}, the age of the newest message of a car at rest, with "
                f"v2v.messages 'cam', got {self.drop_after_s:g}: raise it, for example to {least + 0.45:g}"
            )
        return self

    @property
    def has_radio(self) -> bool:
        """Whether the ego hears the others."""
        return self.source in ("v2v", "both", "cooperative")

    @property
    def has_sensor(self) -> bool:
        """Whether the ego sees the others."""
        return self.source in ("sensor", "both")

    @property
    def others_navigate(self) -> bool:
        """Whether the others broadcast what receivers of their own find."""
        return self.has_radio and self.others == "full"
