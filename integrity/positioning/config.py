"""What the positioning believes about its measurements, and the conditions of its modes.

These are *declared* figures: the bounds and variances that the receiver assumes. What the sensors really do is
configured in :mod:`lanebound.integrity.sensors`; a protection level is honest when the declared bounds the real.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field, field_validator, model_validator
from scipy.special import chdtri, ndtri

from lanebound.integrity.core.config import Config
from lanebound.integrity.core.errors import ConfigError
from lanebound.integrity.core.frames import GRAVITY_MPS2
from lanebound.integrity.core.records import Records, one_record
from lanebound.integrity.positioning.cycle_slips import CycleSlipConfig
from lanebound.integrity.positioning.doubtful_kernel import DOUBT_RULES
from lanebound.integrity.positioning.drift_watch_kernel import DRIFT_RULES
from lanebound.integrity.positioning.heading_kernel import CALIBRATION
from lanebound.integrity.positioning.mode_kernel import MODE_LIMITS
from lanebound.integrity.positioning.odometer_watch_kernel import WATCH_LIMITS
from lanebound.integrity.positioning.rtk_kernel import FILTER_RULES, MOST_AMBIGUITIES, RTK_RULES
from lanebound.integrity.positioning.slip_watch_kernel import SLIP_RULES

__all__ = [
    "CODE_DOUBT",
    "CorrelationBound",
    "DeadReckoningConfig",
    "DopplerConfig",
    "DoubtConfig",
    "DriftWatchConfig",
    "FloatConfig",
    "HeadingConfig",
    "ModeConfig",
    "OdometerWatchConfig",
    "PositioningConfig",
    "RtkConfig",
    "bound_correlation",
    "calibration_parameters",
    "doubt_parameters",
    "drift_parameters",
    "mode_parameters",
    "overbounding_walk",
    "rtk_parameters",
    "slip_parameters",
    "watch_parameters",
]


class DoubtConfig(Config):
    """Fault hypotheses of carriers that may be reflected or diffracted (:mod:`.doubtful_kernel`).

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


CODE_DOUBT = DoubtConfig(sets=100, odds=0.17, centre_db=4.8, scale_db=0.55, confirm_from=0.01)
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
        description="how long a backup solution dead-reckons beside RTK without using it, to detect positions that "
        "drift away [s]; 0: from one epoch to the next",
    )
    hold_failures: int = Field(
        2, ge=1, description="rejected epochs in a row after which all held ambiguities are given up [-]"
    )
    drift: DriftWatchConfig = DriftWatchConfig()
    doubt: DoubtConfig = DoubtConfig()
    float_solution: FloatConfig = FloatConfig()

    @model_validator(mode="after")
    def _an_alarm_of_the_drift_watch_has_an_effect(self) -> RtkConfig:
        if self.drift.window_s > 0.0 and self.jump_quarantine_s == 0.0:
            raise ConfigError(
                "jump_quarantine_s must be larger than 0 with the drift watch, got 0: without a quarantine its alarms "
                "do nothing; set a time, or drift.window_s=0"
            )
        return self


class DopplerConfig(Config):
    """Declared errors of the range rates and of the velocity they give."""

    sigma_mps: float = Field(0.10, gt=0, description="range rate, zenith [m/s]; S1 section 4 (10 cm/s)")
    tau_range_s: tuple[float, float] = Field(
        (0.1, 2.0),
        description="shortest and longest correlation time of the range-rate errors, which the levels bound [s]; "
        "0.54 fits S1 tables 4 and 5, a reflection lasts for a facade of 10 to 20 m; chosen on training streets",
    )
    bias_mps: float = Field(0.002, ge=0, description="bound of a constant velocity bias in E and in N [m/s]")
    elevation_mask_deg: float = Field(10.0, ge=0, lt=90, description="lowest elevation used [deg]")
    cn0_min_dbhz: float = Field(28.0, ge=0, description="lowest C/N0 used for the velocity [dB-Hz]")

    @field_validator("tau_range_s")
    @classmethod
    def _a_range_ascends(cls, value: tuple[float, float]) -> tuple[float, float]:
        if not 0.0 < value[0] <= value[1]:
            raise ValueError(f"tau_range_s must be two times > 0 in ascending order, got {value}")
        return value


