"""In NumPy, the reference of ``odometry_kernel``: yaw rate, speed and slip at its reference point (S4 section II-C4).

S4's geometrical centre lies in the middle between the axles; here the reference point lies ``axle_m`` ahead of the rear
axle, which makes S4's formulas a case of ours. S4 turns to the left; here angles are positive to the right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lanebound.integrity.sensors.chassis import ChassisConfig

__all__ = ["WheelOdometry", "from_front_wheel", "rolling_slip"]

Array = NDArray[np.float64]
SLOWEST_MPS = 1.0  # below, the slip follows from the geometry badly


@dataclass(frozen=True)
class WheelOdometry:
    """Observed yaw rate [rad/s], speed [m/s] and slip [rad] of the reference point, and their 1-sigma, (B,) each."""

    rate_radps: Array
    speed_mps: Array
    slip_rad: Array
    sigma_rate: Array
    sigma_speed: Array
    sigma_slip: Array


def from_front_wheel(
    car: ChassisConfig, speed_mps: Array, angle_rad: Array, sigma_mps: float, sigma_rad: float
) -> WheelOdometry:
    """S4 eq 3 and the formulas around it, from speed and angle (B,) of the front left wheel.

    ``rate = v_fl sin(delta) / l``, ``tan(slip) = a / d`` with ``d = l / tan(delta) - b / 2``,
    ``v = v_fl cos(Delta + delta) / cos(Delta + slip)`` with ``tan(Delta) = (b / 2) / (l - a)``.
    """
    length, half, ahead = car.wheelbase_m, 0.5 * car.track_m, car.wheelbase_m - car.axle_m
    tangent = np.tan(angle_rad)
    slip = np.arctan(car.axle_m * tangent / (length - half * tangent))
    diagonal = np.arctan2(half, ahead)
    ratio = np.cos(diagonal + angle_rad) / np.cos(diagonal + slip)
    of_angle = np.abs(speed_mps) * np.cos(angle_rad) / length
    return WheelOdometry(
        rate_radps=speed_mps * np.sin(angle_rad) / length,
        speed_mps=speed_mps * ratio,
        slip_rad=slip,
        sigma_rate=np.hypot(np.sin(angle_rad) / length * sigma_mps, of_angle * sigma_rad),
        sigma_speed=np.hypot(ratio * sigma_mps, speed_mps * np.sin(angle_rad - slip) * sigma_rad),
        sigma_slip=np.full(speed_mps.shape, sigma_rad * car.axle_m / length),
    )


def rolling_slip(axle_m: float, rate_radps: Array, speed_mps: Array) -> Array:
    """Slip of the reference point where the rear axle does not slip: ``sin(slip) = a rate / v``.  (B,) -> (B,) [rad].

    0 below 1 m/s. For vehicles without a steering sensor.
    """
    share = axle_m * rate_radps / np.maximum(np.abs(speed_mps), SLOWEST_MPS)
    return np.where(np.abs(speed_mps) < SLOWEST_MPS, 0.0, np.arcsin(np.clip(share, -0.7, 0.7)))
