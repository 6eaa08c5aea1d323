"""Declared errors of what moves a position between fixes: Doppler, heading, odometer.

These are *declared* figures: the bounds and variances that the receiver assumes. What the sensors really do is
configured in :mod:`lanebound.integrity.sensors`; a protection level is honest when the declared bounds the real.
"""

from __future__ import annotations

from pydantic import Field, field_validator

from lanebound.integrity.core.config import Config

__all__ = ["DeadReckoningConfig", "DopplerConfig", "HeadingConfig", "OdometerWatchConfig"]


class DopplerConfig(Config):
    """Declared errors of the range rates and of the velocity they give."""

    sigma_mps: float = Field(0.10, gt=0, description="range rate, zenith [m/s]; S1 section 4 (10 cm/s)")
    tau_range_s: tuple[float, float] = Field(
        (0.1, 2.0),
        description="shortest and longest correlation time of the range-rate errors, which the levels bound [s]; "
        "0.54 fits S1 tables 4 and 5, a reflection lasts for a facade of 10 to 20 m; chosen on training streets",
    )
    bias_mps: float = Field(0.002, ge=0, description="bound of a constant velocity bias in E and in N [m/s]")
    carriers: bool = Field(
        False,
        description="velocity from the changes of locked carriers over an epoch, with the noise declared for RTK's "
        "phases, where at least six are locked and pass their tests; else from range rates",
    )
    window_s: float = Field(
        0.5,
        gt=0,
        description="time between the bases of the windows over which these carriers are tested; a carrier is used "
        "once it has been locked for one to two of them [s]; chosen on streets of seeds 17 and 93",
    )
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