class HeadingConfig(Config):
    """The heading filter and its calibration."""

    initial_sigma_deg: float = Field(
        104.0, gt=0, description="heading error before the first calibration [deg]; uniform: 180 over root 3"
    )
    angle_random_walk_rad: float = Field(
        2.5e-4, gt=0, description="angle random walk [rad/sqrt(s)]; BMI088 0.014 dps/rtHz"
    )
    bias_initial_radps: float = Field(7e-3, gt=0, description="gyro bias at turn-on, 1 sigma [rad/s]; 0.4 deg/s MEMS")
    bias_walk_radps: float = Field(
        4.7e-6,
        gt=0,
        description="random walk of the gyro bias [rad/s/sqrt(s)]; overbounding_walk of BMI088, 6 deg/h over 100 s and "
        "a rate random walk of 2e-6",
    )
    gyro_scale: float = Field(
        3.8e-3,
        ge=0,
        lt=0.1,
        description="error of the gyro's scale, 1 sigma [-]; 0.3 % after calibration, and a quarter for its change",
    )
    min_speed_mps: float = Field(0.5, gt=0, description="odometer speed for Doppler calibration [m/s]; S1 table 1")
    speed_agreement_mps: float = Field(1.5, gt=0, description="Doppler against odometer speed [m/s]; S1 table 1")
    max_hdop: float = Field(2.5, gt=0, description="HDOP for Doppler calibration [-]; S1 table 1")
    max_jump_deg: float = Field(2.0, gt=0, description="largest heading jump against the IMU [deg]; S2 section 2.2")


class OdometerWatchConfig(Config):
    """What a healthy odometer may differ by from the inertial sensors (:mod:`.odometer_watch_kernel`)."""

    accelerometer_bias_mps2: float = Field(
        0.25, ge=0, description="bound of the accelerometer's bias [m/s^2]; 5 sigma of BMI088 after calibration, 5 mg"
    )
    grade: float = Field(0.08, ge=0, lt=1, description="steepest road [-]; Road Structure Order of Japan, 40 km/h: 7 %")
    scale: float = Field(
        0.10, ge=0, description="share of the accelerometer's increment that may be wrong [-]; pitch of 4 deg at 1 g"
    )
    misalignment_deg: float = Field(
        2.0, ge=0, description="lateral force seen forward: mounting and side slip [deg]; chosen"
    )
    lever_m: float = Field(2.0, ge=0, description="IMU from the rear axle, for the force in turns [m]; half a car")
    sigmas: float = Field(5.5, gt=0, description="odometer noise tolerated, in its sigmas [-]; 4e-8 for each epoch")
    stuck_s: float = Field(
        2.0, gt=0, description="how long a moving odometer may repeat one value [s]; coarse pulses need longer"
    )
    still_rate_degps: float = Field(
        3.5, gt=0, description="yaw rate of no vehicle at rest [deg/s]; 6 sigma of a gyro bias at turn-on, and noise"
    )
    still_s: float = Field(0.3, ge=0, description="how long that must last [s]")
    agree_s: float = Field(2.0, ge=0, description="how long Doppler must agree until the doubt ends [s]")


class DeadReckoningConfig(Config):
    """Declared errors of dead reckoning with heading and odometer."""

    odometer_sigma_mps: float = Field(0.05, gt=0, description="odometer speed, 1 sigma [m/s]; S1 section 4")
    odometer_tau_s: float = Field(1.0, gt=0, description="correlation time of the odometer's error [s]")
    odometer_bias_mps: float = Field(
        0.01, ge=0, description="bound of a constant odometer error [m/s]; b_v of S1 eq 19"
    )
    odometer_scale: float = Field(
        0.0135, ge=0, description="bound of the odometer's scale error [-]; 4.5 sigma of 0.3 % tyre wear and pressure"
    )
    standstill_speed_mps: float = Field(
        0.15, ge=0, description="speed that the odometer may show as rest [m/s]; dropout of its sensor"
    )
    heading_bias_deg: float = Field(
        0.2, ge=0, description="bound of the heading's error after calibration [deg]; b_theta0 of S1"
    )
    heading_drift_degps: float = Field(
        0.004, ge=0, description="growth of that bound since calibration [deg/s]; S1 section 4"
    )
    watch: OdometerWatchConfig = OdometerWatchConfig()


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


