"""Configuration of ranging between vehicles: UWB, and time of arrival or signal strength of the V2V radio.

The law is :mod:`lanebound.integrity.sensors.uwb_kernel`.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

from pydantic import Field, field_validator

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.sensors.uwb_kernel import RANGING

__all__ = ["RangingConfig"]

MOST_MODULES = 2
FT_M = 0.3048


class _Kind(NamedTuple):
    """Figures of a kind of ranging.

    sigma_m, offset_m: noise and constant error of a range; range_m: farthest range in free space; wave_m: wavelength;
    shadow_db, path: shadowing and exponent of the path loss where the signal's strength is the measurement.
    """

    sigma_m: float
    offset_m: float
    range_m: float
    wave_m: float
    shadow_db: float = 0.0
    path: float = 2.0


KINDS = {
    # Time Domain P410 and P412, data sheet of the P412, table 1: precision 2.3 cm and bias 2.1 cm of 20,000 ranges from
    # 2 to 300 ft in an open field; band from 3.1 to 5.3 GHz
    "uwb": _Kind(0.023, 0.021, 300.0 * FT_M, 0.07),
    # DSRC at 5.9 GHz, 10 MHz wide: "several meters" (S2 2.4); radio range as V2vConfig.range_m
    "toa": _Kind(3.0, 1.0, 300.0, 0.051),
    # WINNER+ B1, line of sight: path loss 22.7 lg(d), shadowing 3 dB (D5.3, table 4-1)
    "rssi": _Kind(0.0, 0.0, 300.0, 0.051, 3.0, 2.27),
}


class RangingConfig(Config):
    """Modules of a vehicle, and the errors of ranges between those of two vehicles."""

    kind: Literal["uwb", "toa", "rssi"] = Field(
        "uwb",
        description="two-way time of flight by UWB (P410: 2.3 cm), time of arrival (3 m) or signal strength (3 dB) of "
        "DSRC, S2 2.4",
    )
    lever_arms_m: tuple[tuple[float, float], ...] = Field(
        ((0.0, -0.8), (0.0, 0.8)),
        description="places of the modules of each vehicle, forward and right of its middle, 1 or 2 (S2 Table 4) [m]; "
        "both sides of the roof, so that two vehicles see each other's bearing; chosen",
    )
    rate_hz: float = Field(10.0, gt=0, description="ranges of a pair of modules in a second; a P410 gives 10 to 100")
    loss: float = Field(0.05, ge=0, le=1, description="share of ranges lost in free space [-]; as messages")
    sigma_m: float | None = Field(None, ge=0, description="noise, 1 sigma [m]; None: of the kind")
    offset_sigma_m: float | None = Field(
        None, ge=0, description="constant error of a pair of modules, 1 sigma [m]; None: of the kind"
    )
    range_m: float | None = Field(
        None, gt=0, description="distance at which the link budget is used up in free space [m]; None: of the kind"
    )
    late_share: float = Field(
        0.05, ge=0, lt=1, description="share of ranges of a later path in free sight [-]; chosen, 0.034 indoors"
    )
    late_mean_m: float = Field(
        0.4, ge=0, description="mean of the exponential excess of these (O'Lone 2019) [m]; 0.38 indoors, uwb_indoor"
    )
    late_s: float = Field(0.5, gt=0, description="mean time for which a pair of modules stays on one path [s]; chosen")
    height_m: float = Field(1.6, gt=0, description="height of all modules [m]; above the roof of a car")
    body_height_m: float = Field(1.5, gt=0, description="height of cars [m]; VW Golf 1.5 m")
    tall_share: float = Field(0.16, ge=0, le=1, description="share of vans [-]; DfT Road Traffic Estimates 2019")
    tall_height_m: float = Field(2.6, gt=0, description="height of vans [m]; Ford Transit H2 2.5 to 2.8 m")

    @field_validator("lever_arms_m")
    @classmethod
    def _modules_are_apart(cls, arms: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        if not 1 <= len(arms) <= MOST_MODULES or len(set(arms)) < len(arms):
            raise ConfigError(f"lever_arms_m must be 1 or 2 different places, got {list(arms)}: correct them")
        return arms

    def figures(self, epoch_s: float) -> Records:
        """(1,) RANGING of epochs of this length."""
        k, (first, *second) = KINDS[self.kind], self.lever_arms_m
        offset = k.offset_m if self.offset_sigma_m is None else self.offset_sigma_m
        late = self.late_share if self.kind == "uwb" else 0.0
        return one_record(
            RANGING, modules=1 + len(second), arms=(first, *(second or [first])), epoch_s=epoch_s,
            rate_hz=min(self.rate_hz, 1.0 / epoch_s),
            sigma_m=k.sigma_m if self.sigma_m is None else self.sigma_m, module_sigma_m=offset / math.sqrt(2.0),
            range_m=k.range_m if self.range_m is None else self.range_m, wave_m=k.wave_m, loss=self.loss,
            late_share=late, late_mean_m=self.late_mean_m, late_s=self.late_s, shadow_db=k.shadow_db, path=k.path,
            height_m=self.height_m, body_m=self.body_height_m, tall_share=self.tall_share, tall_m=self.tall_height_m,
        )  # fmt: skip
