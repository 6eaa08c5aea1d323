"""Observations of an epoch: what each instrument says of the states (S4 section II-C3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from plain_filter_belief import BIASES, FilterBelief, slow_columns
from plain_filter_epoch import Observation, gates
from plain_filter_figures import lasting as lasts
from plain_odometry import from_front_wheel, rolling_slip

from lanebound.integrity.navigators.vehicle_filter.config import FilterConfig
from lanebound.integrity.positioning.filters.code_position import CodePosition
from lanebound.integrity.positioning.filters.vehicle_models import S
from lanebound.integrity.positioning.filters.vehicle_states_kernel import STATES
from lanebound.integrity.sensors.instruments import Measurements

__all__ = ["acceleration_along", "gnss_position", "motion_observations", "printed_inertial"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
HEADING_NOISE_RAD = 1e-5  # of the integrated gyro beside its random walk, rounding
REST_SIGMA_MPS = 0.02
CREEP_RADIUS_M = 18.0
GNSS_EAST_BIAS, GNSS_NORTH_BIAS, COURSE_BIAS, SPEED_BIAS, REST_BIAS = range(BIASES)


def design(*rows: dict[S, float]) -> Array:
    """Design matrix (m, STATES) from its entries by row."""
    h = np.zeros((len(rows), STATES))
    for k, row in enumerate(rows):
        for place, value in row.items():
            h[k, place] = value
    return h


def diagonal(*variances: Array | float, batch: int) -> Array:
    """Covariances (B, m, m) of independent errors."""
    r = np.zeros((batch, len(variances), len(variances)))
    for k, variance in enumerate(variances):
        r[:, k, k] = variance
    return r


def acceleration_along(m: Measurements, b: FilterBelief, dt_s: float) -> Array:
    """Measured acceleration along the velocity of each model, (B, r) [m/s^2] (S4 eq 6 and those after it)."""
    slip = b.x[..., S.SLIP] + b.x[..., S.SLIDE]
    forward, right = m.imu.delta_v_mps[:, None, 0] / dt_s, m.imu.delta_v_mps[:, None, 1] / dt_s
    return np.asarray(forward * np.cos(slip) + right * np.sin(slip))


def motion_observations(config: FilterConfig, m: Measurements, b: FilterBelief) -> list[Observation]:
    """Gyro, wheels, slip, compass and rest, in the order in which they correct the state."""
    rest = resting(config, m)
    found = [inertial_heading(m, b), speed_by_wheels(config, m, rest), *slip_and_rate(config, m, rest)]
    if m.compass is not None:
        found.append(magnetic_heading(config, m))
    return [*found, gyro_at_rest(config, m, rest)]


def resting(config: FilterConfig, m: Measurements) -> Bools:
    """Wheels and accelerometers find no motion, (B,)."""
    push = np.hypot(m.imu.delta_v_mps[:, 0], m.imu.delta_v_mps[:, 1]) / config.dt_s
    return np.asarray((m.odometer.distance_m == 0.0) & (push < config.motion.rest_mps2))


def inertial_heading(m: Measurements, b: FilterBelief) -> Observation:
    """The integrated gyro observes the heading and the error that has been integrated with it: theta^I of S4.

    An increment over an epoch is a difference of two headings; as a rate at its end it would be half an epoch late.
    """
    batch = m.imu.delta_theta_rad.shape[0]
    r = diagonal(HEADING_NOISE_RAD**2, batch=batch)
    h = design({S.HEADING: 1.0, S.GYRO_ANGLE: 1.0})
    return Observation("gyro", b.turned_rad[:, None], h, r, r, np.ones(batch, np.bool_))


def speed_by_wheels(config: FilterConfig, m: Measurements, rest: Bools) -> Observation:
    """Speed by the odometer, or by the front left wheel (S4 section II-C4); 0 at rest.

    The odometer's is the mean over the epoch: half an epoch of the measured acceleration brings it to the end.
    """
    motion, dt, batch = config.motion, config.dt_s, m.odometer.speed_mps.shape[0]
    if m.chassis is None:
        speed, sigma = m.odometer.speed_mps + 0.5 * m.imu.delta_v_mps[:, 0], np.full(batch, motion.speed_sigma_mps)
    else:
        wheel = from_front_wheel(
            config.chassis, m.chassis.wheel_mps[:, 0], m.chassis.steering_rad, motion.speed_sigma_mps,
            np.deg2rad(motion.steering_sigma_deg),
        )  # fmt: skip
        speed, sigma = wheel.speed_mps, wheel.sigma_speed
    still = config.positioning.dead_reckoning.standstill_speed_mps
    z, sigma = np.where(rest, 0.0, speed), np.where(rest, max(REST_SIGMA_MPS, still), sigma)
    r = diagonal(np.square(sigma), batch=batch)
    factors = lasts(motion.creep_tau_s, dt), lasts(motion.speed_tau_s, dt)
    lasting = np.where(rest, *factors)[:, None, None]
    crawling = (np.abs(speed) < still) & ~rest
    # the scale acts in proportion to the speed: linear in the product, with the speed as measured
    h = np.zeros((batch, 1, 1, STATES))
    h[..., S.SPEED], h[:, 0, 0, S.WHEEL_SCALE] = 1.0, z
    bias = np.zeros((batch, 1, 1, BIASES))
    bias[..., 0, 0, SPEED_BIAS], bias[..., 0, 0, REST_BIAS] = ~rest, rest
    return Observation("wheels", z[:, None], h, r * lasting, r, ~crawling, gates(config, 1, gnss=False), bias)


def slip_and_rate(config: FilterConfig, m: Measurements, rest: Bools) -> list[Observation]:
    """Slip by the geometry of the car; with a steering sensor its yaw rate, too (S4 eq 3)."""
    motion, dt, batch = config.motion, config.dt_s, m.odometer.speed_mps.shape[0]
    sigma = np.full(batch, np.deg2rad(motion.slip_sigma_deg))
    bias = np.zeros((1, BIASES))
    bias[0, COURSE_BIAS] = 1.0
    h, found = design({S.SLIP: 1.0, S.SLIDE: 1.0}), []
    if m.chassis is None:
        slip = rolling_slip(config.positioning.axle_m, m.imu.delta_theta_rad[:, 2] / dt, m.odometer.speed_mps)
    else:
        wheel = from_front_wheel(
            config.chassis, m.chassis.wheel_mps[:, 0], m.chassis.steering_rad, motion.speed_sigma_mps,
            np.deg2rad(motion.steering_sigma_deg),
        )  # fmt: skip
        slip, sigma = wheel.slip_rad, np.hypot(sigma, wheel.sigma_slip)
        r = diagonal(np.square(wheel.sigma_rate), batch=batch)
        lasting = lasts(motion.steering_tau_s, dt)
        h_rate = design({S.YAW_RATE: 1.0})
        found.append(
            Observation("steering", wheel.rate_radps[:, None], h_rate, r * lasting, r + 1e-4, ~rest,
                        gates(config, 1, gnss=False))
        )  # fmt: skip
    r = diagonal(np.square(sigma), batch=batch)
    found.append(Observation("slip", slip[:, None], h, r, r, np.ones(batch, np.bool_), None, bias))
    return found


def magnetic_heading(config: FilterConfig, m: Measurements) -> Observation:
    """The compass observes the heading with a deviation; its disturbances last."""
    assert m.compass is not None
    motion, batch = config.motion, m.compass.heading_rad.shape[0]
    r = diagonal(np.deg2rad(motion.compass_sigma_deg) ** 2, batch=batch)
    h = design({S.HEADING: 1.0, S.COMPASS: 1.0})
    z = m.compass.heading_rad[:, None]
    return Observation(
        "compass", z, h, r * lasts(motion.compass_tau_s, config.dt_s), r, np.ones(batch, np.bool_),
        gates(config, 1, gnss=True), angular=True,
    )  # fmt: skip


def gyro_at_rest(config: FilterConfig, m: Measurements, rest: Bools) -> Observation:
    """At rest the gyro measures its own bias."""
    dt, batch = config.dt_s, rest.shape[0]
    white = config.positioning.heading.angle_random_walk_rad**2 / dt
    turning = (config.positioning.dead_reckoning.standstill_speed_mps / CREEP_RADIUS_M) ** 2
    single = diagonal(white + turning, batch=batch)
    r = diagonal(white + turning * lasts(config.motion.creep_tau_s, dt), batch=batch)
    z = m.imu.delta_theta_rad[:, 2:] / dt
    there = rest if config.sensor_errors else np.zeros_like(rest)
    return Observation("rest", z, design({S.GYRO_BIAS: 1.0}), r, single, there, gates(config, 1, gnss=False))


def printed_inertial(config: FilterConfig, x_before: Array, p_before: Array, acceleration: Array) -> Observation:
    """``x^I``, ``y^I``, ``v^I`` of S4 eq 4-6 from the state before the epoch (B, STATES), as S4 prints them.

    Their errors are those of the state before and of the acceleration (S4 eq 7 and after): the state counts twice. The
    observation is for comparison; ``accelerometer: input`` is the same information once.
    """
    t, motion, batch = config.dt_s, config.motion, x_before.shape[0]
    course = x_before[:, S.HEADING] + x_before[:, S.SLIP] + x_before[:, S.SLIDE]
    along = t * x_before[:, S.SPEED] + 0.5 * t * t * acceleration
    z = np.stack([
        x_before[:, S.EAST] + np.sin(course) * along, x_before[:, S.NORTH] + np.cos(course) * along,
        x_before[:, S.SPEED] + t * acceleration,
    ], -1)  # fmt: skip
    of_bias = motion.accelerometer_bias_mps2**2 + motion.accelerometer_density**2 / t
    where = [S.EAST, S.NORTH, S.SPEED]
    r = p_before[:, where][:, :, where] + np.diag([0.25 * t**4 * of_bias, 0.25 * t**4 * of_bias, t * t * of_bias])
    h = design({S.EAST: 1.0}, {S.NORTH: 1.0}, {S.SPEED: 1.0})
    return Observation("inertial", z, h, r, r, np.ones(batch, np.bool_), gates(config, 3, gnss=False))


def gnss_position(
    config: FilterConfig, fix: CodePosition, heading_rad: Array, now: Bools, lasting: Array
) -> Observation:
    """The position of the antenna, brought to the reference point; its slow error is a state; lasting (B,) factors."""
    forward, right = config.positioning.lever_arm_m
    sine, cosine = np.sin(heading_rad), np.cos(heading_rad)
    lever = np.stack([sine * forward + cosine * right, cosine * forward - sine * right], -1)
    bias = np.zeros((2, BIASES))
    bias[0, GNSS_EAST_BIAS] = bias[1, GNSS_NORTH_BIAS] = 1.0
    single = fix.fast_m2 + 1e-4 * np.eye(2)
    if config.sensor_errors:
        h = design({S.EAST: 1.0, S.GNSS_EAST: 1.0}, {S.NORTH: 1.0, S.GNSS_NORTH: 1.0})
        r = single * lasting[:, None, None]
    else:
        h = design({S.EAST: 1.0}, {S.NORTH: 1.0})
        single = single + fix.slow_m2
        r = single
    slow = slow_columns(fix) if config.sensor_errors else None
    z, threshold = fix.position_m[:, :2] - lever, gates(config, 2, gnss=True)
    return Observation("gnss", z, h, r, single, now, threshold, bias, slow)
