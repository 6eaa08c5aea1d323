"""What a navigator declares of its positioning services: errors of corrected ranges, priors of faults, and limits."""

from __future__ import annotations

from pydantic import model_validator

from lanebound.integrity.core.config import Config, Field
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.positioning.code_errors import CodeErrorBudget
from lanebound.integrity.positioning.config import CODE_DOUBT, DoubtConfig
from lanebound.integrity.sky.systems import System

__all__ = ["CodeServiceConfig", "ServicesConfig"]

ALL_SYSTEMS = tuple(System.__members__)
NO_PRIOR = (0.0, 0.0, 0.0, 0.0, 0.0)
BROADCAST_PRIOR = (1e-8, 1e-4, 1e-4, 1e-4, 1e-4)  # WG-C ARAIM ADD v3.1: GPS 1e-8, others 1e-4


IN_STREETS = CodeErrorBudget(reflections_m=1.0)


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
    doubt: DoubtConfig = Field(
        CODE_DOUBT,
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


class ServicesConfig(Config):
    """Declared figures of each service."""

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
        CodeServiceConfig(systems=("GPS", "GALILEO")),
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
