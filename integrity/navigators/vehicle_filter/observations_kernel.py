"""What the motion sensors of a vehicle say of its states (S4 section II-C3), one sensor vector at a time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.core.accel import jit
from lanebound.integrity.core.records import Records
from lanebound.integrity.navigators.vehicle_filter.records_kernel import COMPASS as MAGNETIC
from lanebound.integrity.navigators.vehicle_filter.records_kernel import (
    COURSE_BIAS,
    GYRO,
    MOTION,
    REST_BIAS,
    SLIPPING,
    SPEED_BIAS,
    STEERING,
)
from lanebound.integrity.positioning.filters.correction_kernel import UNTESTED, Models, Vector, cleared, observe
from lanebound.integrity.positioning.filters.mixing_kernel import combine
from lanebound.integrity.positioning.filters.odometry_kernel import WheelOdometry, from_front_wheel, rolling_slip
from lanebound.integrity.positioning.filters.vehicle_states_kernel import (
    COMPASS,
    EAST,
    GYRO_ANGLE,
    GYRO_BIAS,
    HEADING,
    NORTH,
    SLIDE,
    SLIP,
    SPEED,
    STATES,
    WHEEL_SCALE,
    YAW_RATE,
)

__all__ = ["acceleration_along", "correct_by_motion", "correct_by_printed", "printed_inertial"]

Array = NDArray[np.float64]
HEADING_NOISE_RAD = 1e-5  # of the integrated gyro beside its random walk, rounding
REST_SIGMA_MPS = 0.02  # at least, where the odometer shows the slowest creep
CREEP_RADIUS_M = 18.0  # a creep turns at most on a circle of 6 m, which is three sigma; chosen
STEERING_MODEL_RADPS = 1e-2  # 1-sigma of the bicycle model in the test of the yaw rate by steering


@jit
def acceleration_along(x: Array, delta_v: Array, dt: float) -> float:
    """Measured acceleration along the velocity of a model [m/s^2] (S4 eq 6 and those after it)."""
    slip = x[SLIP] + x[SLIDE]
    return float(delta_v[0] / dt * math.cos(slip) + delta_v[1] / dt * math.sin(slip))


@jit
def correct_by_motion(par: Any, vehicle: Any, measured: Any, models: Models, w: Vector, nis: Array) -> None:
    """Gyro, wheels, steering, slip, compass and rest, in this order; the NIS of each but the last into ``nis``."""
    push = math.hypot(measured.delta_v[0], measured.delta_v[1]) / par.dt
    rest = measured.distance == 0.0 and push < par.rest_mps2
    wheel = _wheel_odometry(par, measured)
    nis[GYRO] = _inertial_heading(vehicle.turned, models, w)
    nis[MOTION], rejected = _speed(par, wheel, rest, models, w)
    if par.chassis and not rest:
        nis[STEERING], used = _steering(par, wheel, models, w)
        rejected = rejected or not used
    nis[SLIPPING] = _slip(par, wheel, models, w)
    if par.compass:
        nis[MAGNETIC] = _magnetic_heading(par, measured.compass, models, w)
    if rest and par.sensor_errors:
        _gyro_at_rest(par, measured.turn[2] / par.dt, models, w)
    vehicle.rejected[MOTION] = vehicle.rejected[MOTION] + par.dt if rejected else 0.0


@jit
def _wheel_odometry(par: Any, measured: Any) -> WheelOdometry:
    """Yaw rate, speed and slip by the front left wheel, or speed and slip by odometer and gyro.

    The odometer's speed is the mean over the epoch: half an epoch of the measured acceleration brings it to the end.
    """
    if par.chassis:
        found = from_front_wheel(par.car, measured.wheel[0], measured.steering, par.speed_sigma, par.steering_sigma)
        sigma = math.hypot(par.slip_sigma, found.sigma_slip)
        return WheelOdometry(found.rate, found.speed, found.slip, found.sigma_rate, found.sigma_speed, sigma)
    slip = rolling_slip(par.axle, measured.turn[2] / par.dt, measured.speed)
    speed = measured.speed + 0.5 * measured.delta_v[0]
    return WheelOdometry(0.0, speed, slip, 0.0, par.speed_sigma, par.slip_sigma)


@jit
def _inertial_heading(turned: float, models: Models, w: Vector) -> float:
    """The integrated gyro observes the heading and the error that has been integrated with it: theta^I of S4; NIS.

    An increment over an epoch is a difference of two headings; as a rate at its end it would be half an epoch late.
    """
    v = cleared(w)
    v.z[0], v.h[0, HEADING], v.h[0, GYRO_ANGLE] = turned, 1.0, 1.0
    v.r[0, 0] = v.single[0, 0] = HEADING_NOISE_RAD**2
    return float(observe(models, w, 1, UNTESTED, False)[0])


@jit
def _speed(par: Any, wheel: WheelOdometry, rest: bool, models: Models, w: Vector) -> tuple[float, bool]:
    """Speed by the wheels, 0 at rest; NIS, and whether it was rejected. A crawling car has none.

    Wheels that show rest may creep, up to the speed below which the odometer shows nothing.
    """
    if abs(wheel.speed) < par.still_speed and not rest:
        return 0.0, False
    z, sigma = (0.0, max(REST_SIGMA_MPS, par.still_speed)) if rest else (wheel.speed, wheel.sigma_speed)
    v = cleared(w)
    # the scale acts in proportion to the speed: linear in the product, with the speed as measured
    v.z[0], v.h[0, SPEED], v.h[0, WHEEL_SCALE] = z, 1.0, z
    v.single[0, 0] = sigma * sigma
    v.r[0, 0] = sigma * sigma * (par.creep_factor if rest else par.speed_factor)
    w.errors[0, REST_BIAS if rest else SPEED_BIAS] = 1.0
    nis, used = observe(models, w, 1, par.gate_motion, False)
    return nis, not used


@jit
def _steering(par: Any, wheel: WheelOdometry, models: Models, w: Vector) -> tuple[float, bool]:
    """Yaw rate by the steering sensor (S4 eq 3); NIS, and whether it was used."""
    v = cleared(w)
    variance = wheel.sigma_rate * wheel.sigma_rate
    v.z[0], v.h[0, YAW_RATE], v.r[0, 0] = wheel.rate, 1.0, variance * par.steering_factor
    v.single[0, 0] = variance + STEERING_MODEL_RADPS**2
    nis, used = observe(models, w, 1, par.gate_motion, False)
    return nis, used


@jit
def _slip(par: Any, wheel: WheelOdometry, models: Models, w: Vector) -> float:
    """Slip by the geometry of the car; NIS.

    S4 prints ``phi = arctan(...) - s``: the geometry observes the sum of slip and slide.
    """
    v = cleared(w)
    v.z[0], v.h[0, SLIP], v.h[0, SLIDE], w.errors[0, COURSE_BIAS] = wheel.slip, 1.0, 1.0, 1.0
    v.r[0, 0] = v.single[0, 0] = wheel.sigma_slip * wheel.sigma_slip
    return float(observe(models, w, 1, UNTESTED, False)[0])


@jit
def _magnetic_heading(par: Any, heading: float, models: Models, w: Vector) -> float:
    """The compass observes the heading with a deviation; its disturbances last; NIS."""
    v = cleared(w)
    v.z[0], v.h[0, HEADING], v.h[0, COMPASS] = heading, 1.0, 1.0
    v.single[0, 0] = par.compass_sigma * par.compass_sigma
    v.r[0, 0] = v.single[0, 0] * par.compass_factor
    return float(observe(models, w, 1, par.gate_compass, True)[0])


@jit
def _gyro_at_rest(par: Any, rate: float, models: Models, w: Vector) -> None:
    """At rest the gyro measures its own bias, but for the turning of a creep."""
    v = cleared(w)
    v.z[0], v.h[0, GYRO_BIAS] = rate, 1.0
    white, turning = par.walk * par.walk / par.dt, par.still_speed / CREEP_RADIUS_M
    v.single[0, 0] = white + turning * turning
    v.r[0, 0] = white + turning * turning * par.creep_factor
    observe(models, w, 1, par.gate_motion, False)


@jit
def printed_inertial(par: Any, models: Records, probability: Array, w: Vector, mixture: Any) -> None:
    """``x^I``, ``y^I``, ``v^I`` of S4 eq 4-6 from the states before the epoch, as S4 prints them, into a vector.

    Their errors are those of the state before and of the acceleration (S4 eq 7 and after): the state counts twice. The
    observation is for comparison; ``accelerometer: input`` is the same information once. mixture : memory, a MODEL.
    """
    combine(models, probability, STATES, mixture)
    a, mean, covariance = 0.0, mixture.x, mixture.p
    for j in range(probability.shape[0]):
        a += probability[j] * models[j].acceleration
    t, course = par.dt, mean[HEADING] + mean[SLIP] + mean[SLIDE]
    along = t * mean[SPEED] + 0.5 * t * t * a
    v = cleared(w)
    v.z[0], v.z[1] = mean[EAST] + math.sin(course) * along, mean[NORTH] + math.cos(course) * along
    v.z[2] = mean[SPEED] + t * a
    bias = par.accelerometer_bias**2 + par.accelerometer_density**2 / t
    for i in range(3):
        k = SPEED if i == 2 else i
        v.h[i, k] = 1.0
        for j in range(3):
            v.r[i, j] = covariance[k, SPEED if j == 2 else j]
        v.r[i, i] += t * t * bias if i == 2 else 0.25 * t**4 * bias
    v.single[:] = v.r


@jit
def correct_by_printed(par: Any, models: Models, w: Vector) -> None:
    """Correct by the vector of :func:`printed_inertial`."""
    observe(models, w, 3, par.gate_printed, False)
