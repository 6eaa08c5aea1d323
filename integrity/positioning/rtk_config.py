"""Declared errors of code and carrier, and the options of ambiguity resolution with RTK.

These are *declared* figures: the bounds and variances that the receiver assumes. What the sensors really do is
configured in :mod:`lanebound.integrity.sensors`; a protection level is honest when the declared bounds the real.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import ConfigError

__all__ = ["CODE_REFLECTIONS", "DriftWatchConfig", "FloatConfig", "ReflectionHypothesesConfig", "RtkConfig"]


class ReflectionHypothesesConfig(Config):
    """Fault hypotheses of carriers that may be reflected or diffracted (:mod:`.reflection_odds_kernel`).

    A carrier d [dB] below the C/N0 of an open sky is off with odds ``most / (1 + exp((centre - d) / scale))``.
    """

    sets: int = Field(
        0,
        ge=0,
        le=200,
        description="sets of two and three satellites that an RTK position is monitored without, at most; satellites "
        "that would need more are not used; 0: no hypotheses beyond those of single faults [-]",
    )
    zenith_dbhz: float = Field(48.0, description="C/N0 of an open sky at the zenith [dB-Hz]; of the receiver")
    horizon_dbhz: float = Field(38.0, description="C/N0 of an open sky at the horizon [dB-Hz]; of the receiver")
    odds: float = Field(
        0.03, gt=0, description="odds that a weak carrier is off by 3 cm and more [-]; fitted to simulated streets"
    )
    centre_db: float = Field(4.2, description="loss at which the odds are half of that [dB]; fitted alike")
    scale_db: float = Field(0.5, gt=0, description="steepness of the odds [dB]; fitted alike")
    confirm_from: float = Field(
        1e-4, gt=0, description="odds from which on a fix is found again without the satellite before it is held [-]"
    )
    share: float = Field(
        0.1, gt=0, lt=1, description="largest probability of sets not monitored as a share of the integrity risk [-]"
    )


CODE_REFLECTIONS = ReflectionHypothesesConfig(sets=100, odds=0.17, centre_db=4.8, scale_db=0.55, confirm_from=0.01)
"""Odds that an L1 code is off by more than six sigma, fitted to simulated streets (suburban, urban, dense; seed 101)"""


class FloatConfig(Config):
    """Float ambiguities before the integer search: of one epoch, or of a filter (:mod:`.float_filter_kernel`)."""

    kind: Literal["epoch", "sequential"] = Field(
        "epoch", description="epoch: from one epoch; sequential: from a filter over the epochs before, too"
    )
    interval_s: float = Field(
        1.0,
        ge=0,
        description="time between two epochs of the filter [s]; errors that last bring nothing new in between",
    )
    memory_s: float = Field(
        100.0,
        gt=0,
        description="time in which what the filter knows fades to 1/e [s]; bounds what the mean of many epochs gains",
    )
    code_tau_s: float = Field(
        30.0,
        gt=0,
        description="longest correlation time of code errors [s], shorter ones are bounded too; reflections at "
        "receivers at rest last tens of seconds",
    )
    phase_tau_s: float = Field(30.0, gt=0, description="longest correlation time of phase errors [s]")
    ionosphere_m: float = Field(
        0.0, ge=0, description="residual vertical ionosphere of a single difference, 1 sigma on the first band [m]"
    )
    troposphere_m: float = Field(0.0, ge=0, description="residual zenith delay difference, 1 sigma [m]")


class DriftWatchConfig(Config):
    """The drift watch (:mod:`.drift_watch_kernel`)."""

    window_s: float = Field(
        0.0,
        ge=0,
        description="longest window over which RTK is compared with the path by gyro and odometer [s]; 0: off, 16 when "
        "in use; a fault of gyro or odometer looks the same as a drift, and is likelier",
    )
    windows: int = Field(16, ge=2, le=64, description="windows of different lengths that are compared at once [-]")
    false_alarms_per_h: float = Field(
        0.1,
        gt=0,
        description="false alarms of a vehicle that drives with RTK for an hour, at most [1/h]; one costs "
        "jump_quarantine_s of RTK, so 1.7e-3 of the time",
    )
    scale_walk: float = Field(
        3e-5, ge=0, description="random walk of the odometer's scale [1/sqrt(s)]; 0.1 % in 1000 s, tyres that warm up"
    )
    slip_s2_per_m: float = Field(
        0.002, ge=0, description="bound of the wheels' slip per acceleration [s^2/m]; twice 3 to 4 % at 1 g, linear"
    )

    @property
    def anchors(self) -> int:
        """Anchors that a vehicle has."""
        return self.windows if self.window_s > 0.0 else 0


class RtkConfig(Config):
    """Declared errors of the single differences, and ambiguity resolution."""

    sigma_code_m: float = Field(0.30, gt=0, description="code, zenith, one band [m]; RTKLIB 0.3 m (ratio 100 to phase)")
    sigma_phase_m: float = Field(
        0.006, gt=0, description="phase, zenith, one band [m]; root 2 x RTKLIB's 3 mm, and the atmosphere of 3 km"
    )
    sigma_phase_integrity_m: float = Field(
        0.010,
        gt=0,
        description="phase of both bands, zenith, for protection levels [m]; overbounds multipath in the open",
    )
    phase_bias_m: float = Field(
        0.005, ge=0, description="bound of a phase bias of one satellite [m]; residual multipath"
    )
    reference_bias_m: float = Field(
        0.0,
        ge=0,
        description="bound of the horizontal error of the reference coordinates [m]; datum and antenna offset",
    )
    age_sigma_mps: float = Field(
        0.0015, ge=0, description="growth of a satellite's error with the age of corrections, 1 sigma [m/s]; 5e-12 s/s"
    )
    max_age_s: float = Field(30.0, gt=0, description="oldest usable corrections [s]; RTKLIB default")
    fix_max_age_s: float = Field(
        3.0, gt=0, description="oldest corrections for new fixes [s]; held ones go on to max_age_s"
    )
    elevation_mask_deg: float = Field(10.0, ge=0, lt=90, description="lowest elevation used [deg]")
    cn0_min_dbhz: float = Field(30.0, ge=0, description="lowest C/N0 used in RTK [dB-Hz]; below it mostly reflections")
    cn0_knee_dbhz: float = Field(35.0, ge=0, description="C/N0 at which the variance doubles [dB-Hz]")
    fade_db: float = Field(
        5.0,
        gt=0,
        description="carriers whose C/N0 has fallen by more are not used [dB]; half of the loss at which a ray round "
        "an edge is 1 cm late, because an estimate shows half of a fall in its first epoch",
    )
    fade_decay_dbps: float = Field(
        1.0, gt=0, description="decay of the C/N0 that the present one is compared with [dB/s]; chosen"
    )
    ambiguity_risk_share: float = Field(
        0.1, gt=0, le=1, description="largest failure rate of a fix as a share of the integrity risk [-]"
    )
    posterior_margin: float = Field(
        0.0,
        ge=0,
        description="0: integers are fixed where their failure rate, known before the measurements, is within its "
        "limit; 1 and more: also where their probability of being wrong, given the measurements, is, for errors so "
        "many times as large as declared [-]",
    )
    ratio_min: float = Field(
        2.0,
        ge=1,
        description="floor of the ratio of second to best norm, whose fixed-failure-rate threshold may be above [-]; "
        "guards the model itself",
    )
    fit_false_rejection: float = Field(
        0.01, gt=0, lt=1, description="P(right integers are refused for their misfit) [-]; alpha of S1's tests"
    )
    attempts: int = Field(
        6, ge=0, description="sets without one suspected satellite to try when all together are refused [-]"
    )
    retry_s: float = Field(
        0.5,
        ge=0,
        description="after a refusal, how long a position goes on with what is held before more is tried [s]; "
        "0: every epoch",
    )
    max_candidates: int = Field(16, ge=4, le=40, description="satellites whose ambiguities are searched at once [-]")
    min_satellites: int = Field(5, ge=4, description="satellites of a fix with one system [-]; S1 section 2")
    min_further: int = Field(3, ge=2, description="satellites that a further system must bring [-]; S1 section 2")
    confirm_s: float = Field(
        1.0,
        ge=0,
        description="how long a regained fix must pass its tests before it is used [s]; S1: breaks of 1 s and more",
    )
    jump_quarantine_s: float = Field(
        60.0,
        ge=0,
        description="how long RTK is not used after a jump against the expected position [s]; longer than a minute of "
        "dead reckoning is of no use",
    )
    return_quarantine_s: float = Field(
        5.0, ge=0, description="and after it has come back from an outage elsewhere than expected [s]; chosen"
    )
    backup_s: float = Field(
        10.0,
        ge=0,
        description="how long a backup solution dead-reckons in parallel with RTK, to detect positions that "
        "drift away [s]; 0: from one epoch to the next",
    )
    hold_failures: int = Field(
        2, ge=1, description="rejected epochs in a row after which all held ambiguities are given up [-]"
    )
    drift: DriftWatchConfig = DriftWatchConfig()
    reflections: ReflectionHypothesesConfig = ReflectionHypothesesConfig()
    float_solution: FloatConfig = FloatConfig()

    @model_validator(mode="after")
    def _posterior_probabilities_are_not_those_of_smaller_errors(self) -> RtkConfig:
        if 0.0 < self.posterior_margin < 1.0:
            raise ConfigError(
                f"posterior_margin must be 0, or at least 1, got {self.posterior_margin:g}: with errors smaller than "
                "declared wrong integers would be accepted more often than the limit"
            )
        return self

    @model_validator(mode="after")
    def _an_alarm_of_the_drift_watch_has_an_effect(self) -> RtkConfig:
        if self.drift.window_s > 0.0 and self.jump_quarantine_s == 0.0:
            raise ConfigError(
                "jump_quarantine_s must be larger than 0 with the drift watch, got 0: without a quarantine its alarms "
                "do nothing; set a time, or drift.window_s=0"
            )
        return self