@dataclass(frozen=True)
class CorrelationBound:
    """Errors that overbound unit Gauss-Markov errors of every correlation time in a range: Gauss-Markov plus white.

    Attributes
    ----------
    decay : of the Gauss-Markov part over an epoch, variance 1
    white : variance of the white part of an epoch
    course : variance of a white error alone that bounds both
    """

    decay: float
    white: float
    course: float


def bound_correlation(shortest_s: float, longest_s: float, dt_s: float) -> CorrelationBound:
    """Overbound of a stationary unit Gauss-Markov error with a correlation time in [shortest, longest].

    The variance of a linear filter's output is ``int |W|^2 S / 2 pi``, whatever its weights, so an error with a larger
    power spectral density at every frequency has the larger variance in every linear filter, a time-varying one too,
    and the errors of satellites may have different correlation times. With ``g = tanh(dt / (2 tau))`` and ``t =
    tan(omega / 2)`` the density of a sampled Gauss-Markov error is ``S = (1 + t^2) g / (g^2 + t^2)``. At a frequency it
    is largest for ``g = t``, or for the nearest end of the range. The longest correlation time bounds it at ``t <= g``
    and misses ``(1 + t^2) (1 / (2 t) - g / (g^2 + t^2))`` beyond; a white error of the largest such difference
    (``0.1349 tau / dt`` at ``t = 3.383 g`` for long correlation times) completes the bound. The same density at
    frequency 0 plus this white part, ``1 / g + white``, bounds both by a white error alone.

    The spectral form of the bound of Langel, Crespillo and Joerger, "Bounding sequential estimation errors due to
    Gauss-Markov noise with uncertain parameters", ION GNSS+ 2019, who bound by one process of larger variance.
    """
    slow, fast = math.tanh(0.5 * dt_s / longest_s), math.tanh(0.5 * dt_s / shortest_s)
    t = np.geomspace(slow, 1e3, 20_001)
    g = np.clip(t, slow, fast)
    missed = (1.0 + t**2) * (g / (g**2 + t**2) - slow / (slow**2 + t**2))
    white = max(1.0001 * float(missed.max()), 0.0)
    return CorrelationBound((1.0 - slow) / (1.0 + slow), white, 1.0 / slow + white)


def overbounding_walk(sigma: float, tau_s: float, random_walk: float = 0.0) -> float:
    """Random walk that overbounds a gyro's wander [rad/s/sqrt(s)]: ``sqrt(2 sigma^2 / tau + K^2)``.

    The wander is a Gauss-Markov bias of 1-sigma ``sigma`` [rad/s] and of a correlation time of at least ``tau_s``,
    and a rate random walk K. The initial variance of the bias must hold ``2 sigma^2`` beside the turn-on bias
    (:mod:`.heading_kernel`).
    """
    return math.sqrt(2.0 * sigma**2 / tau_s + random_walk**2)


def rtk_parameters(config: RtkConfig, bands: int, smallest_risk: float) -> Records:
    """RTK_RULES (1,) of :mod:`.rtk_kernel`; ``smallest_risk`` is that of the strictest level reported."""
    return one_record(
        RTK_RULES,
        bands=bands,
        sin_mask=np.sin(np.deg2rad(config.elevation_mask_deg)),
        cn0_min=config.cn0_min_dbhz,
        cn0_knee=config.cn0_knee_dbhz,
        fade=config.fade_db,
        fade_decay=config.fade_decay_dbps,
        sigma_code=config.sigma_code_m,
        sigma_phase=config.sigma_phase_m,
        sigma_phase_integrity=config.sigma_phase_integrity_m,
        phase_bias=config.phase_bias_m,
        age_sigma=config.age_sigma_mps,
        max_age=config.max_age_s,
        fix_max_age=config.fix_max_age_s,
        fix_limit=config.ambiguity_risk_share * smallest_risk,
        ratio_min=config.ratio_min,
        misfit=chdtri(np.maximum(np.arange(MOST_AMBIGUITIES + 1), 1), config.fit_false_rejection),
        attempts=config.attempts,
        max_candidates=config.max_candidates,
        min_satellites=config.min_satellites,
        min_further=config.min_further,
        hold_failures=config.hold_failures,
        retry=config.retry_s,
        doubt=doubt_parameters(config.doubt, smallest_risk),
        filter=one_record(
            FILTER_RULES,
            sequential=config.float_solution.kind == "sequential",
            interval=config.float_solution.interval_s,
            memory=config.float_solution.memory_s,
            code_tau=config.float_solution.code_tau_s,
            phase_tau=config.float_solution.phase_tau_s,
            ionosphere=config.float_solution.ionosphere_m,
            troposphere=config.float_solution.troposphere_m,
        ),
    )


