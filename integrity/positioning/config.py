"""All of positioning: what it believes about its measurements, by part, and the conditions of its modes."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from lanebound.integrity.core.config import Config
from lanebound.integrity.positioning.cycle_slips import CycleSlipConfig
from lanebound.integrity.positioning.motion_config import DeadReckoningConfig, DopplerConfig, HeadingConfig
from lanebound.integrity.positioning.rtk_config import RtkConfig

__all__ = ["ModeConfig", "PositioningConfig"]


class ModeConfig(Config):
    """Conditions of S1 table 1."""

    rtk_max_hdop: float = Field(3.0, gt=0, description="HDOP for RTK [-]; S1 table 1")
    doppler_agreement_mps: float = Field(0.5, gt=0, description="Doppler against odometer speed [m/s]; S1 table 1")
    doppler_max_hdop: float = Field(1.5, gt=0, description="HDOP for Doppler positioning [-]; S1 table 1")
    doppler_max_sdop: float | None = Field(
        None,
        gt=0,
        description="SDOP for Doppler positioning, 1 sigma of the speed over that of one range rate at the zenith [-]; "
        "S1 section 6, S5 eq 5; none: no limit",
    )
    doppler_max_s: float = Field(60.0, gt=0, description="longest Doppler positioning without RTK [s]; S1 section 5")
    doppler_when: Literal["tighter", "usable"] = Field(
        "tighter",
        description="tighter: Doppler where its velocity has a smaller bound than that of gyro and odometer; usable: "
        "wherever it is usable, S1 figure 1",
    )


class PositioningConfig(Config):
    """All of positioning."""

    rtk: RtkConfig = RtkConfig()
    slips: CycleSlipConfig = CycleSlipConfig()
    doppler: DopplerConfig = DopplerConfig()
    heading: HeadingConfig = HeadingConfig()
    dead_reckoning: DeadReckoningConfig = DeadReckoningConfig()
    mode: ModeConfig = ModeConfig()
    antenna_forward_m: float = Field(
        0.0, ge=-20, le=20, description="antenna ahead of the vehicle's reference point, where signals arrive [m]"
    )
    antenna_right_m: float = Field(0.0, ge=-20, le=20, description="antenna to the right of that point [m]")
    axle_m: float = Field(
        0.0, ge=0, le=20, description="reference point ahead of the rear axle, which does not slip sideways [m]"
    )
    axle_bound_m: float = Field(
        0.05, ge=0, le=20, description="bound of the error of axle_m [m]; measured on the vehicle with a tape"
    )

    @property
    def lever_arm_m(self) -> tuple[float, float]:
        """Antenna position in the body frame: forward, right [m]."""
        return self.antenna_forward_m, self.antenna_right_m
