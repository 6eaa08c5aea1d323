"""Where the ego believes it is: perfect knowledge, a constant offset, or the whole navigator."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lanebound.envs.records import azimuth_of, enu_of, heading_of
from lanebound.integrity.core.config import Config
from lanebound.integrity.monitoring.alerts import AlertReason
from lanebound.integrity.navigators.navigator import Navigator
from lanebound.integrity.navigators.solution import Solution
from lanebound.integrity.positioning.modes import Mode
from lanebound.integrity.positioning.rtk_status import RtkStatus

__all__ = ["Fix", "NavigationConfig", "Source", "fix_of", "place"]

Array = NDArray[np.float64]


class Source(Enum):
    """What the belief comes from."""

    NAVIGATOR = "navigator"
    PERFECT = "perfect"
    OFFSET = "offset"

    @property
    def senses(self) -> bool:
        """Whether positions are sensed, not given."""
        return self is Source.NAVIGATOR


class NavigationConfig(Config):
    """How the ego knows its position."""

    source: Source = Field(
        Source.NAVIGATOR,
        description="navigator: from simulated sensors; perfect: true pose; offset: true pose and a constant error",
    )
    rate_hz: float = Field(10.0, gt=0, le=20, description="navigation epochs in a second; must divide simulation_hz")
    offset_at_m: float = Field(0.0, ge=-50, le=50, description="error along the track, forward, for source offset")
    offset_ct_m: float = Field(0.0, ge=-50, le=50, description="error across the track, to the right, for offset")
    start_sigma_m: float = Field(0.05, gt=0, le=10, description="1-sigma of the position known at the start; argued")
    start_heading_deg: float = Field(0.5, gt=0, le=45, description="1-sigma of the heading known at the start; argued")
    warm_up_s: float = Field(
        3.0,
        ge=0,
        le=60,
        description="time on a straight approach before the episode, in which RTK can be fixed",
    )
    map_sigma_m: float = Field(
        0.03, ge=0, le=1, description="1-sigma of the map's shift on each axis; HD maps claim 0.1 m at 3 sigma"
    )
    jump_m: float = Field(
        0.25, gt=0, description="a correction larger than this is smoothed; larger than RTK noise, argued"
    )
    smoothing_s: float = Field(1.0, ge=0, le=30, description="time constant of the smoothing; 0: none")

    @property
    def clock_start_s(self) -> float:
        """What the navigators' clock shows at the start of an episode: the warm-up, and an epoch to spare."""
        return self.warm_up_s + 1.0 / self.rate_hz

    def steps_per_epoch(self, simulation_hz: int) -> int:
        """Simulation steps in a navigation epoch; the nearest number where the rates do not divide."""
        return max(1, round(simulation_hz / self.rate_hz))


@dataclass(frozen=True)
class Fix:
    """The solution of one vehicle in the plane of the world: the fields of ``Solution``."""

    position_m: Array
    heading_rad: float
    speed_mps: float
    pl_at_m: float
    pl_ct_m: float
    mode: int
    rtk: int
    reason: int
    alert: bool
    available: bool
    hdop: float
    satellites: int
    satellites_doppler: int
    excluded: int
    since_rtk_s: float
    since_calibration_s: float
    corrections_age_s: float

    @classmethod
    def known(cls, position_m: Array, heading_rad: float, speed_mps: float, pl_at_m: float, pl_ct_m: float) -> Self:
        """A fix that is given, not sensed."""
        return cls(
            position_m, heading_rad, speed_mps, pl_at_m, pl_ct_m, int(Mode.RTK), RtkStatus.FIXED.code,
            AlertReason.NONE.code, False, True, 0.0, 0, 0, 0, 0.0, 0.0, 0.0,
        )  # fmt: skip


def fix_of(solution: Solution, row: int) -> Fix:
    """One vehicle of a batch of solutions."""
    east, north = solution.position_en_m[row].tolist()
    heading = heading_of(float(solution.heading_rad[row]))
    return Fix(
        position_m=np.array([east, -north]),
        heading_rad=(heading + math.pi) % (2.0 * math.pi) - math.pi,
        speed_mps=float(solution.speed_mps[row]),
        pl_at_m=float(solution.pl_at_m[row]),
        pl_ct_m=float(solution.pl_ct_m[row]),
        mode=int(solution.mode[row]),
        rtk=int(solution.rtk[row]),
        reason=int(solution.reason[row]),
        alert=bool(solution.alert[row]),
        available=bool(solution.available[row]),
        hdop=float(solution.hdop[row]),
        satellites=int(solution.satellites[row]),
        satellites_doppler=int(solution.satellites_doppler[row]),
        excluded=int(solution.excluded[row]),
        since_rtk_s=float(solution.since_rtk_s[row]),
        since_calibration_s=float(solution.since_calibration_s[row]),
        corrections_age_s=float(solution.corrections_age_s[row]),
    )


def place(
    navigator: Navigator,
    config: NavigationConfig,
    xy: Array,
    heading_rad: Array,
    noise: Array,
    rows: NDArray[np.int64] | slice = slice(None),
) -> None:
    """Start vehicles of a navigator near their true poses: xy (n, 2), heading (n,), standard normal noise (n, 3)."""
    spread = np.deg2rad(config.start_heading_deg)
    navigator.place(
        enu_of(xy + config.start_sigma_m * noise[:, :2]),
        azimuth_of(heading_rad + spread * noise[:, 2]),
        config.start_sigma_m,
        float(spread),
        rows,
    )
