"""The lane sensor: a forward camera that measures where the car is in its lane, and not on which road.

The formulas are in :mod:`lanebound.envs.batch.lane_sensor_kernel`.
"""

from __future__ import annotations

import math
from statistics import NormalDist

from pydantic import Field

from lanebound.integrity.core.config import Config

__all__ = ["LaneSensorConfig"]


class LaneSensorConfig(Config):
    """A forward camera that measures offset and heading in the lane of the car, by its markings."""

    offset_sigma_m: float = Field(
        0.05, ge=0, description="noise of the offset, 1 sigma; with the bias below 0.1 m, Gruyer et al., IV 2014"
    )
    offset_bias_sigma_m: float = Field(
        0.08, ge=0, description="error of the offset that is constant in an episode, 1 sigma; likewise"
    )
    heading_sigma_deg: float = Field(0.2, ge=0, description="noise of the heading in the lane, 1 sigma; chosen")
    heading_bias_sigma_deg: float = Field(
        0.1, ge=0, description="error of that heading that is constant in an episode, 1 sigma; mounting, chosen"
    )
    availability: float = Field(
        0.99, gt=0, le=1, description="share of the time with markings; Mobileye: over 99 % where they are visible"
    )
    dropout_s: float = Field(2.0, gt=0, description="mean length of a dropout; chosen: an overpass, a worn stretch")
    gyro_bound_degps: float = Field(
        0.2, ge=0, description="bound of the turn rate's error during a dropout; a consumer MEMS gyro, S1"
    )
    integrity_risk: float = Field(
        1e-5, gt=0, lt=1, description="risk of the bound of the offset, both sides [-]; as the navigator's"
    )
    switch_m: float = Field(
        2.0, ge=0, description="by which another road must fit better to be believed; half a lane, chosen"
    )

    @property
    def bound_sigmas(self) -> float:
        """How many standard deviations bound an error: ``Qinv(risk / 2)``."""
        return -NormalDist().inv_cdf(0.5 * self.integrity_risk)

    def figures(self, step_s: float) -> dict[str, float]:
        """The fields of the record LANE_SENSOR, for simulation steps of ``step_s`` [s]."""
        back = 1.0 - math.exp(-step_s / self.dropout_s)
        leave = min(back * (1.0 - self.availability) / self.availability, 1.0)
        return {
            "offset_sigma_m": self.offset_sigma_m,
            "offset_bias_sigma_m": self.offset_bias_sigma_m,
            "heading_sigma_rad": math.radians(self.heading_sigma_deg),
            "heading_bias_sigma_rad": math.radians(self.heading_bias_sigma_deg),
            "leave": leave,
            "back": back,
            "gyro_bound_radps": math.radians(self.gyro_bound_degps),
            "bound_sigmas": self.bound_sigmas,
            "switch_m": self.switch_m,
        }
