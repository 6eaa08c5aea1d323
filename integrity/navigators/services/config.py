"""What a navigator declares of its positioning services: errors of corrected ranges, priors of faults, and limits."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import field_validator, model_validator

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.frames import GRAVITY_MPS2
from lanebound.integrity.navigators.services.records_kernel import LEAST_WEIGHT
from lanebound.integrity.positioning.code_errors import CodeErrorBudget
from lanebound.integrity.positioning.rtk_config import CODE_REFLECTIONS, ReflectionHypothesesConfig
from lanebound.integrity.sky.systems import System

__all__ = ["CodeServiceConfig", "CouplingConfig", "DeclaredBarometerConfig", "ServicesConfig"]


ALL_SYSTEMS = tuple(System.__members__)
NO_PRIOR = (0.0, 0.0, 0.0, 0.0, 0.0)
BROADCAST_PRIOR = (1e-8, 1e-4, 1e-4, 1e-4, 1e-4)  # WG-C ARAIM ADD v3.1: GPS 1e-8, others 1e-4


IN_STREETS = CodeErrorBudget(reflections_m=1.0)
# Ionosphere-free codes have 2.6 times the noise of one band, but the longer path of a reflected signal delays both
# alike: 0.6 m would do for six sigma (seeds 1001, 1002). Strong codes with a reflection are beyond three sigma of
# 0.6 m in 0.8 % of the epochs of urban streets (1.1 % at rest), of 0.8 m as often as normal errors (seed 51: 0.27 %)
ON_TWO_BANDS = CodeErrorBudget(reflections_m=0.8)


class CodeServiceConfig(Config):
    """Declared figures of a service that positions by codes, epoch by epoch.

    Errors of satellites and of the ionosphere are those after correction, at age 0; variances grow in proportion to
    the age of corrections.
    """

    systems: tuple[str, ...] = Field(ALL_SYSTEMS, min_length=1, description="systems used")
    smoothing_s: float = Field(
        0.0, ge=0, description="time constant of carrier smoothing (Hatch) [s]; 0: none; DO-229 has 100"
    )
    errors: CodeErrorBudget = Field(
        IN_STREETS,
        description="error budget of ranges; with a provider its satellite and ionosphere are the provider's. 1 m of "
        "reflections lies between the RMS of strong L1 codes in urban and dense streets; an open sky has none",
    )
    zenith_state: bool = Field(False, description="estimate the zenith delay of the troposphere in a filter")
    code_bias_m: float = Field(0.3, ge=0, description="bound of a lasting error of one code [m]; antenna, correlator")
    max_age_s: float = Field(18.0, gt=0, description="oldest satellite corrections [s]; DO-229D, en route to NPA")
    zenith_max_age_s: float = Field(600.0, gt=0, description="oldest ionospheric grid [s]; DO-229D")
    elevation_mask_deg: float = Field(10.0, ge=0, lt=90, description="lowest elevation used [deg]")
    cn0_min_dbhz: float = Field(30.0, ge=0, description="lowest C/N0 used [dB-Hz]; below it mostly reflections")
    max_hdop: float = Field(4.0, gt=0, description="largest HDOP of a position [-]")
    constellation_prior: tuple[float, ...] = Field(
        NO_PRIOR, min_length=5, max_length=8, description="fault probability of a whole system, by system [-]"
    )
    reflections: ReflectionHypothesesConfig = Field(
        CODE_REFLECTIONS,
        description="odds that a code is off by more than six sigma, by its loss of C/N0; fitted to L1 codes of "
        "simulated streets (suburban, urban, dense; seed 101)",
    )
    interval_s: float = Field(
        1.0, ge=0, description="time between two positions of the service [s]; Doppler moves them in between"
    )
    risk_share: float | None = Field(
        None,
        gt=0,
        le=1,
        description="share of the integrity risk for one fix [-]; none: 1 / (1 + code services), as the lowest of so "
        "many levels is kept (Bonferroni)",
    )

    @model_validator(mode="after")
    def _systems_are_known(self) -> CodeServiceConfig:
        unknown = [name for name in self.systems if name not in System.__members__]
        if unknown:
            raise ConfigError(f"systems must be among {', '.join(ALL_SYSTEMS)}, got {unknown[0]!r}: correct the name")
        return self


class DeclaredBarometerConfig(Config):
    """What a navigator declares of the height by its barometer; it bounds the true errors of ``barometer``."""

    offset_m: float = Field(0.75, ge=0, description="offset after the calibration, 1 sigma [m]; 1.5 times the true one")
    weather_m2ps: float = Field(
        5e-3,
        ge=0,
        description="growth of the variance since the calibration by the weather [m^2/s]; above 2 sigma^2 / tau = "
        "3.6e-3 of the true one; 3 m in half an hour",
    )
    wind: float = Field(0.15, ge=0, description="pressure coefficient, 1 sigma [-]; 1.5 times the true one")
    noise_m: float = Field(0.15, ge=0, description="white noise, 1 sigma [m]; 1.5 times the true one")

    def variance_m2(self, time_s: float, speed_mps: NDArray[np.float64]) -> NDArray[np.float64]:
        """Variance of the height ``time_s`` after the calibration at these speeds (B,)."""
        wind = self.wind * np.square(speed_mps) / (2.0 * GRAVITY_MPS2)
        return np.asarray(self.offset_m**2 + self.weather_m2ps * time_s + self.noise_m**2 + np.square(wind))


class CouplingConfig(Config):
    """How code services and the position reckoned on are combined (:mod:`.coupling_kernel`)."""

    kind: Literal["none", "loose", "tight"] = Field(
        "none",
        description="none: the position of the lower level; loose: both positions by their bounds; tight: ranges, of "
        "two satellites and more, correct the position reckoned on",
    )
    restart: float = Field(
        0.7,
        gt=0,
        le=1,
        description="level of a service over that of the coupled position, below which it is taken whole [-]; "
        "chosen: at 1 the mean would begin anew all the time",
    )
    fault_time_s: float = Field(
        10.0,
        gt=0,
        description="mean time for which faults stay that no mode covers [s]; as multipath_tau_s: reflections",
    )

    def memory(self, interval_s: float) -> float:
        """Factor on the probability of such faults, for a mean over three time constants of its least weight."""
        return 1.0 + 3.0 * interval_s / (LEAST_WEIGHT * self.fault_time_s)


class ServicesConfig(Config):
    """Declared figures of each service."""

    preference: float = Field(
        2.0,
        ge=1,
        description="level of a service over that of a less preferred one, up to which the more preferred is taken "
        "[-]; 1: the lower level alone decides; chosen",
    )
    coupling: CouplingConfig = Field(CouplingConfig(), description="of code services and the position reckoned on")
    barometer: DeclaredBarometerConfig = Field(
        DeclaredBarometerConfig(),
        description="height by the barometer, one more row of code positions where it is fitted",
    )
    spp: CodeServiceConfig = Field(
        CodeServiceConfig(constellation_prior=BROADCAST_PRIOR), description="broadcast ephemerides and models alone"
    )
    dgps: CodeServiceConfig = Field(
        CodeServiceConfig(errors=IN_STREETS.replace(tropo_zenith_m=0.03, iono_growth_m2ps=0.02), max_age_s=30.0),
        description="corrections of one station",
    )
    sbas_l1: CodeServiceConfig = Field(
        CodeServiceConfig(systems=("GPS",)),
        description="satellite corrections and ionospheric grid",
    )
    sbas_dfmc: CodeServiceConfig = Field(
        CodeServiceConfig(systems=("GPS", "GALILEO"), errors=ON_TWO_BANDS),
        description="satellite corrections, ionosphere-free codes",
    )
    ppp: CodeServiceConfig = Field(
        CodeServiceConfig(
            systems=("GPS", "GALILEO"),
            errors=IN_STREETS.replace(satellite_growth_m2ps=2e-4),
            smoothing_s=7200.0,
            zenith_state=True,
            code_bias_m=0.05,
            max_age_s=60.0,
        ),
        description="precise orbits and clocks; the float ambiguity of a satellite is its mean of code less carrier",
    )

    @field_validator("coupling", mode="before")
    @classmethod
    def _kind_alone(cls, value: Any) -> Any:
        return {"kind": value} if isinstance(value, str) else value