def doubt_parameters(config: DoubtConfig, smallest_risk: float) -> Records:
    """DOUBT_RULES (1,) of :mod:`.doubtful_kernel`; ``smallest_risk`` is that of the strictest level."""
    return one_record(
        DOUBT_RULES,
        sets=config.sets,
        zenith=config.zenith_dbhz,
        horizon=config.horizon_dbhz,
        most=config.odds,
        centre=config.centre_db,
        scale=config.scale_db,
        limit=config.share * smallest_risk,
        single=config.confirm_from,
    )


def slip_parameters(config: CycleSlipConfig) -> Records:
    """SLIP_RULES (1,) of :mod:`.slip_watch_kernel`."""
    return one_record(
        SLIP_RULES,
        k=config.threshold,
        ionosphere=config.ionosphere_rate_mps,
        fit=config.fit_limit,
        failure=config.repair_failure_rate,
    )


def calibration_parameters(config: HeadingConfig) -> Records:
    """CALIBRATION (1,) of :mod:`.heading_kernel`."""
    return one_record(
        CALIBRATION,
        min_speed=config.min_speed_mps,
        speed_agreement=config.speed_agreement_mps,
        max_hdop=config.max_hdop,
        max_jump=np.deg2rad(config.max_jump_deg),
    )


def drift_parameters(p: PositioningConfig, dt_s: float) -> Records:
    """DRIFT_RULES (1,) of :mod:`.drift_watch_kernel`.

    The union bound of false alarms is over epochs, windows, two axes and two signs. A bias of every satellite moves a
    position by at most about twice its size, at both ends of a window.
    """
    c, o = p.rtk.drift, p.dead_reckoning
    return one_record(
        DRIFT_RULES,
        spacing=c.window_s / c.windows,
        window=c.window_s,
        k=-ndtri(c.false_alarms_per_h * dt_s / 3600.0 / (4.0 * c.windows)),
        scale=o.odometer_scale,
        scale_walk=c.scale_walk,
        slip=c.slip_s2_per_m,
        sigma=o.odometer_sigma_mps,
        tau=o.odometer_tau_s,
        bias=o.odometer_bias_mps,
        creep=o.standstill_speed_mps,
        axle=p.axle_bound_m,
        heading_drift=np.deg2rad(o.heading_drift_degps),
        phase=4.0 * p.rtk.phase_bias_m,
    )


def mode_parameters(config: ModeConfig, odometer_follows: bool = True) -> Records:
    """MODE_LIMITS (1,) of :mod:`.mode_kernel`; ``odometer_follows``: gyro and odometer move what Doppler does not."""
    return one_record(
        MODE_LIMITS,
        rtk_max_hdop=config.rtk_max_hdop,
        doppler_agreement=config.doppler_agreement_mps,
        doppler_max_hdop=config.doppler_max_hdop,
        doppler_max_sdop=np.inf if config.doppler_max_sdop is None else config.doppler_max_sdop,
        doppler_max_s=config.doppler_max_s,
        doppler_if_tighter=config.doppler_when == "tighter" and odometer_follows,
    )


def watch_parameters(config: DeadReckoningConfig) -> Records:
    """WATCH_LIMITS (1,) of :mod:`.odometer_watch_kernel`."""
    w = config.watch
    return one_record(
        WATCH_LIMITS,
        allowed=w.accelerometer_bias_mps2 + GRAVITY_MPS2 * w.grade,
        scale=w.scale,
        misalignment=np.tan(np.deg2rad(w.misalignment_deg)),
        lever=w.lever_m,
        jump=w.sigmas * np.sqrt(2.0) * config.odometer_sigma_mps + config.standstill_speed_mps,
        stuck_s=w.stuck_s,
        still_rate=np.deg2rad(w.still_rate_degps),
        still_s=w.still_s,
        agree_s=w.agree_s,
    )
